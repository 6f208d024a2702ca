"""The bounded real-time loop: the newest frame in, its objects out, and never a backlog.

    with live_results("oak" or a source, network) as results:
        for result in results: ...

A thread captures into a queue of one (`slot`); the frame is worked on by whoever asks for the next result. So while
that one is busy, frames are passed over and counted, and the frame it gets next is at most one period old: the age of a
result is at most a period and the time the frame took. Where frames do not depend on each other and processors are to
spare, another thread has the network look at the next one meanwhile (`ahead`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, NoReturn, Protocol, TypeVar, runtime_checkable

from page_runtime.live.ahead import LookingAhead
from page_runtime.live.deadline import Deadline
from page_runtime.live.faults import MOST_FAILING, FrameFault, FramesFailing, attempt
from page_runtime.live.result import LiveObject, LiveResult, LiveState, LoopCounts
from page_runtime.live.slot import STOP_WAIT_S, FrameSlot, Received
from page_runtime.machine import available_processors
from page_runtime.recorded import RecordedFrame, Source

LOOK_AHEAD_PROCESSORS = 3

T = TypeVar("T")


@dataclass(frozen=True, eq=False, slots=True)
class Followed:
    """What became of the objects in one frame. reason: why there is none. searched, tracked, lost: as in `LoopCounts`,
    of this frame. faults: what was raised on the way; failed: whether that is all that came of the frame."""

    objects: tuple[LiveObject, ...]
    state: LiveState
    stage_ms: dict[str, float] = field(default_factory=dict)
    reason: str = ""
    searched: int = 0
    tracked: int = 0
    lost: int = 0
    faults: tuple[FrameFault, ...] = ()
    failed: bool = False


_Work = Callable[[], Followed | FrameFault]


class Follower(Protocol):
    """Whoever finds the objects of one frame after the other, and remembers them. What `follow` raises costs the frame:
    it must leave the follower fit for the next one."""

    def follow(self, recorded: RecordedFrame, deadline: Deadline) -> Followed: ...


@runtime_checkable
class LooksAhead(Follower, Protocol):
    """A follower whose first half needs nothing of earlier frames: `look` is called in another thread, while `answer`
    works on the frame before. `follow` is one after the other."""

    def look(self, recorded: RecordedFrame, deadline: Deadline) -> Any: ...

    def answer(self, recorded: RecordedFrame, looked: Any, deadline: Deadline) -> Followed: ...


def can_look_ahead() -> bool:
    """Whether there are processors enough to score one frame while the network has the next one.

    On two, both of which the network can use, results were half as old again, and of laptops 10 % more, of drawers 10 %
    fewer (a source of 30 frames/s, in turns).
    """
    return available_processors() >= LOOK_AHEAD_PROCESSORS


class LiveLoop:
    """Results of `follower` for the frames of `source`, as they come: an iterator, to be closed (or used in `with`).

    deadline_s: from the moment a frame was received; work that would not be done by then is left out where that is
    possible, and a result after it is `late`. on_event: called in the iterating thread with the first `FrameFault` of
    each kind; the frame has a result that says so, and `LoopCounts.failed` counts it.

    A follower that `LooksAhead` does so where there are processors for it (`can_look_ahead`).

    Iterating ends with the source or with `stop`. It raises what the source raises (SourceError); RegionError and other
    errors in what was asked for; and FramesFailing after MOST_FAILING frames in a row, or all there were, from which
    nothing came but faults.
    """

    def __init__(
        self,
        source: Iterable[RecordedFrame],
        follower: Follower,
        *,
        deadline_s: float | None = None,
        name: str = "source",
        on_event: Callable[[FrameFault], None] = lambda _: None,
    ) -> None:
        if deadline_s is not None and not deadline_s > 0.0:
            raise ValueError(f"deadline_s: expected seconds > 0 or None, got {deadline_s}; None is no deadline")
        self._follower, self._deadline_s = follower, deadline_s
        self._on_event, self._told = on_event, set[tuple[str, str]]()
        # Of frames in a row; and the last of their faults, as each holds what its frame was worked on with.
        self._failing = 0
        self._last_fault: FrameFault | None = None
        self._state: LiveState = "searching"
        self._stopping = False
        self._slot = FrameSlot(source, name=name)
        self._ahead: LookingAhead[_Work] | None = None
        if isinstance(follower, LooksAhead) and can_look_ahead():
            ahead = follower
            self._ahead = LookingAhead(
                self._slot, lambda received: self._look(ahead, received), in_time=not isinstance(source, Source)
            )

    def __iter__(self) -> Iterator[LiveResult]:
        return self

    def __next__(self) -> LiveResult:
        if self._failing >= MOST_FAILING:
            self._give_up(f"{MOST_FAILING} frames in a row")
        taken = self._take()
        if taken is None:
            self.close()
            if self._failing and not self._stopping and self._failing == self.counts.processed:
                self._give_up("all frames there were")
            raise StopIteration
        return self._result(*taken)

    def run(self, on_result: Callable[[LiveResult], None]) -> LoopCounts:
        """Call `on_result` with every result until the source ends or `stop` is called, then close; the counters."""
        with self:
            for result in self:
                on_result(result)
        return self.counts

    def stop(self) -> None:
        """End the iteration after the result of the moment, from which places not looked at yet are left out; does not
        wait, and may be called by a signal's handler."""
        self._stopping = True
        self._slot.stop()

    @property
    def stopping(self) -> bool:
        """Whether `stop` was called, be it after the end."""
        return self._stopping

    def close(self) -> None:
        """Stop, and give the threads back; a frame that waits counts as dropped."""
        began_s = time.monotonic()
        self._slot.close()
        if self._ahead is not None:
            self._ahead.close(max(0.1, began_s + STOP_WAIT_S - time.monotonic()))

    def __enter__(self) -> LiveLoop:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    @property
    def counts(self) -> LoopCounts:
        """received = processed + dropped + waiting, at any time."""
        return self._slot.counts

    def _take(self) -> tuple[Received, _Work] | None:
        """The next frame, and how its objects come about."""
        if self._ahead is not None:
            return self._ahead.take()
        received = self._slot.take()
        return None if received is None else (received, lambda: self._attempt(self._follower.follow, received))

    def _look(self, follower: LooksAhead, received: Received) -> _Work:
        looked = self._attempt(follower.look, received)
        if isinstance(looked, FrameFault):
            return lambda: looked
        return lambda: self._attempt(lambda recorded, until: follower.answer(recorded, looked, until), received)

    def _attempt(self, work: Callable[[RecordedFrame, Deadline], T], received: Received) -> T | FrameFault:
        recorded, deadline = received.recorded, self._deadline_of(received)
        return attempt(lambda: work(recorded, deadline), frame=recorded.frame.index)

    def _deadline_of(self, received: Received) -> Deadline:
        at_s = None if self._deadline_s is None else received.received_s + self._deadline_s
        return Deadline(at_s, lambda: self._slot.closing)

    def _result(self, received: Received, work: _Work) -> LiveResult:
        recorded = received.recorded
        try:
            followed = work()
            if isinstance(followed, FrameFault):
                followed = Followed((), self._state, reason=followed.reason, faults=(followed,), failed=True)
            self._note(followed)
        except BaseException:
            self._slot.abandoned()
            raise
        late = self._deadline_of(received).passed
        latency_ms = 1e3 * (time.monotonic() - received.received_s)
        counts = self._slot.answered(
            late=late,
            searched=followed.searched,
            tracked=followed.tracked,
            lost=followed.lost,
            failed=bool(followed.faults),
        )
        return LiveResult(
            frame=recorded.frame,
            objects=followed.objects,
            state=followed.state,
            counts=counts,
            latency_ms=latency_ms,
            stage_ms=followed.stage_ms,
            late=late,
            reason=followed.reason,
        )

    def _note(self, followed: Followed) -> None:
        self._state = followed.state
        if followed.failed:
            self._failing, self._last_fault = self._failing + 1, followed.faults[-1]
        else:
            self._failing, self._last_fault = 0, None
        for fault in followed.faults:
            if fault.kind not in self._told:
                self._told.add(fault.kind)
                self._on_event(fault)

    def _give_up(self, how_many: str) -> NoReturn:
        self.close()
        last = self._last_fault
        assert last is not None
        raise FramesFailing(f"{how_many} failed, the last one by {last.reason}") from last.error
