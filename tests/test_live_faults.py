"""What one frame makes a stage raise costs that frame, is said once and counted, and does not end the loop."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.paced import Idle, numbered_frame
from hypothesis import given, settings
from hypothesis import strategies as st

import page_runtime.network as network_module
from followed_boxes import ROOT, at, hidden, only, region_of
from page_runtime import Network, NetworkError, RecordedFrame, live_results, open_source
from page_runtime.bundle import BundleMetadata
from page_runtime.cli import EXIT_FRAMES_FAILING, main
from page_runtime.live.deadline import Deadline
from page_runtime.live.each import EachByItself, Looked
from page_runtime.live.faults import MOST_FAILING, FrameFault, FramesFailing
from page_runtime.live.following import Tracking
from page_runtime.live.locate import OwnRegions
from page_runtime.live.loop import Followed, LiveLoop
from page_runtime.live.result import LiveResult
from page_runtime.neighbours import Neighbours
from page_runtime.pose import NotSeen, PartPose
from page_runtime.recorded import FrameEntry, Instance, Source
from page_runtime.sampling import Region, RegionSample

BOXES = ROOT / "tests" / "data" / "box"


class BadInput:
    """The session's input, of the wrong shape while `on`: onnxruntime itself refuses it."""

    def __init__(self, patch: pytest.MonkeyPatch, *, on: bool = False) -> None:
        self.on, self._feeds = on, network_module.feeds
        patch.setattr(network_module, "feeds", self)

    def __call__(self, metadata: BundleMetadata, sample: RegionSample, neighbours: Neighbours) -> dict[str, np.ndarray]:
        given = self._feeds(metadata, sample, neighbours)
        return given | {"points": given["points"][:, :7]} if self.on else given


def recording(frames: Sequence[RecordedFrame]) -> Source:
    """These frames one after the other, none of them dropped."""
    entry = open_source(BOXES).entries[0]

    def entry_of(one: RecordedFrame) -> FrameEntry:
        frame = one.frame
        return replace(
            entry,
            camera=frame.camera,
            index=frame.index,
            timestamp_s=frame.timestamp_s,
            instances=one.instances,
            decode=lambda: (frame.color, frame.depth_m),
        )

    return Source(path=Path("frames"), format="frames of a test", entries=tuple(map(entry_of, frames)))


