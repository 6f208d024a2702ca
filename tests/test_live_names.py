"""An object whose description may change from frame to frame is followed as if it did not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from benchmarks.sequences import sequence
from hypothesis import given, settings
from hypothesis import strategies as st

from followed_boxes import ROOT, apart, only
from page_runtime import Network
from page_runtime.bundle import BundleMetadata
from page_runtime.camera import Camera
from page_runtime.category import Category
from page_runtime.equivalents import interchanged, nearest_renaming, poses_of, renamed_pose
from page_runtime.geometry import Array, apply, rotation_about, transform_from
from page_runtime.live import advance
from page_runtime.live.deadline import Deadline
from page_runtime.live.following import Tracking
from page_runtime.live.locate import OwnRegions
from page_runtime.live.near import pose_near
from page_runtime.live.prior import Prior, prior_as_named, surfaces_of
from page_runtime.live.track import Observation, Track, begun, prior_of, with_observation
from page_runtime.network import NetworkOutput
from page_runtime.part_poses import LabelledPoints, labelled_points, pose_from_output
from page_runtime.pose import ArticulatedPose, JointState, PartPose
from page_runtime.sampling import RegionSample
from page_runtime.similarity import so3_exp
from page_runtime.stopwatch import Stopwatch
from page_runtime.symmetry import Symmetry
from page_training.categories import category_named

PERIOD_S = 1 / 30
CAMERA = Camera(np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]]), 640, 480)
FRAMES = 6
seeds = st.integers(0, 2**32 - 1)


def arm(fold: int) -> Category:
    """The arm whose hand, the last part, has so many turns about z that change nothing."""
    category = category_named("arm")
    hand = replace(category.parts[-1], symmetry=Symmetry((0.0, 0.0, 1.0), fold))
    return replace(category, parts=(*category.parts[:-1], hand))


@dataclass(frozen=True, eq=False)
class Moving:
    """Parts that each move evenly, seen with errors."""

    category: Category
    seed: int

    def pose(self, index: int) -> ArticulatedPose:
        rng, errors = np.random.default_rng(self.seed), np.random.default_rng([self.seed, index])
        parts = []
        for spec in self.category.parts:
            start, rate = so3_exp(rng.normal(size=(1, 3)))[0], rng.normal(size=6) * np.repeat([1.0, 0.2], 3)
            t = rng.uniform(-0.2, 0.2, 3) + np.array([0.0, 0.0, 1.0]) + rate[3:] * index * PERIOD_S
            R = so3_exp((rate[:3] * index * PERIOD_S + errors.normal(0.0, 0.03, 3))[None])[0] @ start
            extents_m = rng.uniform(0.05, 0.3, 3) * np.exp(errors.normal(0.0, 0.02))
            if spec.symmetry is not None and spec.symmetry.fold != 2:
                # About z.
                extents_m[1] = extents_m[0]
            spread = rng.normal(size=(6, 6))
            covariance = 1e-4 * (spread @ spread.T + np.eye(6))
            parts.append(part_pose(spec.name, spec.keypoints_unit, transform_from(R, t), extents_m, covariance))
        joints = tuple(
            JointState(one.name, one.kind, 0.5 * sum(one.limits) + float(errors.normal(0.0, 0.1)), 0.02, one.limits)
            for one in self.category.joints
        )
        return ArticulatedPose(tuple(parts), joints, {})


def part_pose(name: str, keypoints: Array, T: Array, extents_m: Array, covariance: Array) -> PartPose:
    scale_m = float(np.linalg.norm(extents_m))
    return PartPose(
        name, T, extents_m, apply(T, scale_m * keypoints), np.ones(3), 0.9, 0.9, 0.5, 0, 99, 0.001, covariance
    )


def points_of(pose: ArticulatedPose, seed: int) -> LabelledPoints:
    """Fifty points on each part, and some on none."""
    rng = np.random.default_rng(seed)
    on = [
        apply(part.T_camera_part, rng.uniform(-0.5, 0.5, (50, 3)) * part.extents_m)
        for part in pose.parts
        if isinstance(part, PartPose)
    ]
    points = np.concatenate([*on, rng.uniform(-0.5, 0.5, (30, 3)) + np.array([0.0, 0.0, 1.0])]).astype(np.float32)
    members = tuple(np.arange(50 * k, 50 * (k + 1)) for k in range(len(on)))
    return LabelledPoints(points, np.arange(len(points)), members)


def exchanged(
    category: Category, pose: ArticulatedPose, labelled: LabelledPoints
) -> tuple[ArticulatedPose, LabelledPoints]:
    """Each blade in the place of the other, turned over: by hand, not by the runtime."""
    rule = category.interchange
    assert rule is not None
    turn = transform_from(rotation_about(np.array(rule.axis), np.pi), np.zeros(3))
    parts = []
    for spec, other in zip(category.parts, rule.parts, strict=True):
        part = pose.parts[other]
        assert isinstance(part, PartPose)
        T = part.T_camera_part @ turn
        parts.append(part_pose(spec.name, spec.keypoints_unit, T, part.extents_m, part.covariance))
    return replace(pose, parts=tuple(parts)), labelled.in_order(rule.parts)


def turned(category: Category, pose: ArticulatedPose, angle_rad: float) -> ArticulatedPose:
    """The hand turned about z, and the joint that turns it with it."""
    hand, spec, last = pose.parts[-1], category.parts[-1], pose.joints[-1]
    assert isinstance(hand, PartPose)
    assert last.value is not None
    assert category.joints[-1].axis == (0.0, 0.0, 1.0)
    assert category.joints[-1].child == len(category.parts) - 1
    T = hand.T_camera_part @ transform_from(rotation_about(np.array([0.0, 0.0, 1.0]), angle_rad), np.zeros(3))
    again = part_pose(spec.name, spec.keypoints_unit, T, hand.extents_m, hand.covariance)
    joints = (*pose.joints[:-1], replace(last, value=last.value + angle_rad))
    return replace(pose, parts=(*pose.parts[:-1], again), joints=joints)


def followed(category: Category, frames: Sequence[tuple[ArticulatedPose, LabelledPoints]]) -> Track:
    """As `advance` follows an object that the network recognises in every frame."""
    track: Track | None = None
    for index, (pose, labelled) in enumerate(frames):
        time_s = index * PERIOD_S
        if track is not None:
            renaming = nearest_renaming(category, poses_of(pose), prior_of(track, CAMERA, time_s).poses)
            pose, labelled = renamed_pose(category, pose, renaming), labelled.in_order(renaming.order)
        colors = np.zeros(labelled.points_camera.shape, np.uint8)
        seen = Observation(pose, *surfaces_of(pose, labelled, colors))
        track = (
            begun(0, category, seen, CAMERA, time_s) if track is None else with_observation(track, seen, CAMERA, time_s)
        )
    assert track is not None
    return track


def assert_same(one: Track, other: Track) -> None:
    for a, b in zip(one.parts, other.parts, strict=True):
        assert a is not None
        assert b is not None
        np.testing.assert_allclose(a.motion.T_a_part, b.motion.T_a_part, atol=1e-9)
        np.testing.assert_allclose(a.motion.rate, b.motion.rate, atol=1e-8)
        np.testing.assert_allclose(a.motion.covariance, b.motion.covariance, atol=1e-9)
        np.testing.assert_allclose(a.extents_m, b.extents_m, atol=1e-9)
        np.testing.assert_allclose(a.surface.points, b.surface.points, atol=1e-5)
        np.testing.assert_allclose(a.last.keypoints_camera, b.last.keypoints_camera, atol=1e-9)
    for a, b in zip(one.joints, other.joints, strict=True):
        assert a is not None
        assert b is not None
        np.testing.assert_allclose(a.mean, b.mean, atol=1e-8)
    assert one.steady == other.steady


@settings(max_examples=40, deadline=None)
@given(seeds, st.lists(st.booleans(), min_size=FRAMES - 1, max_size=FRAMES - 1))
def test_blades_that_take_each_others_name_at_random_are_followed_as_if_they_never_did(
    seed: int, swaps: list[bool]
) -> None:
    category = category_named("scissors")
    moving = Moving(category, seed)
    plain = [(pose, points_of(pose, k)) for k in range(FRAMES) for pose in [moving.pose(k)]]
    said = [exchanged(category, *one) if swap else one for one, swap in zip(plain, [False, *swaps], strict=True)]
    assert_same(followed(category, said), followed(category, plain))


@settings(max_examples=20, deadline=None)
@given(seeds, st.sampled_from([2, 4]), st.lists(st.integers(0, 3), min_size=FRAMES - 1, max_size=FRAMES - 1))
def test_a_symmetric_part_that_is_turned_at_random_is_followed_as_if_it_never_was(
    seed: int, fold: int, turns: list[int]
) -> None:
    category = arm(fold)
    moving = Moving(category, seed)
    plain = [(pose, points_of(pose, k)) for k in range(FRAMES) for pose in [moving.pose(k)]]
    said = [
        (turned(category, pose, (turn % fold) * 2.0 * np.pi / fold), labelled)
        for (pose, labelled), turn in zip(plain, [0, *turns], strict=True)
    ]
    assert_same(followed(category, said), followed(category, plain))


@settings(max_examples=20, deadline=None)
@given(seeds, st.lists(st.floats(-3.0, 3.0), min_size=FRAMES - 1, max_size=FRAMES - 1))
def test_a_part_that_any_turn_leaves_as_it_is_is_not_seen_to_turn(seed: int, angles: list[float]) -> None:
    category = arm(0)
    moving = Moving(category, seed)
    plain = [(pose, points_of(pose, k)) for k in range(FRAMES) for pose in [moving.pose(k)]]
    said = [
        (turned(category, pose, angle), labelled) for (pose, labelled), angle in zip(plain, [0.0, *angles], strict=True)
    ]
    assert_same(followed(category, said), followed(category, plain))


def test_where_nothing_looks_the_same_no_name_changes() -> None:
    category = category_named("drawer")
    one, other = Moving(category, 1).pose(0), Moving(category, 2).pose(0)
    assert renamed_pose(category, one, nearest_renaming(category, poses_of(one), poses_of(other))) is one


class OtherNames:
    """A network that calls each blade the other at random: what its answer is made into is renamed by hand."""

    def __init__(self, patch: pytest.MonkeyPatch, category: Category, swaps: Sequence[bool]) -> None:
        self._category, self._swaps, self.swap = category, list(swaps), False
        self._near, self._full = pose_near, pose_from_output
        patch.setattr(advance, "labelled_points", self.labelled)
        patch.setattr(advance, "pose_near", self.near)
        patch.setattr(advance, "pose_from_output", self.full)

    def next(self, frame: int) -> None:
        self.swap = self._swaps[frame]

    def labelled(self, sample: RegionSample, output: NetworkOutput) -> LabelledPoints:
        found = labelled_points(sample, output)
        return found.in_order(interchanged(self._category).order) if self.swap else found

    def near(
        self, metadata: BundleMetadata, sample: RegionSample, output: NetworkOutput, prior: Prior, watch: Stopwatch
    ) -> ArticulatedPose:
        # The prior comes in the names of the answer; what the network really said has the others.
        own = prior_as_named(self._category, prior, labelled_points(sample, output))
        return self._said(self._near(metadata, sample, output, own, watch))

    def full(
        self, metadata: BundleMetadata, sample: RegionSample, output: NetworkOutput, watch: Stopwatch
    ) -> ArticulatedPose:
        return self._said(self._full(metadata, sample, output, watch))

    def _said(self, pose: ArticulatedPose) -> ArticulatedPose:
        return renamed_pose(self._category, pose, interchanged(self._category)) if self.swap else pose


def test_real_scissors_are_followed_the_same_whatever_the_network_calls_their_blades(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = Network(ROOT / "runtime" / "bundles" / "scissors.onnx", threads=1)
    category = network.metadata.category
    assert category.interchange is not None
    frames = list(sequence("scissors", tmp_path_factory.mktemp("scissors"), seed=1, frames=8))
    results = []
    for swaps in ([False] * 8, [False, False, False, True, True, True, True, False]):
        with monkeypatch.context() as patch:
            names = OtherNames(patch, category, swaps)
            tracking, found = Tracking(network, OwnRegions(1)), []
            for k, one in enumerate(frames):
                names.next(k)
                found.append(tracking.follow(one, Deadline()))
        results.append(found)
    plain, other = results
    assert sum(bool(one.objects) for one in plain) >= 6
    assert any(one.objects and one.stage_ms["network"] and only(one.objects).tracked for one in plain[3:])
    for one, two in zip(plain, other, strict=True):
        assert len(one.objects) == len(two.objects)
        if one.objects:
            assert only(one.objects).number == only(two.objects).number == 0
            assert only(one.objects).tracked == only(two.objects).tracked
            rotation_rad, translation_m = apart(only(one.objects).pose, only(two.objects).pose)
            assert rotation_rad < 1e-6
            assert translation_m < 1e-6
