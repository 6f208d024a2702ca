"""Poses that look the same: metrics take the nearest, training teaches it, and a mirror shows such objects."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.category import Category
from page_runtime.category_document import category_document, category_from
from page_runtime.equivalents import nearest_renaming, nearest_truths, renamed_pose
from page_runtime.evaluation import joint_errors, part_errors
from page_runtime.geometry import invert, rotation_about, rotation_angle, transform_from
from page_runtime.mirror import MIRROR, mirrored_pose
from page_runtime.pose import ArticulatedPose, JointState, PartPose
from page_runtime.recorded import PartTruth
from page_runtime.symmetry import Interchange, Mirror, Symmetry, nearest_turn, turn_of
from page_training.categories import CATEGORIES, category_named
from symmetric_scenes import random_rotation, scene_pose

ROOT = Path(__file__).resolve().parents[1]
seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=30, deadline=None)
@given(seeds, st.integers(2, 7))
def test_the_nearest_turn_is_the_best_of_all_there_are(seed: int, fold: int) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    x, y, z = axis / np.linalg.norm(axis)
    wanted = random_rotation(rng)
    for symmetry, turns in (
        (Symmetry((x, y, z), fold), np.arange(fold) * 2 * np.pi / fold),
        (Symmetry((x, y, z), 0), np.linspace(0, 2 * np.pi, 2000)),
    ):
        found = rotation_angle(turn_of(symmetry, nearest_turn(symmetry, wanted)), wanted)
        best = min(float(rotation_angle(turn_of(symmetry, turn), wanted)) for turn in turns)
        assert found <= best + 1e-9


def estimated(category: Category, truths: tuple[PartTruth, ...], states: list[float]) -> ArticulatedPose:
    """The truths as an estimate."""
    parts = tuple(
        PartPose(
            t.name, t.T_camera_part, t.extents_m, np.zeros((8, 3)), np.ones(3), 1.0, 1.0, 0.0, 0, 99, 0.0, np.eye(6)
        )
        for t in truths
    )
    joints = tuple(JointState(j.name, j.kind, q, 0.01, j.limits) for j, q in zip(category.joints, states, strict=True))
    return ArticulatedPose(parts, joints, {})


def states_of(category: Category, truths: tuple[PartTruth, ...]) -> list[float]:
    states = [truths[joint.child].joint_state for joint in category.joints]
    return [state for state in states if state is not None]


def test_half_a_turn_of_a_two_fingered_hand_is_no_error_and_a_quarter_is() -> None:
    arm = category_named("arm")
    truths, _ = scene_pose(arm, np.random.default_rng(1))
    for turn, wrong in ((np.pi, 0.0), (np.pi / 2, np.pi / 2)):
        T = truths[6].T_camera_part @ transform_from(rotation_about(np.array([0.0, 0.0, 1.0]), turn), np.zeros(3))
        turned = (*truths[:6], replace(truths[6], T_camera_part=T))
        states = states_of(arm, truths)
        states[5] += turn
        pose = estimated(arm, turned, states)
        assert [e.rotation_rad for e in part_errors(arm, pose, truths)][6] == pytest.approx(wrong, abs=1e-7)
        assert [e.error for e in joint_errors(arm, pose, truths)][5] == pytest.approx(wrong, abs=1e-7)
        assert sum(e.error or 0.0 for e in joint_errors(arm, pose, truths)[:5]) == pytest.approx(0.0, abs=1e-9)


def test_the_state_of_a_joint_about_a_symmetric_parent_turns_back() -> None:
    arm = category_named("arm")
    parts = list(arm.parts)
    parts[0], parts[6] = replace(parts[0], symmetry=Symmetry((0.0, 0.0, -1.0), 4)), replace(parts[6], symmetry=None)
    arm = replace(arm, parts=tuple(parts))
    truths, _ = scene_pose(arm, np.random.default_rng(2))
    turn = rotation_about(np.array([0.0, 0.0, 1.0]), np.pi / 2)
    first = replace(truths[0], T_camera_part=truths[0].T_camera_part @ transform_from(turn, np.zeros(3)))
    states = states_of(arm, truths)
    states[0] -= np.pi / 2
    pose = estimated(arm, (first, *truths[1:]), states)
    assert max(e.rotation_rad or 0.0 for e in part_errors(arm, pose, truths)) < 1e-7
    assert max(e.error or 0.0 for e in joint_errors(arm, pose, truths)) < 1e-7


@pytest.mark.parametrize("fold", [2, 3, 6, 0])
def test_a_symmetric_part_has_the_same_box_after_its_turn(fold: int) -> None:
    arm = category_named("arm")
    axis = (0.0, 0.0, 1.0)
    arm = replace(arm, parts=(*arm.parts[:6], replace(arm.parts[6], symmetry=Symmetry(axis, fold))))
    truths, poses = scene_pose(arm, np.random.default_rng(3))
    turn = rotation_about(np.array(axis), 2 * np.pi / (fold or 5))
    wanted = [*poses[:6], poses[6] @ transform_from(turn, np.zeros(3))]
    pose = estimated(arm, truths, states_of(arm, truths))
    (*_, hand) = renamed_pose(arm, pose, nearest_renaming(arm, poses, wanted)).parts
    assert isinstance(hand, PartPose)
    np.testing.assert_allclose(hand.T_camera_part, wanted[6], atol=1e-9)
    np.testing.assert_allclose(hand.extents_m, truths[6].extents_m)


def test_scissors_turned_over_with_their_blades_renamed_are_the_same() -> None:
    scissors = category_named("scissors")
    rule = scissors.interchange
    assert rule is not None
    for seed in range(5):
        truths, poses = scene_pose(scissors, np.random.default_rng(seed))
        turn = transform_from(rule.turn, np.zeros(3))
        renamed = tuple(
            replace(truths[rule.parts[k]], name=part.name, T_camera_part=poses[rule.parts[k]] @ turn)
            for k, part in enumerate(scissors.parts)
        )
        pose = estimated(scissors, renamed, states_of(scissors, truths))
        assert max(e.rotation_rad or 0.0 for e in part_errors(scissors, pose, truths)) < 1e-7
        assert max(e.translation_m or 0.0 for e in part_errors(scissors, pose, truths)) < 1e-9
        assert [e.error for e in joint_errors(scissors, pose, truths)] == pytest.approx([0.0])
        # Renamed but not turned over, or one blade turned alone, is an error.
        swapped = tuple(replace(t, T_camera_part=poses[1 - k]) for k, t in enumerate(truths))
        alone = (replace(truths[0], T_camera_part=poses[0] @ turn), truths[1])
        for wrong in (swapped, alone):
            states = states_of(scissors, truths)
            errors = part_errors(scissors, estimated(scissors, wrong, states), truths)
            expected = min(np.pi, truths[1].joint_state or 0.0) if wrong is swapped else np.pi
            assert max(e.rotation_rad or 0.0 for e in errors) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", sorted(CATEGORIES))
def test_where_nothing_is_symmetric_the_truth_is_the_truth(name: str) -> None:
    category = category_named(name)
    plain = replace(category, interchange=None, parts=tuple(replace(p, symmetry=None) for p in category.parts))
    truths, _ = scene_pose(category, np.random.default_rng(0))
    pose = estimated(category, truths, states_of(category, truths))
    assert nearest_truths(plain, pose, truths) == truths
    for one, other in zip(nearest_truths(category, pose, truths), truths, strict=True):
        np.testing.assert_allclose(one.T_camera_part, other.T_camera_part, atol=1e-9)


@pytest.mark.parametrize("name", sorted(CATEGORIES))
def test_a_mirror_shows_an_object_of_the_category(name: str) -> None:
    """Mirrored poses obey the joints in the mirrored states, and twice mirrored all is as before."""
    category = category_named(name)
    images = category.mirror_joints
    assert category.mirror is not None
    assert images is not None
    for seed in range(3):
        truths, poses = scene_pose(category, np.random.default_rng(seed))
        states = states_of(category, truths)
        pose = estimated(category, truths, states)
        mirrored = mirrored_pose(pose, category)
        for joint, state in zip(category.joints, mirrored.joints, strict=True):
            parent, child = (mirrored.parts[k] for k in (joint.parent, joint.child))
            assert isinstance(parent, PartPose)
            assert isinstance(child, PartPose)
            assert state.value is not None
            assert joint.limits[0] <= state.value <= joint.limits[1]
            turn = (invert(parent.T_camera_part) @ child.T_camera_part)[:3, :3]
            expected = rotation_about(np.array(joint.axis), state.value) if joint.kind == "revolute" else np.eye(3)
            np.testing.assert_allclose(turn, expected, atol=1e-9)
        assert [part.name for part in mirrored.parts] == [part.name for part in category.parts]
        seen = np.array([p.T_camera_part[:3, 3] for p in mirrored.parts if isinstance(p, PartPose)]) * MIRROR
        before = np.array([poses[k][:3, 3] for k in category.mirror.order(len(poses))])
        np.testing.assert_allclose(seen, before, atol=1e-12)
        again = mirrored_pose(mirrored, category)
        for one, other in zip(again.parts, pose.parts, strict=True):
            assert isinstance(one, PartPose)
            assert isinstance(other, PartPose)
            np.testing.assert_allclose(one.T_camera_part, other.T_camera_part, atol=1e-12)
        assert [j.value for j in again.joints] == pytest.approx(states)


def test_a_joint_whose_range_is_not_its_mirror_image_s_has_none() -> None:
    arm = category_named("arm")
    joints = (replace(arm.joints[0], limits=(-1.0, 3.1)), *arm.joints[1:])
    assert arm.joints_mirror
    assert not replace(arm, joints=joints).joints_mirror
    with pytest.raises(ValueError, match="its own mirror image, got 'arm'"):
        mirrored_pose(ArticulatedPose((), (), {}), replace(arm, joints=joints))
    assert not replace(arm, mirror=None).joints_mirror


@pytest.mark.parametrize("name", sorted(CATEGORIES))
def test_symmetries_travel_with_the_category(name: str) -> None:
    category = category_named(name)
    back = category_from(json.loads(json.dumps(category_document(category))))
    assert (back.mirror, back.interchange) == (category.mirror, category.interchange)
    assert [part.symmetry for part in back.parts] == [part.symmetry for part in category.parts]


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Symmetry((0.0, 0.0, 2.0), 2), "unit vector"),
        (lambda: Symmetry((0.0, 0.0, 1.0), 1), "at least 2"),
        (lambda: Mirror(axis=3), "0, 1 or 2"),
        (lambda: Mirror(parts=(1, 2, 0)), "swapped in pairs"),
        (lambda: Interchange((0, 0), (0.0, 1.0, 0.0)), "every part once"),
        (lambda: replace(category_named("box"), mirror=Mirror(parts=(0, 2, 1))), "expected 2 parts"),
        (lambda: replace(category_named("box"), interchange=Interchange((1, 0), (1.0, 0.0, 0.0))), "another way"),
    ],
)
def test_symmetries_that_cannot_be_are_refused(make, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        make()
