"""The next frame's network beside the scoring of this one: both at once, nothing grows old or is lost uncounted."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from benchmarks.paced import IdleAhead, PacedSource, numbered_frame, numbered_recording
from hypothesis import given, settings
from hypothesis import strategies as st

from followed_boxes import ROOT, box_network
from page_runtime.capture.playback import open_source
from page_runtime.image_files import SourceError
from page_runtime.live import loop as loop_module
from page_runtime.live.deadline import Deadline
from page_runtime.live.each import EachByItself
from page_runtime.live.faults import FrameFault, FramesFailing
from page_runtime.live.locate import OwnRegions, RegionError
from page_runtime.live.loop import LOOK_AHEAD_PROCESSORS, Followed, LiveLoop, LooksAhead
from page_runtime.pose import PartPose
from page_runtime.recorded import RecordedFrame


@pytest.fixture(autouse=True)
def processors_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_module, "available_processors", lambda: LOOK_AHEAD_PROCESSORS)


def test_the_next_frame_is_looked_at_while_this_one_is_answered() -> None:
    class Waiting(IdleAhead):
        """Answers a frame when the next one is being looked at, and not before."""

        def __init__(self) -> None:
            super().__init__()
            self.begun = [threading.Event() for _ in range(11)]

        def look(self, recorded: RecordedFrame, deadline: Deadline) -> int:
            self.begun[recorded.frame.index].set()
            return super().look(recorded, deadline)

        def answer(self, recorded: RecordedFrame, looked: int, deadline: Deadline) -> Followed:
            number = recorded.frame.index
            assert number == 9 or self.begun[number + 1].wait(10)
            assert not self.begun[number + 2 if number < 9 else 10].is_set()  # one ahead, not two
            return super().answer(recorded, looked, deadline)

    with LiveLoop(numbered_recording(10), Waiting()) as loop:
        results = list(loop)
    assert [result.frame.index for result in results] == list(range(10))
    assert not any(result.reason for result in results)
    assert (loop.counts.processed, loop.counts.failed, loop.counts.waiting) == (10, 0, 0)


def test_poses_are_those_of_one_frame_after_the_other() -> None:
    network = box_network()
    source = open_source(ROOT / "tests" / "data" / "box")
    follower = EachByItself(network, OwnRegions(), max_looks=2)
    assert isinstance(follower, LooksAhead)
    expected = [follower.follow(recorded, Deadline()) for recorded in source]
    with LiveLoop(source, follower) as loop:
        results = list(loop)
    assert len(results) == len(expected) > 1
    for result, alone in zip(results, expected, strict=True):
        assert set(result.stage_ms) == set(alone.stage_ms)
        for found, wanted in zip(result.objects, alone.objects, strict=True):
            assert found.pose.looks == wanted.pose.looks
            for part, other in zip(found.pose.parts, wanted.pose.parts, strict=True):
                assert type(part) is type(other)
                if isinstance(part, PartPose) and isinstance(other, PartPose):
                    np.testing.assert_array_equal(part.T_camera_part, other.T_camera_part)
                    assert part.confidence == other.confidence


def test_a_look_is_of_the_newest_frame_and_does_not_wait_for_the_scorer() -> None:
    source, follower = PacedSource(120, 0.01), IdleAhead(0.03, 0.08)
    with LiveLoop(source, follower) as loop:
        indices = [result.frame.index for result in loop]
    assert loop.counts.received == source.sent == 120
    assert loop.counts.received == loop.counts.processed + loop.counts.dropped
    assert indices == sorted(set(indices))
    for index in indices:
        taken_s = follower.taken_s[index]
        assert not [k for k, sent_s in enumerate(source.sent_s) if index < k and sent_s < taken_s - 0.05]
    # Begun as soon as there was room a look would wait 50 ms; after the first ones it is known how long they take.
    waited_s = (follower.asked_s - follower.looked_s)[indices[3:]]
    assert np.median(waited_s) < 0.025


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 12), st.integers(0, 12), st.sampled_from([0.0, 0.002]))
def test_the_counters_balance_whenever_the_caller_has_enough(frames: int, wanted: int, busy_s: float) -> None:
    with LiveLoop(PacedSource(frames, 0.0), IdleAhead(busy_s, busy_s)) as loop:
        for count, result in enumerate(loop, 1):
            assert result.counts.received == result.counts.processed + result.counts.dropped + result.counts.waiting
            if count == wanted:
                break
    counts = loop.counts
    assert counts.waiting == 0
    assert counts.received == counts.processed + counts.dropped


def test_what_a_look_raises_comes_with_its_frame() -> None:
    class Raising(IdleAhead):
        def look(self, recorded: RecordedFrame, deadline: Deadline) -> int:
            if recorded.frame.index == 1:
                raise RegionError("region: expected inside the picture")
            if recorded.frame.index == 2:
                raise ZeroDivisionError
            return super().look(recorded, deadline)

    told: list[FrameFault] = []
    with LiveLoop(numbered_recording(4), Raising(), on_event=told.append) as loop:
        assert next(loop).frame.index == 0
        with pytest.raises(RegionError, match="inside the picture"):
            next(loop)
        failed = next(loop)
        assert failed.frame.index == 2
        assert failed.reason.startswith("ZeroDivisionError")
        assert [result.frame.index for result in loop] == [3]
    assert [fault.frame for fault in told] == [2]
    assert (loop.counts.processed, loop.counts.dropped, loop.counts.failed) == (3, 1, 1)


def test_a_loop_all_of_whose_looks_fail_ends() -> None:
    class Failing(IdleAhead):
        def look(self, recorded: RecordedFrame, deadline: Deadline) -> int:
            del recorded, deadline
            raise ZeroDivisionError

    with (
        LiveLoop(numbered_recording(5), Failing()) as loop,
        pytest.raises(FramesFailing, match="all frames there were"),
    ):
        list(loop)


def test_what_the_source_raises_is_raised_after_its_last_frame() -> None:
    with LiveLoop(PacedSource(3, 0.1, error=SourceError("the camera was unplugged")), IdleAhead()) as loop:
        assert [next(loop).frame.index for _ in range(3)] == [0, 1, 2]
        with pytest.raises(SourceError, match="unplugged"):
            next(loop)


def test_a_stop_ends_it_and_leaves_no_thread() -> None:
    before = threading.active_count()
    with LiveLoop(PacedSource(10**6, 0.01), IdleAhead(0.005, 0.02)) as loop:
        threading.Timer(0.2, loop.stop).start()
        began_s = time.monotonic()
        results = list(loop)
        assert time.monotonic() - began_s < 2.0
    assert results
    assert loop.counts.waiting == 0
    deadline_s = time.monotonic() + 5
    while threading.active_count() > before:
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def test_a_silent_source_does_not_hold_up_the_end() -> None:
    def silent() -> Iterator[RecordedFrame]:
        yield numbered_frame(0)
        time.sleep(60)

    began_s = time.monotonic()
    with LiveLoop(silent(), IdleAhead()) as loop:
        assert next(loop).frame.index == 0
    assert time.monotonic() - began_s < 2.0


def test_on_fewer_processors_one_frame_comes_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_module, "available_processors", lambda: LOOK_AHEAD_PROCESSORS - 1)
    before, follower = threading.active_count(), IdleAhead()
    with LiveLoop(numbered_recording(3), follower) as loop:
        assert threading.active_count() <= before + 1
        assert len(list(loop)) == 3
    assert np.isnan(follower.looked_s).all()


def test_closing_ends_a_look_that_goes_on_and_its_thread() -> None:
    class Long(IdleAhead):
        begun = threading.Event()

        def look(self, recorded: RecordedFrame, deadline: Deadline) -> int:
            if recorded.frame.index:
                self.begun.set()
                for _ in range(500):
                    if deadline.stopping():
                        break
                    time.sleep(0.01)
            return super().look(recorded, deadline)

    before, follower = threading.active_count(), Long()
    with LiveLoop(numbered_recording(5), follower) as loop:
        assert next(loop).frame.index == 0
        assert follower.begun.wait(5)
        began_s = time.monotonic()
    assert time.monotonic() - began_s < 0.8
    assert threading.active_count() == before
    assert loop.counts.waiting == 0


def test_a_result_is_not_as_old_as_a_pause_of_whoever_takes_them() -> None:
    with LiveLoop(PacedSource(10**6, 0.01), IdleAhead(0.02, 0.04)) as loop:
        for _ in range(6):
            next(loop)
        time.sleep(1.0)
        paused = next(loop)
        assert paused.latency_ms < 500
        counts = next(loop).counts
    assert counts.received == counts.processed + counts.dropped + counts.waiting


def test_a_frame_whose_event_raises_is_not_counted_as_waiting_for_ever() -> None:
    class Failing(IdleAhead):
        def answer(self, recorded: RecordedFrame, looked: int, deadline: Deadline) -> Followed:
            if recorded.frame.index < 1:
                raise ZeroDivisionError
            return super().answer(recorded, looked, deadline)

    def refuse(fault: FrameFault) -> None:
        raise KeyError(str(fault))

    with LiveLoop(numbered_recording(4), Failing(), on_event=refuse) as loop:
        with pytest.raises(KeyError):
            next(loop)
        *_, last = list(loop)
    assert (last.counts.processed, last.counts.dropped, last.counts.waiting) == (3, 1, 0)


def test_the_counters_hold_when_another_thread_closes_the_loop() -> None:
    loop = LiveLoop(PacedSource(10**6, 0.005), IdleAhead(0.005, 0.1))
    threading.Timer(0.15, loop.close).start()
    for result in loop:
        counts = result.counts
        assert counts.waiting >= 0
        assert counts.received == counts.processed + counts.dropped + counts.waiting
    assert loop.counts.waiting == 0


def test_a_program_that_ends_in_the_middle_of_a_look_ends_well(tmp_path: Path) -> None:
    script = tmp_path / "ends.py"
    script.write_text(
        """
import sys
from page_runtime import Network, open_source
from page_runtime.live import loop
from page_runtime.live.each import EachByItself

loop.available_processors = lambda: loop.LOOK_AHEAD_PROCESSORS


class Many:
    most = None

    def locate(self, recorded):
        return [recorded.instances[0].region] * (1 if recorded.frame.index == 0 else 600)


results = loop.LiveLoop(open_source(sys.argv[1]), EachByItself(Network(sys.argv[2], threads=1), Many()))
print(next(results).frame.index)
"""
    )
    given = [str(ROOT / "tests" / "data" / "box"), str(ROOT / "runtime" / "bundles" / "box.onnx")]
    done = subprocess.run([sys.executable, str(script), *given], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "0\n"
