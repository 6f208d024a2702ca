"""The network's part of the next frame, in a thread of its own, while the one before it is scored."""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from page_runtime.live.slot import FrameSlot, Received

# Of what a look is expected to take: one that is a little slower than the last still ends in time.
SPARE = 1.25

T = TypeVar("T")


@dataclass(frozen=True, eq=False, slots=True)
class _Raised:
    error: BaseException


@dataclass(frozen=True, eq=False, slots=True)
class _Seen(Generic[T]):
    received: Received
    seen: T | _Raised
    ended_s: float


class LookingAhead(Generic[T]):
    """Takes frames from `slot` and gives each to `look`, one ahead of whoever takes the results.

    A look begins so late that it ends when the work on the result before it does, as long as that took the last time:
    it is of the newest frame then, and has not waited for the scorer. Where that takes longer than the last time, and
    what was seen has waited for more than another look would take, the newer frame is looked at and this one dropped.
    Frames of a recording (`in_time` False), all of which are worked on, are looked at as soon as there is room.
    """

    def __init__(self, slot: FrameSlot, look: Callable[[Received], T], *, in_time: bool = True) -> None:
        self._slot, self._look, self._in_time = slot, look, in_time
        self._changed = threading.Condition()
        self._ready: _Seen[T] | None = None
        self._error: BaseException | None = None
        self._wanted = self._finished = False
        # When the last result was taken, how long it was worked on before the next was asked for, how long a look took.
        self._taken_s = self._work_s = self._look_s = 0.0
        self._thread = threading.Thread(target=self._run, name="looking ahead", daemon=True)
        self._thread.start()
        # An interpreter that ends while a daemon thread is inside onnxruntime aborts.
        atexit.register(self._end)

    def take(self) -> tuple[Received, T] | None:
        """The next frame with what was seen in it; None when the slot has ended, or was stopped before this was called.
        Raises what `look` raised, the frame of which is dropped, and what the slot did, after its last frame."""
        with self._changed:
            if self._slot.closing:
                return None
            self._work_s = time.monotonic() - self._taken_s if self._taken_s else 0.0
            if self._is_stale():
                self._ready = None
                self._slot.abandoned()
            self._wanted = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._ready is not None or self._finished)
            self._wanted = False
            ready, self._ready = self._ready, None
            self._taken_s = time.monotonic()
            self._changed.notify_all()
        if ready is not None:
            if isinstance(ready.seen, _Raised):
                self._slot.abandoned()
                raise ready.seen.error
            return ready.received, ready.seen
        if self._error is not None:
            raise self._error
        return None

    def close(self, seconds: float) -> None:
        """Wait for the thread, which ends with the slot; a look that takes longer than that is left to itself."""
        with self._changed:
            self._ready = None
            self._changed.notify_all()
        self._thread.join(seconds)
        if not self._thread.is_alive():
            atexit.unregister(self._end)

    def _end(self) -> None:
        self._slot.close()
        with self._changed:
            self._changed.notify_all()
        self._thread.join()

    def _is_stale(self) -> bool:
        ready = self._ready
        if not self._in_time or ready is None or isinstance(ready.seen, _Raised) or not self._slot.has_waiting:
            return False
        return time.monotonic() - ready.ended_s > self._look_s

    def _run(self) -> None:
        try:
            while self._wait_for_its_time() and (received := self._slot.take()) is not None:
                began_s = time.monotonic()
                seen = self._seen(received)
                ended_s = time.monotonic()
                self._look_s = ended_s - began_s
                with self._changed:
                    self._ready = _Seen(received, seen, ended_s)
                    self._changed.notify_all()
        except BaseException as error:
            # The source's; raised to whoever takes the next result, as in FrameSlot.
            self._error = error
        finally:
            with self._changed:
                self._finished = True
                self._changed.notify_all()

    def _seen(self, received: Received) -> T | _Raised:
        try:
            return self._look(received)
        except BaseException as error:
            return _Raised(error)

    def _wait_for_its_time(self) -> bool:
        """Wait until a look should begin; whether one should at all."""
        with self._changed:
            self._changed.wait_for(lambda: self._ready is None or self._slot.closing)
            if self._in_time:
                left_s = self._taken_s + self._work_s - SPARE * self._look_s - time.monotonic()
                self._changed.wait_for(lambda: self._wanted or self._slot.closing, max(0.0, left_s))
            return not self._slot.closing
