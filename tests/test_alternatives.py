"""Which pose the joints allow: a half turn is undone, a mirrored pair decided, and nothing touched that is in order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.alternatives import settle
from page_runtime.articulation import PartEvidence, articulate
from page_runtime.geometry import Array, rotation_about, transform_from
from page_runtime.symmetry import Symmetry
from test_articulation import EXTENTS, SIGMAS, SIZE_M, chain, evidence, posed, random_pose

HALF_TURNS = [np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])]


def turned(part: PartEvidence, turn: Array) -> PartEvidence:
    T = part.T_camera_part.copy()
    T[:3, :3] = T[:3, :3] @ turn
    return replace(part, T_camera_part=T)


def hinged(seed: int) -> tuple[list[PartEvidence], float]:
    """Two parts with noise, and their true state."""
    rng = np.random.default_rng(seed)
    state = float(rng.uniform(0.6, 2.4))
    truth = posed(chain(("revolute",)), [state], random_pose(rng))
    return [evidence(T, SIGMAS, rng.normal(size=7) * SIGMAS * 0.5) for T in truth], state


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_parts_in_order_are_left_alone(seed: int) -> None:
    parts, _ = hinged(seed)
    for settled, part in zip(settle(chain(("revolute",)), [[part] for part in parts]), parts, strict=True):
        assert settled is not None
        assert settled.evidence is part
        assert (settled.index, settled.turned, settled.decided) == (0, False, True)


@pytest.mark.parametrize("wrong", [0, 1])
@pytest.mark.parametrize("turn", [1, 2])  # about y or z: the hinge then lies on the other side
def test_a_part_taken_for_its_half_turn_is_turned_back(wrong: int, turn: int) -> None:
    category = chain(("revolute",))
    for seed in range(10):
        parts, state = hinged(seed)
        given_ = [turned(part, HALF_TURNS[turn]) if k == wrong else part for k, part in enumerate(parts)]
        found = settle(category, [[part] for part in given_])
        assert all(one is not None for one in found)
        assert [one.turned for one in found if one is not None] == [k == wrong for k in range(2)]
        joined = articulate(category, [one.evidence for one in found if one is not None])
        assert joined.joints[0].value == pytest.approx(state, abs=0.5)


@pytest.mark.parametrize("wrong", [0, 1])
def test_a_half_turn_about_the_hinge_is_told_by_its_limits(wrong: int) -> None:
    category = chain(("revolute",))
    for seed in range(10):
        parts, state = hinged(seed)
        given_ = [turned(part, HALF_TURNS[0]) if k == wrong else part for k, part in enumerate(parts)]
        found = [one for one in settle(category, [[part] for part in given_]) if one is not None]
        assert [one.turned for one in found] == [k == wrong for k in range(2)]
        assert articulate(category, [one.evidence for one in found]).joints[0].value == pytest.approx(state, abs=0.5)


@pytest.mark.parametrize("fold", [2, 3, 0])
def test_a_symmetric_part_is_called_what_its_limits_allow(fold: int) -> None:
    category = chain(("revolute",), limits=(0.2, 1.6))
    symmetric = replace(category.parts[1], symmetry=Symmetry((1.0, 0.0, 0.0), fold))
    category = replace(category, parts=(category.parts[0], symmetric))
    (joint,) = category.joints
    assert joint.geometry is not None
    # A part that looks the same turned about its hinge has it in its middle.
    category = replace(
        category, joints=(replace(joint, geometry=replace(joint.geometry, pivot_child=(0.0, 0.0, 0.0))),)
    )
    (joint,) = category.joints
    for seed in range(10):
        rng = np.random.default_rng(seed)
        parent = random_pose(rng)
        pivot = SIZE_M * EXTENTS * np.array(joint.geometry.pivot_parent if joint.geometry else 0.0)
        child = parent @ transform_from(rotation_about(np.array(joint.axis), 0.9), pivot)
        turn = rotation_about(np.array([1.0, 0.0, 0.0]), 2 * np.pi / (fold or 2))
        given_ = [evidence(parent, SIGMAS), evidence(child @ transform_from(turn, np.zeros(3)), SIGMAS)]
        found = [one for one in settle(category, [[part] for part in given_]) if one is not None]
        assert not any(one.turned for one in found)
        (state,) = articulate(category, [one.evidence for one in found]).joints
        assert state.value is not None
        assert joint.limits[0] <= state.value <= joint.limits[1]
        assert fold == 0 or state.value == pytest.approx(0.9, abs=1e-6)
        np.testing.assert_array_equal(found[0].evidence.T_camera_part, parent)


@pytest.mark.parametrize("overstepped", [4.0, 5.0, 6.0])
def test_a_limit_overstepped_by_little_turns_nothing_about(overstepped: float) -> None:
    category = chain(("revolute",), limits=(0.0, 2.9))
    # Of the angle between two parts, and of what a limit is sure to.
    sigma = float(np.hypot(np.sqrt(2) * SIGMAS[0], 0.01))
    for seed in range(10):
        truth = posed(category, [-overstepped * sigma], random_pose(np.random.default_rng(seed)))
        parts = [evidence(T, SIGMAS) for T in truth]
        found = [one for one in settle(category, [[part] for part in parts]) if one is not None]
        assert [one.evidence for one in found] == parts


@given(st.integers(0, 10_000), st.sampled_from([0, 1]))
@settings(max_examples=60, deadline=None)
def test_a_half_turn_that_explains_nothing_is_not_taken(seed: int, wrong: int) -> None:
    category = chain(("revolute",))
    parts, _ = hinged(seed)
    astray = parts[wrong].T_camera_part.copy()
    astray[:3, :3] = random_pose(np.random.default_rng(seed + 1))[:3, :3]
    parts[wrong] = replace(parts[wrong], T_camera_part=astray)
    found = [one for one in settle(category, [[part] for part in parts]) if one is not None]
    if any(one.turned for one in found):
        (joint,) = articulate(category, [one.evidence for one in found]).joints
        assert joint.reason == ""


def test_of_two_poses_the_joint_decides() -> None:
    category = chain(("revolute",))
    for seed in range(10):
        parts, _ = hinged(seed)
        mirrored = turned(parts[1], HALF_TURNS[2])
        for first, second, expected in ((parts[1], mirrored, 0), (mirrored, parts[1], 1)):
            found = settle(category, [[parts[0]], [first, second]])[1]
            assert found is not None
            assert (found.index, found.turned, found.decided) == (expected, False, True)


def test_without_a_joint_to_ask_two_poses_stay_undecided() -> None:
    parts, _ = hinged(0)
    both = [parts[1], turned(parts[1], HALF_TURNS[2])]
    for category, poses in ((chain(("free",)), [[parts[0]], both]), (chain(("revolute",)), [[], both])):
        found = settle(category, poses)
        assert found[1] is not None
        assert not found[1].decided
    assert settle(chain(("revolute",)), [[], both])[0] is None


def test_along_a_chain_the_one_wrong_part_is_found() -> None:
    category = chain(("revolute",) * 4)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        truth = posed(category, [float(s) for s in rng.uniform(0.6, 2.0, 4)], random_pose(rng))
        parts = [evidence(T, SIGMAS, rng.normal(size=7) * SIGMAS * 0.5) for T in truth]
        parts[2] = turned(parts[2], HALF_TURNS[2])
        found = settle(category, [[part] for part in parts])
        assert [one.turned for one in found if one is not None] == [False, False, True, False, False]


def test_too_many_combinations_decide_nothing() -> None:
    category = chain(("revolute",) * 24)
    parts = [[evidence(T, SIGMAS), evidence(T, 2 * SIGMAS)] for T in posed(category, [0.4] * 24, np.eye(4))]
    settled = settle(category, parts)
    assert [one is not None and (one.index, one.decided) for one in settled] == [(0, False)] * 25
