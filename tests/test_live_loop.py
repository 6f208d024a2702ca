"""The live loop's mechanics: nothing is lost uncounted, nothing waits in line, and it stops when it is told to."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterator

import psutil
import pytest
from benchmarks.paced import Idle, PacedSource, numbered_frame, numbered_recording
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.image_files import SourceError
from page_runtime.live.loop import LiveLoop
from page_runtime.live.result import LiveResult, LoopCounts
from page_runtime.live.slot import FrameSlot
from page_runtime.recorded import RecordedFrame


def balanced(counts: LoopCounts) -> bool:
    return counts.received == counts.processed + counts.dropped + counts.waiting


def test_a_slow_consumer_gets_the_newest_frame_each_time_and_every_other_one_is_counted_as_dropped() -> None:
    source, follower = PacedSource(60, 1 / 60), Idle(busy_s=0.05)
    with LiveLoop(source, follower) as loop:
        results = []
        for result in loop:
            assert balanced(result.counts)
            results.append(result)
    counts = loop.counts
    assert counts.received == source.sent == 60
    assert counts.processed == len(results) < 60
    assert counts.waiting == 0
    assert balanced(counts)
    indices = [result.frame.index for result in results]
    assert indices == sorted(set(indices))
    # Whenever a frame was taken, no newer one had been given to the loop: its index is that of the last one sent.
    for index in indices:
        taken_s = follower.taken_s[index]
        newer = [k for k, sent_s in enumerate(source.sent_s) if index < k and sent_s < taken_s - 0.02]
        assert not newer


def test_the_last_frame_is_processed_before_the_iteration_ends() -> None:
    follower = Idle(busy_s=0.02)
    with LiveLoop(PacedSource(20, 0.001), follower) as loop:
        results = list(loop)
    assert results[-1].frame.index == 19


def test_every_frame_of_a_recording_is_processed_however_slow_the_consumer_is() -> None:
    source = numbered_recording(25)
    with LiveLoop(source, Idle(busy_s=0.002)) as loop:
        indices = [result.frame.index for result in loop]
    assert indices == list(range(25))
    assert loop.counts == LoopCounts(received=25, processed=25)


def test_what_the_source_raises_is_raised_after_its_last_frame() -> None:
    source = PacedSource(3, 0.1, error=SourceError("the camera was unplugged"))
    with LiveLoop(source, Idle()) as loop:
        assert [next(loop).frame.index for _ in range(3)] == [0, 1, 2]
        with pytest.raises(SourceError, match="unplugged"):
            next(loop)
    assert balanced(loop.counts)


def test_a_stop_from_another_thread_ends_the_iteration_within_two_seconds() -> None:
    with LiveLoop(PacedSource(10**6, 0.01), Idle()) as loop:
        threading.Timer(0.1, loop.stop).start()
        began_s = time.monotonic()
        for _ in loop:
            pass
        assert time.monotonic() - began_s < 2.0
    assert balanced(loop.counts)
    assert loop.counts.waiting == 0


def test_a_source_that_cannot_be_stopped_and_gives_nothing_does_not_hold_up_the_end() -> None:
    def silent() -> Iterator[RecordedFrame]:
        yield numbered_frame(0)
        time.sleep(60)

    began_s = time.monotonic()
    with LiveLoop(silent(), Idle()) as loop:
        assert next(loop).frame.index == 0
    assert time.monotonic() - began_s < 2.0


def test_a_result_after_its_deadline_is_late_and_counted() -> None:
    with LiveLoop(PacedSource(5, 0.05), Idle(busy_s=0.02), deadline_s=0.001) as loop:
        results = list(loop)
    assert all(result.late for result in results)
    assert loop.counts.late == len(results)
    with LiveLoop(PacedSource(5, 0.01), Idle(), deadline_s=60.0) as loop:
        assert not any(result.late for result in loop)
    with pytest.raises(ValueError, match="deadline_s: expected seconds > 0"):
        LiveLoop(PacedSource(1, 0.01), Idle(), deadline_s=0.0)


def test_a_callback_gets_what_iterating_gives() -> None:
    given: list[LiveResult] = []
    source = numbered_recording(8)
    counts = LiveLoop(source, Idle()).run(given.append)
    assert [result.frame.index for result in given] == list(range(8))
    assert counts == LoopCounts(received=8, processed=8)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.booleans(), min_size=1, max_size=12), st.integers(0, 12))
def test_the_counters_balance_after_any_sequence_of_taking_and_answering(takes: list[bool], frames: int) -> None:
    slot = FrameSlot(PacedSource(frames, 0.0))
    for answer in takes:
        received = slot.take()
        assert balanced(slot.counts)
        if received is None:
            break
        if answer:
            assert balanced(slot.answered(late=False, searched=0, tracked=0, lost=0))
    slot.close()
    assert balanced(slot.counts)
    assert slot.counts.waiting == 0


def test_thousands_of_frames_leave_neither_threads_nor_descriptors_nor_memory_behind() -> None:
    process = psutil.Process()
    sizes = []
    for _ in range(4):
        with LiveLoop(PacedSource(1500, 0.0), Idle()) as loop:
            for _ in itertools.islice(loop, 1500):
                pass
        sizes.append((process.memory_info().rss, process.num_fds(), threading.active_count()))
    (_, descriptors, threads), (rss, *_), *_, last = sizes
    assert last[1:] == (descriptors, threads)
    # Allocators keep some pages; 6,000 kept frames would be 120 MB.
    assert last[0] - rss < 8e6


def test_a_short_soak_counts_every_frame_and_keeps_its_descriptors_and_threads() -> None:
    from benchmarks.soak import soaked

    before = threading.active_count()
    figures = soaked(200, 0.005, 0.02, quiet=True)
    assert figures["sent"] == figures["received"] == figures["processed"] + figures["dropped"] == 200
    assert figures["waiting"] == 0
    assert len(figures["descriptors"]) == 1
    assert figures["threads"] == [before + 1]
    assert figures["held"]["sent = processed + dropped"]
    assert figures["held"]["descriptors and threads constant"]


def test_the_soaks_bound_is_broken_by_whoever_takes_a_frame_when_the_next_is_there_and_by_no_slow_period() -> None:
    from benchmarks.soak import bound_excess_s

    source, follower = PacedSource(4, 0.1), Idle(frames=4)
    # The third period is three times as long as it should be, and frame 1 was dropped.
    source.sent_s[:] = source.stored_s[:] = [0.0, 0.1, 0.2, 0.5]
    follower.taken_s[[0, 2]], follower.done_s[[0, 2]] = [0.05, 0.49], [0.19, 0.9]
    assert bound_excess_s(source, follower) == pytest.approx(-0.01)
    follower.taken_s[2] = 0.53
    assert bound_excess_s(source, follower) == pytest.approx(0.03)
