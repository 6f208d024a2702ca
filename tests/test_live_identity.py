"""Which object is which when some were missing: the same again by place and size, or a new one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from followed_boxes import PERIOD_S, region_of
from page_runtime import Network, RecordedFrame
from page_runtime.estimator import Examined, examine
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array, rotation_about, transform_from
from page_runtime.live.advance import observation
from page_runtime.live.deadline import Deadline
from page_runtime.live.following import Tracking
from page_runtime.live.identity import matched
from page_runtime.live.locate import OwnRegions
from page_runtime.live.track import Track, begun
from page_runtime.pose import ArticulatedPose, PartPose
from page_runtime.recorded import Instance
from page_runtime.sampling import Region


@dataclass(frozen=True, eq=False)
class Table:
    """One recorded object shown at two places beside each other, either of them absent."""

    shown: RecordedFrame

    def frame(self, index: int, present: Sequence[int]) -> RecordedFrame:
        """The object's surroundings cut out and shifted; nothing else has a depth reading."""
        one = self.shown.frame
        color, depth_m = np.full_like(one.color, 128), np.zeros_like(one.depth_m)
        x, _, w, _ = region_of(self.shown)
        # A sixth of the region to either side, so that the places do not touch.
        left, right = max(x - w // 6, 0), min(x + w + w // 6, one.camera.width)
        for place in present:
            shift = self.region(place)[0] - x
            columns = slice(max(left + shift, 0), min(right + shift, one.camera.width))
            origin = slice(columns.start - shift, columns.stop - shift)
            color[:, columns], depth_m[:, columns] = one.color[:, origin], one.depth_m[:, origin]
        instances = tuple(Instance(self.region(place)) for place in present)
        frame = RgbdFrame(color, depth_m, one.camera, index * PERIOD_S, index)
        return RecordedFrame(frame, instances)

    def region(self, place: int) -> Region:
        x, y, w, h = region_of(self.shown)
        return x + (2 * place - 1) * (2 * w // 3), y, w, h


def numbers_by_place(table: Table, tracking: Tracking, index: int, present: Sequence[int]) -> dict[int, int]:
    """For each place with an object its number."""
    x, _, w, _ = region_of(table.shown)
    objects = tracking.follow(table.frame(index, present), Deadline()).objects
    return {int(2 * one.region[0] + one.region[2] > 2 * x + w): one.number for one in objects}


@pytest.fixture(scope="module")
def table(network: Network, frames: list[RecordedFrame]) -> Table:
    """Of a frame that is recognised at both places."""
    for one in frames:
        made = Table(one)
        if set(numbers_by_place(made, Tracking(network, OwnRegions()), 0, (0, 1))) == {0, 1}:
            return made
    pytest.fail("no frame is recognised at two places")


@pytest.mark.parametrize("away", [2, 30])
def test_two_objects_that_vanish_and_come_back_to_their_places_keep_their_numbers(
    away: int, network: Network, table: Table
) -> None:
    tracking = Tracking(network, OwnRegions())
    before = numbers_by_place(table, tracking, 0, (0, 1))
    assert set(before) == {0, 1}
    for k in range(1, away + 1):
        assert not numbers_by_place(table, tracking, k, ())
    # One after the other, the younger one first.
    assert numbers_by_place(table, tracking, away + 1, (1,)) == {1: before[1]}
    assert numbers_by_place(table, tracking, away + 2, (0, 1)) == before


@pytest.mark.parametrize("away", [2, 30])
def test_another_object_elsewhere_gets_a_number_of_its_own_and_the_missing_one_keeps_its(
    away: int, network: Network, table: Table
) -> None:
    tracking = Tracking(network, OwnRegions())
    assert numbers_by_place(table, tracking, 0, (0,)) == {0: 0}
    for k in range(1, away + 1):
        numbers_by_place(table, tracking, k, ())
    assert numbers_by_place(table, tracking, away + 1, (1,)) == {1: 1}
    assert numbers_by_place(table, tracking, away + 2, (0, 1)) == {0: 0, 1: 1}


def track_of(network: Network, recorded: RecordedFrame) -> tuple[Track, Examined]:
    frame = recorded.frame
    seen = examine(network, frame, region_of(recorded), max_looks=1)
    assert seen.labelled is not None
    observed = observation(frame, seen.labelled, seen.pose)
    return begun(0, network.metadata.category, observed, frame.camera, 0.0), seen


def moved(pose: ArticulatedPose, T: Array, scale: float = 1.0) -> ArticulatedPose:
    """Every part moved in the camera's frame, and its size changed."""
    parts = tuple(
        replace(part, T_camera_part=T @ part.T_camera_part, extents_m=scale * part.extents_m)
        if isinstance(part, PartPose)
        else part
        for part in pose.parts
    )
    return replace(pose, parts=parts)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 0.4), st.floats(0.0, 10.0), st.floats(0.8, 1.25), st.integers(0, 2**32 - 1))
def test_about_where_it_was_and_of_its_size_it_is_the_same_and_far_away_or_of_another_size_it_is_not(
    network: Network, frames: list[RecordedFrame], share: float, gone_s: float, scale: float, seed: int
) -> None:
    track, seen = track_of(network, frames[0])
    category, camera = network.metadata.category, frames[0].frame.camera
    direction = np.random.default_rng(seed).normal(size=3)
    direction /= np.linalg.norm(direction)
    diagonals_m = [float(np.linalg.norm(part.extents_m)) for part in seen.pose.parts if isinstance(part, PartPose)]
    near_m, far_m = share * min(diagonals_m), 1.05 * max(diagonals_m)

    def found(distance_m: float, size: float) -> bool:
        there = moved(seen.pose, transform_from(np.eye(3), distance_m * direction), size)
        return matched(track, category, there, camera, gone_s) is not None

    assert found(near_m, scale)
    assert not found(far_m, scale)
    assert not found(near_m, 1.6)
    assert not found(near_m, 0.6)


def test_of_several_missing_ones_it_is_the_nearest(network: Network, frames: list[RecordedFrame]) -> None:
    track, seen = track_of(network, frames[0])
    category, camera = network.metadata.category, frames[0].frame.camera
    near, far = (moved(seen.pose, transform_from(np.eye(3), np.array([x, 0.0, 0.0]))) for x in (0.01, 0.03))
    one, other = (matched(track, category, pose, camera, 0.1) for pose in (near, far))
    assert one is not None
    assert other is not None
    assert one.distance_m == pytest.approx(0.01, abs=1e-6)
    assert other.distance_m == pytest.approx(0.03, abs=1e-6)


def test_an_object_that_is_turned_where_it_stands_is_the_same(network: Network, frames: list[RecordedFrame]) -> None:
    track, seen = track_of(network, frames[0])
    first = seen.pose.parts[0]
    assert isinstance(first, PartPose)
    place = transform_from(np.eye(3), first.T_camera_part[:3, 3])
    back = transform_from(np.eye(3), -first.T_camera_part[:3, 3])
    turn = place @ transform_from(rotation_about(np.array([0.0, 1.0, 0.0]), 2.0), np.zeros(3)) @ back
    pose = moved(seen.pose, turn)
    assert matched(track, network.metadata.category, pose, frames[0].frame.camera, 1.0) is not None
