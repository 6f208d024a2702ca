"""Objects found and followed, by the shipped network on recorded frames."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from followed_boxes import BOXES, apart, at, hidden, only, region_of
from page_runtime import Network, RecordedFrame
from page_runtime.estimator import Examined, estimate, examine
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import rotation_about, transform_from
from page_runtime.live import following
from page_runtime.live.deadline import Deadline
from page_runtime.live.following import Tracking
from page_runtime.live.locate import FixedRegion, OwnRegions
from page_runtime.sampling import Region
from watched_network import WatchedNetwork


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


@pytest.mark.parametrize("focused", [False, True])
def test_a_track_is_the_same_in_any_world(frames: list[RecordedFrame], focused: bool) -> None:
    network = WatchedNetwork(BOXES, focused=focused)
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


def test_a_thin_object_is_followed_by_points_taken_where_it_was_seen(frames: list[RecordedFrame]) -> None:
    network = WatchedNetwork(BOXES, focused=True)
    full = estimate(network, frames[0].frame, region_of(frames[0]), max_looks=1)
    tracking = Tracking(network, FixedRegion(region_of(frames[0])))
    asked = []
    for k in range(7):
        network.focused()
        found = only(tracking.follow(at(frames[0], k), Deadline()).objects)
        rotation_rad, translation_m = apart(found.pose, full)
        assert rotation_rad < np.radians(6.0)
        assert translation_m < 0.015
        asked.append(network.focused())
    assert asked == [[False, True], *[[], [], [True]] * 2]
