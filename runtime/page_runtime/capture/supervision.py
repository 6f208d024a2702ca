"""A live source in a supervised child process: frames as they come, whatever the camera library does.

    with SupervisedSource(factory, name="oak") as source:
        for recorded in source: ...

The child writes each frame into the ring; this process takes the newest one when it is asked for the next frame and
counts those it passed over. A thread watches: a child that dies or stalls is replaced after a pause that doubles from
attempt to attempt, a source that ends ends the iteration, and an error that a new start cannot mend is raised to
whoever iterates.
"""

from __future__ import annotations

import pickle
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from multiprocessing.connection import wait
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from page_runtime.capture.child_process import ChildProcess, pickled
from page_runtime.capture.counts import FrameCounts, total
from page_runtime.capture.events import (
    SourceDied,
    SourceEnded,
    SourceEvent,
    SourceRunning,
    SourceStalled,
    SourceStarted,
)
from page_runtime.capture.frame_service import (
    DeviceUnavailable,
    Factory,
    FrameReady,
    ServiceEnded,
    ServiceFailed,
    serve_frames,
)
from page_runtime.capture.patience import Patience, Watch
from page_runtime.frame import RgbdFrame
from page_runtime.image_files import SourceError
from page_runtime.recorded import RecordedFrame

SUPERSEDED = "frames passed over for newer ones"
OVERWRITTEN = "frames overwritten while they were read"
WITH_PROCESS = "readings lost with their process"
EVENTS_KEPT = 1000
POLL_S = 0.02

_Pixels = tuple[NDArray[np.uint8], NDArray[np.float32]]


class SourceLost(SourceError):
    """A live source died and could not be brought back."""


