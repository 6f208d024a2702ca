"""Results handed to any number of sinks, each in a thread of its own, none of which can slow the loop.

Between the loop and a sink lies a queue of bounded length. Where the sink is slower than the loop the oldest waiting
result makes room for the newest and is counted: a queue of one always holds the newest. Where the loop can wait, as
with a recording, a longer queue loses nothing. What a sink raises is counted, and told once.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from page_runtime.live.result import LiveResult
from page_runtime.sinks.sink import Sink, SinkOf

Item = TypeVar("Item")

# What only shows the present keeps the newest; what keeps a record rides out a second's pause of the disk. A waiting
# result holds its frame: 32 of 640 x 480 are 67 MB.
NEWEST = 1
EVERY = 32
CLOSE_S = 1.5
# How soon a loop that waits for a sink sees that it is to end.
_LOOK_S = 0.05


@dataclass(frozen=True, slots=True)
class SinkCounts:
    """Counters of one sink; given = written + dropped + failed + waiting at any time.

    given: results the loop handed over. written: those the sink took. dropped: those that made room for newer ones,
    or came after the end. failed: those whose write raised. waiting: those in the queue or being written. fault: the
    last thing that was raised, in words, empty for none. closed: whether the sink has finished its files.
    """

    given: int = 0
    written: int = 0
    dropped: int = 0
    failed: int = 0
    waiting: int = 0
    fault: str = ""
    closed: bool = False


@dataclass(eq=False, slots=True)
class QueuedSink(Generic[Item]):
    """A sink behind a queue of `capacity` results, or whatever it takes. tell: is given a sentence at the first fault.
    waits: while it is true, `put` waits for room in a queue of more than one. reader_gone: called instead of `tell`
    when nobody reads a pipe any more.

    Otherwise `put` never waits for the sink. It runs from `start` to `finish`.
    """

    sink: SinkOf[Item]
    capacity: int = NEWEST
    tell: Callable[[str], None] = lambda _: None
    waits: Callable[[], bool] = lambda: False
    reader_gone: Callable[[], None] | None = None
    _waiting: deque[Item] = field(default_factory=deque)
    _changed: threading.Condition = field(default_factory=threading.Condition)
    _thread: threading.Thread | None = None
    _deadline_s: float | None = None
    _busy: bool = False
    _counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("given", "written", "dropped", "failed"), 0))
    _fault: str = ""
    _abandoned: bool = False
    _closed: bool = False

    def __post_init__(self) -> None:
        if self.capacity < 1:
            raise ValueError(f"QueuedSink {self.name}: expected a capacity of at least 1, got {self.capacity}")

    @property
    def name(self) -> str:
        """As in messages and counters."""
        return self.sink.name

    @property
    def counts(self) -> SinkCounts:
        """What became of the results so far."""
        with self._changed:
            waiting = len(self._waiting) + self._busy
            return SinkCounts(**self._counts, waiting=waiting, fault=self._fault, closed=self._closed)

    @property
    def abandoned(self) -> bool:
        """Whether it was a pipe whose reader went away, and `reader_gone` was called."""
        return self._abandoned

    def start(self) -> None:
        """Start the thread. A daemon: a sink that hangs must not keep the process from ending."""
        self._thread = threading.Thread(target=self._run, name=f"sink {self.name}", daemon=True)
        self._thread.start()

    def put(self, result: Item) -> None:
        """Queue one result, the oldest waiting one making room where there is none and it does not wait."""
        with self._changed:
            while len(self._waiting) == self.capacity > NEWEST and self._deadline_s is None and self.waits():
                self._changed.wait(_LOOK_S)
            self._counts["given"] += 1
            if self._deadline_s is not None:
                self._counts["dropped"] += 1
                return
            if len(self._waiting) == self.capacity:
                self._waiting.popleft()
                self._counts["dropped"] += 1
            self._waiting.append(result)
            self._changed.notify_all()

    def drain(self) -> None:
        """Return when nothing waits any more in a queue of more than one, or there is no waiting."""
        with self._changed:
            while self._waiting and self.capacity > NEWEST and self.waits():
                self._changed.wait(_LOOK_S)

    def finish(self, deadline_s: float) -> None:
        """Take no more results; the waiting ones are written until `deadline_s` (time.monotonic), then it closes."""
        with self._changed:
            if self._deadline_s is None:
                self._deadline_s = deadline_s
            self._changed.notify_all()

    def join(self, deadline_s: float) -> bool:
        """Wait for the end until `deadline_s` (time.monotonic); whether the sink is closed."""
        if self._thread is not None:
            self._thread.join(max(0.0, deadline_s - time.monotonic()))
        return self.counts.closed

    def _run(self) -> None:
        while (result := self._next()) is not None:
            try:
                self.sink.write(result)
            except Exception as error:
                # A sink may raise anything; whatever it is must reach neither the loop nor the other sinks.
                self._done("failed", error)
            else:
                self._done("written")
        try:
            self.sink.close()
        except Exception as error:
            self._note(error)
        with self._changed:
            self._closed = True

    def _next(self) -> Item | None:
        with self._changed:
            while not self._waiting and self._deadline_s is None:
                self._changed.wait()
            if self._deadline_s is not None and time.monotonic() >= self._deadline_s:
                self._counts["dropped"] += len(self._waiting)
                self._waiting.clear()
            if not self._waiting:
                return None
            self._busy = True
            self._changed.notify_all()
            return self._waiting.popleft()

    def _done(self, outcome: str, error: Exception | None = None) -> None:
        with self._changed:
            self._busy = False
            self._counts[outcome] += 1
        if error is not None:
            self._note(error)

    def _note(self, error: Exception) -> None:
        with self._changed:
            is_first = not self._fault
            self._fault = " ".join(f"{error}".split()) or type(error).__name__
            self._abandoned = self.reader_gone is not None and isinstance(error, BrokenPipeError)
        if self._abandoned and self.reader_gone is not None:
            self.reader_gone()
        elif is_first:
            self.tell(f"{self.name}: {self._fault}; the loop goes on without it, and this is not said again")


class Sinks:
    """All sinks of a loop: `with Sinks(...) as sinks: ... sinks.put(result)`.

    The threads run inside the block. At its end every sink finishes its files within `close_s` seconds in all; one
    that does not is told of and left behind.
    """

    def __init__(
        self,
        sinks: Iterable[tuple[Sink, int]],
        *,
        tell: Callable[[str], None] = lambda _: None,
        waits: Callable[[], bool] = lambda: False,
        reader_gone: Callable[[], None] | None = None,
        close_s: float = CLOSE_S,
    ) -> None:
        """sinks: each with the length of its queue (NEWEST, EVERY). tell: takes a sentence, from any thread. waits:
        while it is true, a queue of more than one is waited for, and none of its results is dropped; for recordings.
        reader_gone: called, from any thread, instead of telling that a pipe's reader went away."""
        self._queued = tuple(QueuedSink(sink, capacity, tell, waits, reader_gone) for sink, capacity in sinks)
        self._tell, self._close_s = tell, close_s

    def __enter__(self) -> Sinks:
        for queued in self._queued:
            queued.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self._queued)

    def put(self, result: LiveResult) -> None:
        """Give a result to every sink; returns at once, unless it `waits`."""
        for queued in self._queued:
            queued.put(result)

    def drain(self) -> None:
        """At the end of a recording: return when every sink that is waited for has what was given to it."""
        for queued in self._queued:
            queued.drain()

    @property
    def counts(self) -> dict[str, SinkCounts]:
        """The counters of every sink by its name."""
        return {queued.name: queued.counts for queued in self._queued}

    def close(self) -> None:
        """Finish every sink at the same time; writing what waits may take half of the seconds there are."""
        begin_s = time.monotonic()
        for queued in self._queued:
            queued.finish(begin_s + self._close_s / 2)
        for queued in self._queued:
            if not queued.join(begin_s + self._close_s):
                self._tell(f"{queued.name}: did not close within {self._close_s:g} s and is left behind")
        for queued in self._queued:
            counts = queued.counts
            if (counts.dropped or counts.failed) and not queued.abandoned:
                self._tell(
                    f"{queued.name}: of {counts.given} results {counts.written} written, {counts.dropped} passed over "
                    f"for newer ones, {counts.failed} failed"
                )