def test_a_session_that_refuses_one_frame_costs_that_frame_and_is_said_by_type_and_place(
    network: Network, frames: list[RecordedFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    bad, told = BadInput(monkeypatch), list[FrameFault]()
    source = recording([at(frames[0], k) for k in range(9)])
    results: list[LiveResult] = []
    with live_results(source, network, on_event=told.append) as loop:
        for k in range(9):
            # The frames that ask the network are every third.
            bad.on = k in (3, 4)
            results.append(next(loop))
    assert [bool(result.objects) for result in results] == [True] * 3 + [False] * 2 + [True] * 4
    assert {found.number for result in results for found in result.objects} == {0}
    assert results[3].state == "reacquiring"
    assert "NetworkError" in results[3].reason
    assert [result.counts.failed for result in results] == [0, 0, 0, 1, 2, 2, 2, 2, 2]
    assert results[-1].counts.processed == 9
    assert len(told) == 1
    assert type(told[0].error) is NetworkError
    assert "INVALID_ARGUMENT" in str(told[0])
    assert str(told[0]).startswith("frame 3, object 0: NetworkError at page_runtime/network.py:")


def test_without_tracking_every_part_says_why_it_has_no_pose(
    network: Network, frames: list[RecordedFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = BadInput(monkeypatch)

    class Disturbed(EachByItself):
        def look(self, recorded: RecordedFrame, deadline: Deadline) -> Looked:
            bad.on = recorded.frame.index == 1
            return super().look(recorded, deadline)

    follower = Disturbed(network, OwnRegions(), max_looks=1)
    with LiveLoop(recording([at(frames[0], k) for k in range(3)]), follower) as loop:
        results = list(loop)
    poses = [only(result.objects).pose for result in results]
    assert all(isinstance(part, PartPose) for pose in (poses[0], poses[2]) for part in pose.parts)
    for part in poses[1].parts:
        assert isinstance(part, NotSeen)
        assert "NetworkError at page_runtime/network.py" in part.reason
    assert loop.counts.failed == 1


def test_a_frame_whose_region_lies_outside_it_costs_that_place_only(
    network: Network, frames: list[RecordedFrame]
) -> None:
    outside = Instance((5000, 10, 20, 20))
    strange = [replace(at(frames[0], k), instances=(outside, frames[0].instances[0])) for k in range(2)]
    with LiveLoop(recording(strange), EachByItself(network, OwnRegions(), max_looks=1)) as loop:
        for result in loop:
            refused, found = result.objects
            assert all(isinstance(part, NotSeen) and "lies outside" in part.reason for part in refused.pose.parts)
            assert all(isinstance(part, PartPose) for part in found.pose.parts)
    with LiveLoop(recording(strange), Tracking(network, OwnRegions())) as loop:
        assert [len(result.objects) for result in loop] == [1, 1]
    assert loop.counts.failed == 1


def test_one_place_that_always_fails_beside_empty_ones_is_not_the_end(
    network: Network, frames: list[RecordedFrame]
) -> None:
    places = (Instance((5000, 10, 20, 20)), Instance((100, 100, 80, 80)))
    empty = [replace(hidden(frames[0], k), instances=places) for k in range(MOST_FAILING + 3)]
    with LiveLoop(recording(empty), Tracking(network, OwnRegions())) as loop:
        reasons = [result.reason for result in loop]
    assert loop.counts.failed == len(reasons) == MOST_FAILING + 3
    assert all("lies outside" in reason and "not seen" in reason for reason in reasons)
    alone = [replace(one, instances=places[:1]) for one in empty]
    with (
        LiveLoop(recording(alone), Tracking(network, OwnRegions())) as loop,
        pytest.raises(FramesFailing, match="lies outside"),
    ):
        list(loop)


@dataclass(frozen=True)
class Broken:
    """Says where the object is until it breaks."""

    until: int
    most: int | None = None

    def locate(self, recorded: RecordedFrame) -> Sequence[Region]:
        if recorded.frame.index >= self.until:
            raise RuntimeError("the detector's library is out of memory")
        return (region_of(recorded),)


def test_who_is_followed_is_followed_on_when_nobody_can_say_where_others_are(
    network: Network, frames: list[RecordedFrame]
) -> None:
    told: list[FrameFault] = []
    with live_results(
        recording([at(frames[0], k) for k in range(40)]), network, Broken(until=1), on_event=told.append
    ) as loop:
        assert all(only(result.objects).number == 0 for result in loop)
    # It is asked once a second.
    assert loop.counts.failed == 1
    assert "RuntimeError at test_live_faults.py" in str(told[0])
    assert "where objects may be" in str(told[0])


@pytest.mark.parametrize("what", ["covariance", "T_a_part"])
def test_a_track_that_is_no_number_any_more_ends_and_the_object_is_found_anew(
    what: str, network: Network, frames: list[RecordedFrame]
) -> None:
    tracking = Tracking(network, OwnRegions(1))
    tracking.follow(at(frames[0], 0), Deadline())
    ((track, region),) = tracking._tracks
    spoilt = tuple(
        part and replace(part, motion=replace(part.motion, **{what: getattr(part.motion, what) * np.nan}))
        for part in track.parts
    )
    tracking._tracks = [(replace(track, parts=spoilt), region)]
    followed = [tracking.follow(at(frames[0], k), Deadline()) for k in range(1, 8)]
    found = only(followed[-1].objects)
    assert all(isinstance(part, PartPose) and np.isfinite(part.T_camera_part).all() for part in found.pose.parts)


def test_a_time_that_is_no_number_is_one_more_period(network: Network, frames: list[RecordedFrame]) -> None:
    tracking = Tracking(network, OwnRegions(1))
    for k in range(8):
        one = at(frames[0], k)
        if k in (0, 4):
            one = replace(one, frame=replace(one.frame, timestamp_s=float("nan")))
        followed = tracking.follow(one, Deadline(1e12))
        assert only(followed.objects).number == 0
        assert not followed.faults


class Script(Idle):
    """A follower that raises in some frames, each time another kind of exception."""

    def __init__(self, fails: Sequence[bool]) -> None:
        super().__init__(frames=len(fails))
        self._fails, self._kinds = fails, itertools.cycle([KeyError, ValueError, np.linalg.LinAlgError])

    def follow(self, recorded: RecordedFrame, deadline: Deadline) -> Followed:
        if self._fails[recorded.frame.index]:
            raise next(self._kinds)("this frame")
        return super().follow(recorded, deadline)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(1, MOST_FAILING + 3)), min_size=1, max_size=4))
def test_it_ends_after_so_many_failing_frames_in_a_row_or_where_all_fail_and_every_one_has_a_result(
    runs: list[tuple[bool, int]],
) -> None:
    fails = [fail for fail, length in runs for _ in range(length)]
    kept = next(
        (k + 1 for k in range(len(fails)) if k + 1 >= MOST_FAILING and all(fails[k + 1 - MOST_FAILING : k + 1])), None
    )
    told: list[FrameFault] = []
    frames = recording([numbered_frame(k) for k in range(len(fails))])
    results: list[LiveResult] = []
    with LiveLoop(frames, Script(fails), on_event=told.append) as loop:
        if kept is None and not all(fails):
            results += loop
        else:
            how_many = f"{MOST_FAILING} frames in a row" if kept else "all frames there were"
            with pytest.raises(FramesFailing, match=f"{how_many} failed, the last one by") as raised:
                loop.run(results.append)
            assert isinstance(raised.value.__cause__, (KeyError, ValueError))
    expected = fails[:kept]
    assert [bool(result.reason.endswith("this frame") or "'this frame'" in result.reason) for result in results] == (
        expected
    )
    assert loop.counts.failed == sum(expected)
    assert loop.counts.processed == len(expected)
    assert [type(fault.error) for fault in told] == [KeyError, ValueError, np.linalg.LinAlgError][: sum(expected)]


def test_a_command_in_which_every_frame_fails_ends_with_its_own_code_and_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    BadInput(monkeypatch, on=True)
    out = tmp_path / "o.jsonl"
    arguments = ["live", str(BOXES), "--bundle", str(ROOT / "runtime" / "bundles" / "box.onnx"), "--quiet"]
    assert main([*arguments, "--out", str(out)]) == EXIT_FRAMES_FAILING == 5
    first, last = capsys.readouterr().err.splitlines()
    assert "NetworkError at page_runtime/network.py" in first
    assert "the loop goes on" in first
    assert last.startswith("page-runtime: all frames there were failed")
    assert len(out.read_text().splitlines()) == len(open_source(BOXES).entries)