class SupervisedSource:
    """Frames of `factory`, run in a child process that is replaced when it dies.

    factory: picklable by reference, called in the child. name: of the source, in messages. environment: of the child,
    where this process's does not say otherwise. on_event: told every event, from the watching thread. Iterating blocks
    until there is a frame; it ends when the source does, and raises SourceError for what a new start cannot mend.
    """

    category: str | None = None
    part_names: tuple[str, ...] | None = None
    # What the camera says of itself, JSON text; None before the first frame, or where it says nothing.
    calibration: str | None = None

    def __init__(
        self,
        factory: Factory,
        *,
        name: str,
        format: str = "live camera",
        patience: Patience | None = None,
        environment: Mapping[str, str] | None = None,
        on_event: Callable[[SourceEvent], None] = lambda _: None,
    ) -> None:
        self.name, self.format = name, format
        self._task, self._environment, self._on_event = pickled(partial(serve_frames, factory)), environment, on_event
        self._patience = patience or Patience()
        self._changed = threading.Condition()
        self._events: deque[SourceEvent] = deque(maxlen=EVENTS_KEPT)
        self._newest: tuple[FrameReady, Callable[[], _Pixels | None]] | None = None
        self._closing = self._finished = False
        self._error: SourceError | None = None
        self._dropped: Counter[str] = Counter()
        self._earlier = FrameCounts()
        self._current = FrameCounts()
        self._received = self._delivered = 0
        self._outages: list[float] = []
        self._last_frame_s: float | None = None
        self._thread = threading.Thread(target=self._supervise, name=f"supervisor of {name}", daemon=True)
        self._thread.start()

    def __enter__(self) -> SupervisedSource:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def stop(self) -> None:
        """Ask the source to end, which ends the iteration; does not wait, and may be called by a signal's handler."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    def close(self) -> None:
        """End the child and the thread; everything is given back when this returns."""
        self.stop()
        self._thread.join()

    @property
    def events(self) -> tuple[SourceEvent, ...]:
        """The last events, oldest first."""
        with self._changed:
            return tuple(self._events)

    @property
    def outages_s(self) -> tuple[float, ...]:
        """How long each outage lasted, from the last frame before it to the first one after it."""
        with self._changed:
            return tuple(self._outages)

    @property
    def counts(self) -> FrameCounts:
        """Of all child processes so far. A frame received is delivered, dropped, or the one that waits to be taken."""
        with self._changed:
            return replace(total((self._earlier, self._current)), paired=self._received, dropped=dict(self._dropped))

    def __iter__(self) -> Iterator[RecordedFrame]:
        """The newest frame, each time one is asked for; frames passed over meanwhile are counted as dropped."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None or self._finished)
                if self._newest is None:
                    if self._error is not None:
                        raise self._error
                    return
                (ready, read), self._newest = self._newest, None
                pixels = read()
                if pixels is None:
                    self._dropped[OVERWRITTEN] += 1
                    continue
                index, self._delivered = self._delivered, self._delivered + 1
            yield RecordedFrame(RgbdFrame(*pixels, ready.camera, ready.timestamp_s, index, ready.skew_s))

    def _tell(self, event: SourceEvent) -> None:
        with self._changed:
            self._events.append(event)
        self._on_event(event)

    def _supervise(self) -> None:
        try:
            self._run_children()
        except Exception as error:
            # on_event is the application's, and a thread that dies in silence would look like a source that ended.
            self._error = SourceLost(f"{self.name}: its supervision failed ({type(error).__name__}: {error})")
        finally:
            with self._changed:
                self._finished = True
                self._changed.notify_all()

    def _run_children(self) -> None:
        began_s, pause_s, attempt = time.monotonic(), self._patience.first_pause_s, 0
        while not self._closing:
            attempt += 1
            before = self._received
            child = ChildProcess(self._task, environment=self._environment)
            watch = Watch(child, self._patience)
            try:
                self._tell(SourceStarted(child.pid, attempt))
                reason = self._watch(watch)
            finally:
                self._retire(watch)
            if reason is None:
                return
            self._tell(SourceDied(reason, time.monotonic() - child.started_s))
            if self._received > before:
                pause_s = self._patience.first_pause_s
            quiet_s = time.monotonic() - (self._last_frame_s or began_s)
            hopeless = not self._received and attempt >= self._patience.max_first_starts
            if hopeless or quiet_s > self._patience.give_up_s:
                wrote = f"; it wrote: {child.stderr_tail()[-300:]}" if child.stderr_tail() else ""
                self._error = SourceLost(
                    f"{self.name}: lost after {attempt} starts, no frame for {quiet_s:.1f} s; the last: {reason}{wrote}"
                )
                return
            with self._changed:
                self._changed.wait_for(lambda: self._closing, timeout=pause_s)
            pause_s = min(2 * pause_s, self._patience.longest_pause_s)

    def _watch(self, watch: Watch) -> str | None:
        """Serve one child; returns why it is to be replaced, None when there is nothing more to wait for."""
        while not self._closing:
            if wait([watch.child.messages], timeout=POLL_S):
                try:
                    message = watch.child.messages.recv()
                except (EOFError, OSError, pickle.UnpicklingError):
                    watch.child.kill()
                    return watch.child.manner_of_death()
                if isinstance(message, FrameReady):
                    self._accept(message, watch)
                elif isinstance(message, ServiceEnded):
                    self._tell(SourceEnded())
                    return None
                elif isinstance(message, ServiceFailed):
                    return self._judge(message)
            watch.child.stderr_tail()
            if watch.just_stalled():
                self._tell(SourceStalled(watch.age_s))
            reason = watch.overdue()
            if reason is not None:
                watch.child.kill()
                return reason
        return None

    def _accept(self, ready: FrameReady, watch: Watch) -> None:
        now_s = time.monotonic()
        outage_s = None if self._last_frame_s is None else now_s - self._last_frame_s
        if watch.last_frame_s is None or watch.told_stalled:
            if outage_s is not None:
                with self._changed:
                    self._outages.append(outage_s)
            self._tell(SourceRunning(outage_s))
        watch.seen(now_s)
        with self._changed:
            self._last_frame_s = now_s
            self._received += 1
            self._current = ready.counts
            self.calibration = ready.calibration or self.calibration
            if self._newest is not None:
                self._dropped[SUPERSEDED] += 1
            self._newest = ready, partial(watch.ring.read, ready.content)
            self._changed.notify_all()

    def _judge(self, failed: ServiceFailed) -> str | None:
        error = pickle.loads(failed.error) if failed.error is not None else None
        if isinstance(error, SourceError) and not (isinstance(error, DeviceUnavailable) and self._received):
            self._error = error
            return None
        return failed.reason

    def _retire(self, watch: Watch) -> None:
        """End the child and give its ring back; a frame that still waits in it is copied out first."""
        with self._changed:
            if self._newest is not None:
                ready, read = self._newest
                pixels = read()
                self._newest = ready, lambda: pixels
            watch.ring.close()
        watch.child.stop()
        with self._changed:
            lost = self._current.waiting
            unpaired = Counter(self._current.unpaired) + Counter({WITH_PROCESS: lost})
            self._earlier = total((self._earlier, replace(self._current, unpaired=dict(unpaired), waiting=0)))
            self._current = FrameCounts(median_skew_s=self._earlier.median_skew_s)
