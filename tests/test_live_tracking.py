"""Objects found and followed, by the shipped network on recorded frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from page_runtime import Network, RecordedFrame, live_results, open_source
from page_runtime.estimator import Examined, estimate, examine
from page_runtime.evaluation import rotation_error, translation_error
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import rotation_about, transform_from
from page_runtime.live import following
from page_runtime.live.advance import observation, trust
from page_runtime.live.deadline import Deadline
from page_runtime.live.following import EachByItself, Tracking
from page_runtime.live.locate import FixedRegion, OwnRegions, covered, overlap
from page_runtime.live.loop import LiveLoop
from page_runtime.live.near import fit_near, pose_near
from page_runtime.live.prior import expected_region
from page_runtime.live.result import LiveObject
from page_runtime.live.track import begun, prior_of
from page_runtime.live.vote_window import votes_near
from page_runtime.pose import ArticulatedPose, PartPose
from page_runtime.sampling import Region
from page_runtime.scoring import score_keypoints
from page_runtime.stopwatch import Stopwatch

ROOT = Path(__file__).resolve().parents[1]
PERIOD_S = 1 / 30


@pytest.fixture(scope="module")
def network() -> Network:
    return Network(ROOT / "runtime" / "bundles" / "box.onnx", threads=1)


@pytest.fixture(scope="module")
def frames(network: Network) -> list[RecordedFrame]:
    """Frames whose object a single look recognises well."""
    recorded = list(open_source(ROOT / "tests" / "data" / "box"))
    good = [one for one in recorded if trust(estimate(network, one.frame, region_of(one), max_looks=1)) > 0.8]
    assert len(good) >= 2
    return good


def region_of(recorded: RecordedFrame) -> Region:
    region = recorded.instances[0].region
    assert region is not None
    return region


def at(recorded: RecordedFrame, index: int, *, noise: int | None = None) -> RecordedFrame:
    """The same frame, later; noise: of depth, by this seed."""
    depth_m = recorded.frame.depth_m
    if noise is not None:
        depth_m = depth_m + np.random.default_rng(noise).normal(0.0, 0.001, depth_m.shape).astype(np.float32)
        depth_m = np.where(recorded.frame.depth_m > 0, depth_m, np.float32(0))
    frame = replace(recorded.frame, depth_m=depth_m, timestamp_s=index * PERIOD_S, index=index)
    return RecordedFrame(frame, recorded.instances)


def hidden(recorded: RecordedFrame, index: int) -> RecordedFrame:
    """A board right before the camera."""
    frame = recorded.frame
    color, depth_m = np.full_like(frame.color, 128), np.full_like(frame.depth_m, 0.2)
    return RecordedFrame(RgbdFrame(color, depth_m, frame.camera, index * PERIOD_S, index))


def only(objects: tuple[LiveObject, ...]) -> LiveObject:
    (found,) = objects
    return found


def apart(one: ArticulatedPose, other: ArticulatedPose) -> tuple[float, float]:
    """Largest rotation [rad] and translation [m] between the parts of two poses."""
    pairs = [
        (a.T_camera_part, b.T_camera_part)
        for a, b in zip(one.parts, other.parts, strict=True)
        if isinstance(a, PartPose) and isinstance(b, PartPose)
    ]
    assert pairs
    return max(rotation_error(*pair) for pair in pairs), max(translation_error(*pair) for pair in pairs)


def test_an_object_is_followed_under_its_number_at_the_pose_a_full_search_finds(
    network: Network, frames: list[RecordedFrame]
) -> None:
    full = estimate(network, frames[0].frame, region_of(frames[0]), max_looks=1)
    tracking = Tracking(network, FixedRegion(region_of(frames[0])))
    tracked = []
    for k in range(12):
        followed = tracking.follow(at(frames[0], k, noise=k), Deadline())
        assert followed.state == "tracking"
        found = only(followed.objects)
        assert found.number == 0
        tracked.append(found.tracked)
        rotation_rad, translation_m = apart(found.pose, full)
        assert rotation_rad < np.radians(6.0)
        assert translation_m < 0.015
        assert len(found.joint_rates) == 1
    assert tracked == [False, *[True] * 11]


def test_two_frames_in_three_do_without_the_network(network: Network, frames: list[RecordedFrame]) -> None:
    tracking = Tracking(network, FixedRegion(region_of(frames[0])))
    asked = [
        only(tracking.follow(at(frames[0], k), Deadline()).objects).pose.stage_ms["network"] > 0 for k in range(10)
    ]
    assert asked == [True, *[False, False, True] * 3]


def test_an_object_hidden_for_ten_frames_keeps_its_number_and_none_is_claimed_meanwhile(
    network: Network, frames: list[RecordedFrame]
) -> None:
    tracking = Tracking(network, FixedRegion(region_of(frames[0])))
    for k in range(4):
        tracking.follow(at(frames[0], k), Deadline())
    for k in range(4, 14):
        followed = tracking.follow(hidden(frames[0], k), Deadline())
        assert followed.objects == ()
        assert followed.reason
        assert followed.state == "reacquiring"
    followed = tracking.follow(at(frames[0], 14), Deadline())
    assert only(followed.objects).number == 0
    assert followed.state == "tracking"


def test_an_object_gone_for_longer_is_lost_once_and_found_again_under_its_number(
    network: Network, frames: list[RecordedFrame]
) -> None:
    tracking = Tracking(network, FixedRegion(region_of(frames[0])))
    tracking.follow(at(frames[0], 0), Deadline())
    lost = sum(tracking.follow(hidden(frames[0], k), Deadline()).lost for k in range(1, 30))
    assert lost == 1
    assert only(tracking.follow(at(frames[0], 30), Deadline()).objects).number == 0


def test_a_clock_that_starts_again_runs_at_its_own_pace_from_there(
    network: Network, frames: list[RecordedFrame]
) -> None:
    tracking = Tracking(network, FixedRegion(region_of(frames[0])))
    for k in range(3):
        tracking.follow(at(frames[0], 100_000 + k), Deadline())
    # A fifth of a second apart: lost is who was away for more than 0.4 s.
    lost = [tracking.follow(hidden(frames[0], 6 * k), Deadline()).lost for k in range(5)]
    assert lost == [0, 0, 1, 0, 0]


def test_a_wrong_pose_does_not_keep_itself_alive(network: Network, frames: list[RecordedFrame]) -> None:
    tracking = Tracking(network, OwnRegions(1))
    tracking.follow(at(frames[0], 0), Deadline())
    ((track, region),) = tracking._tracks
    turn = transform_from(rotation_about(np.array([0.0, 0.0, 1.0]), np.pi), np.zeros(3))
    flipped = tuple(
        part and replace(part, motion=replace(part.motion, T_a_part=part.motion.T_a_part @ turn))
        for part in track.parts
    )
    tracking._tracks = [(replace(track, parts=flipped), region)]
    full = estimate(network, frames[0].frame, region_of(frames[0]), max_looks=1)
    errors = []
    for k in range(1, 45):
        objects = tracking.follow(at(frames[0], k), Deadline()).objects
        if objects:
            errors.append(apart(only(objects).pose, full)[0])
    # A full search every second, twice in a row against the track.
    assert errors[-1] < np.radians(8.0)


def test_another_place_is_another_pose_within_two_frames(network: Network, frames: list[RecordedFrame]) -> None:
    tracking = Tracking(network, OwnRegions(1))
    for k in range(5):
        tracking.follow(at(frames[0], k), Deadline())
    tracking.follow(at(frames[1], 5), Deadline())
    followed = tracking.follow(at(frames[1], 6), Deadline())
    full = estimate(network, frames[1].frame, region_of(frames[1]), max_looks=1)
    rotation_rad, translation_m = apart(only(followed.objects).pose, full)
    assert rotation_rad < np.radians(10.0)
    assert translation_m < 0.03


def test_the_estimate_from_an_expected_pose_is_that_of_the_search(
    network: Network, frames: list[RecordedFrame]
) -> None:
    frame = frames[0].frame
    seen = examine(network, frame, region_of(frames[0]), max_looks=1)
    assert seen.sample is not None
    assert seen.output is not None
    category = network.metadata.category
    track = begun(0, category, observation(frame, seen.sample, seen.output, seen.pose), frame.camera, 0.0)
    prior = prior_of(track, frame.camera, PERIOD_S)
    near = pose_near(network.metadata, seen.sample, seen.output, prior, Stopwatch())
    rotation_rad, translation_m = apart(near, seen.pose)
    assert rotation_rad < np.radians(1.0)
    assert translation_m < 0.002
    assert abs(trust(near) - trust(seen.pose)) < 0.1
    region = expected_region(prior, category, frame.camera)
    assert region is not None
    assert covered(region_of(frames[0]), region) > 0.7
    colors = frame.color.reshape(-1, 3)[seen.sample.source_index]
    fitted = fit_near(category, seen.sample, colors, prior, Stopwatch())
    assert not isinstance(fitted, str)
    assert apart(fitted.pose, seen.pose)[0] < np.radians(3.0)
    repainted = fit_near(category, seen.sample, 255 - colors, prior, Stopwatch())
    assert isinstance(repainted, str)


def test_a_track_is_the_same_in_any_world(network: Network, frames: list[RecordedFrame]) -> None:
    T_camera_world = transform_from(rotation_about(np.array([1.0, 2.0, 3.0]), 1.1), np.array([0.3, -2.0, 1.0]))
    poses = []
    for placed in (np.eye(4), T_camera_world):
        tracking = Tracking(network, FixedRegion(region_of(frames[0])))
        found = []
        for k in range(5):
            one = at(frames[0], k, noise=k)
            camera = replace(one.frame.camera, T_camera_world=placed)
            found.append(tracking.follow(replace(one, frame=replace(one.frame, camera=camera)), Deadline()))
        poses.append(only(found[-1].objects).pose)
    rotation_rad, translation_m = apart(*poses)
    assert rotation_rad < 1e-3
    assert translation_m < 1e-4


def test_without_time_for_a_search_it_is_put_off_and_nothing_is_made_up(
    network: Network, frames: list[RecordedFrame]
) -> None:
    tracking = Tracking(network, OwnRegions(1))
    for k in range(4):
        tracking.follow(at(frames[0], k), Deadline())
    followed = tracking.follow(at(frames[1], 4), Deadline(0.0))
    for found in followed.objects:
        full = estimate(network, frames[1].frame, region_of(frames[1]), max_looks=1)
        assert apart(found.pose, full)[0] < np.radians(15.0)


def test_one_slow_search_does_not_put_off_all_others_for_ever(
    network: Network, frames: list[RecordedFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    def slow(network: Network, frame: RgbdFrame, region: Region, **more: int) -> Examined:
        time.sleep(3.0)
        return examine(network, frame, region, **more)

    monkeypatch.setattr(following, "examine", slow)
    tracking = Tracking(network, FixedRegion(region_of(frames[0])))
    assert tracking.follow(at(frames[0], 0), Deadline()).searched == 1
    # A second apart: each frame would be checked by a full search if there were time.
    searched = [tracking.follow(at(frames[0], 30 * k), Deadline(time.monotonic() + 1.5)).searched for k in range(1, 25)]
    assert searched[:5] == [0] * 5
    assert 1 in searched


def test_two_tracks_of_one_object_become_the_older_one(network: Network, frames: list[RecordedFrame]) -> None:
    tracking = Tracking(network, OwnRegions())
    tracking.follow(at(frames[0], 0), Deadline())
    (own,) = tracking._tracks
    tracking._tracks.append((replace(own[0], number=1), own[1]))
    followed = [tracking.follow(at(frames[0], k), Deadline()) for k in range(1, 4)]
    assert [[one.number for one in each.objects] for each in followed] == [[0]] * 3
    assert [each.lost for each in followed] == [1, 0, 0]


def test_votes_around_a_place_are_those_of_the_scorer() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.1, 0.1, (300, 3)) + np.array([0.0, 0.0, 0.8])
    keypoints = np.array([[0.05, 0.02, 0.75], [-0.04, 0.1, 0.85], [0.0, -0.08, 0.8]])
    radii_m = np.linalg.norm(points[:, None] - keypoints, axis=2) + rng.normal(0.0, 0.002, (300, 3))
    radii_m[:20] = np.nan
    points, radii_m = points.astype(np.float32), radii_m.astype(np.float32)
    exact = score_keypoints(points, radii_m, voxel_m=0.005)
    near = votes_near(points, radii_m, keypoints + 0.003, voxel_m=0.005)
    for one, other in zip(near, exact, strict=True):
        assert other.gap == 0
        assert one.max_votes == other.max_votes
        np.testing.assert_allclose(one.peaks[0].voxel_camera, other.peaks[0].voxel_camera, atol=1e-9)
        assert one.gap == len(points) - one.max_votes
    (nothing, *_) = votes_near(points, np.full_like(radii_m, 9.0), keypoints, voxel_m=0.005)
    assert nothing.peaks == ()
    assert nothing.reason


def test_every_frame_by_itself_is_what_estimate_says(network: Network, frames: list[RecordedFrame]) -> None:
    followed = EachByItself(network, OwnRegions(), max_looks=1).follow(frames[0], Deadline())
    found = only(followed.objects)
    full = estimate(network, frames[0].frame, region_of(frames[0]), max_looks=1)
    assert apart(found.pose, full) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert not found.tracked


def test_regions_overlap_by_the_smaller_and_cover_by_their_own() -> None:
    assert overlap((0, 0, 10, 10), (5, 5, 10, 10)) == 0.25
    assert overlap((0, 0, 10, 10), (2, 2, 2, 2)) == overlap((2, 2, 2, 2), (0, 0, 10, 10)) == 1.0
    assert overlap((0, 0, 10, 10), (20, 0, 5, 5)) == 0.0
    assert covered((0, 0, 10, 10), (0, 0, 5, 10)) == 0.5
    assert covered((0, 0, 5, 10), (0, 0, 10, 10)) == 1.0


def test_live_results_of_a_recording_has_one_for_every_frame(network: Network) -> None:
    source = open_source(ROOT / "tests" / "data" / "box")
    with live_results(source, network, objects=1) as results:
        indices = [result.frame.index for result in results]
    assert indices == [entry.index for entry in source.entries]
    with pytest.raises(ValueError, match="objects: expected at least 1"):
        live_results(source, network, objects=0)
    with pytest.raises(ValueError, match="max_looks: expected at least 1"):
        live_results(source, network, max_looks=0)


@dataclass(frozen=True)
class Everywhere:
    """Places without an object, all apart from each other; none knows how many objects there are."""

    places: tuple[Region, ...] = tuple((40 * k, 400, 38, 60) for k in range(8))
    most: int | None = None

    def locate(self, recorded: RecordedFrame) -> Sequence[Region]:
        del recorded
        return self.places


@pytest.mark.parametrize("way", [Tracking, EachByItself])
def test_a_loop_that_is_told_to_stop_looks_at_no_further_place(
    way: type[Tracking | EachByItself], network: Network, frames: list[RecordedFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[Region] = []
    loops: list[LiveLoop] = []

    def counted(run: Callable[..., object]) -> Callable[..., object]:
        def called(network: Network, frame: RgbdFrame, place: Region, **more: int) -> object:
            looked.append(place)
            if len(looked) == 2:
                loops[0].stop()
            return run(network, frame, place, **more)

        return called

    monkeypatch.setattr(following, "examine", counted(examine))
    monkeypatch.setattr(following, "estimate", counted(estimate))
    with LiveLoop([frames[0], at(frames[0], 1)], way(network, Everywhere())) as loop:
        loops.append(loop)
        assert len(list(loop)) == 1
    assert len(looked) == 2
