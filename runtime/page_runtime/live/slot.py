"""A queue of one between whoever captures frames and whoever uses them: the newest frame, or every frame in turn."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

from page_runtime.live.result import LoopCounts
from page_runtime.recorded import RecordedFrame, Source

# How long a source that cannot be told to stop is waited for.
STOP_WAIT_S = 1.0


@runtime_checkable
class Stoppable(Protocol):
    """A source whose iteration another thread can end."""

    def stop(self) -> None: ...


@dataclass(frozen=True, eq=False, slots=True)
class Received:
    """A frame and when this process had it, seconds of `time.monotonic`."""

    recorded: RecordedFrame
    received_s: float


class FrameSlot:
    """Frames of `source`, taken by a thread of its own and handed over one at a time.

    A live source never waits: a frame that nobody took is dropped for the next one, and counted. A recorded source
    (`recorded.Source`) waits until its frame is taken: none is dropped, and the next one is read meanwhile.
    """

    def __init__(self, source: Iterable[RecordedFrame], *, name: str = "source") -> None:
        self._source, self._every = source, isinstance(source, Source)
        self._changed = threading.Condition()
        self._waiting: Received | None = None
        self._in_hand = 0
        self._finished = self._closing = False
        self._error: BaseException | None = None
        self._counts = LoopCounts()
        self._thread = threading.Thread(target=self._capture, name=f"capture of {name}", daemon=True)
        self._thread.start()

    def take(self) -> Received | None:
        """The next frame, when there is one; None when the source has ended or `stop` was called.

        What the source raised is raised here, after its last frame.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None or self._finished or self._closing)
            if self._waiting is not None and not self._closing:
                received, self._waiting = self._waiting, None
                self._in_hand += 1
                self._changed.notify_all()
                return received
            if self._error is not None and not self._closing:
                raise self._error
            return None

    def answered(self, *, late: bool, searched: int, tracked: int, lost: int, failed: bool = False) -> LoopCounts:
        """Count a frame that was taken as processed; the counters after that."""
        with self._changed:
            if self._in_hand:
                self._in_hand -= 1
            else:
                # Counted as dropped by a `close` in another thread, meanwhile.
                self._counts = replace(self._counts, dropped=self._counts.dropped - 1)
            self._counts = replace(
                self._counts,
                processed=self._counts.processed + 1,
                late=self._counts.late + late,
                searched=self._counts.searched + searched,
                tracked=self._counts.tracked + tracked,
                lost=self._counts.lost + lost,
                failed=self._counts.failed + failed,
            )
            return self._with_waiting()

    def abandoned(self) -> None:
        """Count a frame that was taken, and of which nothing will come, as dropped."""
        with self._changed:
            self._drop(min(1, self._in_hand))

    @property
    def counts(self) -> LoopCounts:
        """received = processed + dropped + waiting, at any time."""
        with self._changed:
            return self._with_waiting()

    def _with_waiting(self) -> LoopCounts:
        return replace(self._counts, waiting=self._in_hand + int(self._waiting is not None))

    @property
    def has_waiting(self) -> bool:
        """Whether a frame waits to be taken."""
        with self._changed:
            return self._waiting is not None

    @property
    def closing(self) -> bool:
        """Whether `stop` or `close` was called."""
        return self._closing

    def stop(self) -> None:
        """End the hand-over; does not wait, and may be called from a signal's handler."""
        # No lock: the handler may have interrupted the very thread that holds it.
        self._closing = True
        threading.Thread(target=self._wake, daemon=True).start()

    def _wake(self) -> None:
        if isinstance(self._source, Stoppable):
            self._source.stop()
        with self._changed:
            self._changed.notify_all()

    def close(self) -> None:
        """Stop, and wait for the thread; a source that cannot be told to stop is left to itself after STOP_WAIT_S."""
        self._closing = True
        self._wake()
        self._thread.join(STOP_WAIT_S)
        with self._changed:
            self._in_hand += int(self._waiting is not None)
            self._waiting = None
            self._drop(self._in_hand)

    def _drop(self, frames: int) -> None:
        self._in_hand -= frames
        self._counts = replace(self._counts, dropped=self._counts.dropped + frames)

    def _capture(self) -> None:
        try:
            for recorded in self._source:
                received = Received(recorded, time.monotonic())
                with self._changed:
                    if self._every:
                        self._changed.wait_for(lambda: self._waiting is None or self._closing)
                    if self._closing:
                        return
                    dropped = int(self._waiting is not None)
                    self._counts = replace(
                        self._counts, received=self._counts.received + 1, dropped=self._counts.dropped + dropped
                    )
                    self._waiting = received
                    self._changed.notify_all()
        except BaseException as error:
            # Whatever it is, it is raised to whoever takes the next frame; a thread has nobody to raise it to.
            self._error = error
        finally:
            with self._changed:
                self._finished = True
                self._changed.notify_all()
