"""What joints add: exact where everything agrees, better where it does not, the same from everywhere, silent where
they must be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.articulation import Articulation, PartEvidence, articulate
from page_runtime.category import Category, Joint, JointGeometry, JointKind, Part
from page_runtime.geometry import invert, rotation_about, rotation_angle, transform_from
from page_runtime.joints import joint_residual, joint_state
from page_runtime.similarity import FloatArray as Array
from page_runtime.similarity import Similarities, inverse_left_jacobian, so3_exp, so3_log

SIZE_M = 0.3
EXTENTS = np.array([0.7, 0.6, 0.39])
EXTENTS = EXTENTS / np.linalg.norm(EXTENTS)
PIVOTS = ((0.0, 0.5, 0.5), (0.0, 0.5, -0.5))
AXES: dict[JointKind, tuple[float, float, float]] = {
    "revolute": (-1.0, 0.0, 0.0),
    "prismatic": (0.0, -1.0, 0.0),
    "free": (1.0, 0.0, 0.0),
}


def chain(kinds: tuple[JointKind, ...], limits: tuple[float, float] = (-0.2, 2.9)) -> Category:
    part = Part("0", "", np.eye(3), EXTENTS, (0.1, 1.0))
    geometry = JointGeometry(*PIVOTS, (0.002, 0.002, 0.002), (0.002, 0.002, 0.002), 0.0, 0.01)
    return Category(
        name="chain",
        parts=tuple(replace(part, name=str(k)) for k in range(len(kinds) + 1)),
        joints=tuple(Joint(f"j{k}", k, k + 1, kind, AXES[kind], limits, geometry) for k, kind in enumerate(kinds)),
        num_voted=3,
        region_radius_m=1.0,
    )


def posed(category: Category, states: list[float], T_camera_root: Array) -> list[Array]:
    """Exact poses of a chain in the given states."""
    T = [T_camera_root]
    for joint, state in zip(category.joints, states, strict=True):
        axis = np.array(joint.axis)
        turn = rotation_about(axis, state) if joint.kind == "revolute" else np.eye(3)
        shift = state * axis if joint.kind == "prismatic" else np.zeros(3)
        parent, child = (SIZE_M * EXTENTS * np.array(pivot) for pivot in PIVOTS)
        T.append(T[joint.parent] @ transform_from(turn, parent + shift - turn @ child))
    return T


def evidence(T: Array, sigmas: Array, noise: Array | None = None) -> PartEvidence:
    """A part's own pose, wrong by `noise` (7,); sigmas (7,) are those of its covariance."""
    step = np.zeros(7) if noise is None else noise
    moved = Similarities(T[None, :3, :3], T[None, :3, 3], np.array([SIZE_M])).moved(step[None])
    covariance = np.diag(sigmas**2)
    return PartEvidence(transform_from(moved.R[0], moved.t[0]), float(moved.s[0]), covariance, EXTENTS)


def random_pose(rng: np.random.Generator) -> Array:
    R = so3_exp(rng.normal(size=(1, 3)))[0]
    return np.asarray(transform_from(R, np.array([*rng.normal(size=2) * 0.2, 0.8])), np.float64)


SIGMAS = np.array([0.08] * 3 + [0.01] * 3 + [0.03])


def errors(found: Articulation, truth: list[Array]) -> list[float]:
    parts = [part for part in found.parts if part is not None]
    return [float(rotation_angle(p.T_camera_part[:3, :3], T[:3, :3])) for p, T in zip(parts, truth, strict=True)]


@given(st.integers(0, 10_000), st.sampled_from(["revolute", "prismatic"]))
@settings(max_examples=20, deadline=None)
def test_consistent_parts_stay_and_give_their_state(seed: int, kind: JointKind) -> None:
    rng = np.random.default_rng(seed)
    category, state = chain((kind,)), float(rng.uniform(0.0, 2.5))
    truth = posed(category, [state], random_pose(rng))
    found = articulate(category, [evidence(T, SIGMAS) for T in truth])
    for part, T in zip(found.parts, truth, strict=True):
        assert part is not None
        np.testing.assert_allclose(part.T_camera_part, T, atol=1e-7)
        assert part.scale_m == pytest.approx(SIZE_M, abs=1e-8)
    assert found.joints[0].value == pytest.approx(state, abs=1e-6)
    assert found.joints[0].reason == ""


@pytest.mark.parametrize("kinds", [("revolute",), ("prismatic",), ("revolute",) * 6])
def test_parts_help_one_another(kinds: tuple[JointKind, ...]) -> None:
    """Over noise drawn from the covariance itself, consistent poses are nearer the truth than single ones."""
    category, before, after, scores = chain(kinds), [], [], []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        states = [float(s) for s in rng.uniform(0.3, 2.0, len(kinds))]
        truth = posed(category, states, random_pose(rng))
        noisy = [evidence(T, SIGMAS, rng.normal(size=7) * SIGMAS) for T in truth]
        found = articulate(category, noisy)
        assert all(joint.reason == "" for joint in found.joints)
        before += [float(rotation_angle(p.T_camera_part[:3, :3], T[:3, :3])) for p, T in zip(noisy, truth, strict=True)]
        after += errors(found, truth)
        for joint, state in zip(found.joints, states, strict=True):
            assert joint.value is not None
            assert joint.sigma is not None
            scores.append((joint.value - state) / joint.sigma)
    assert np.mean(after) < (0.85 if len(kinds) == 1 else 0.75) * np.mean(before)
    # What the states' standard deviations promise, they keep.
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.5


def test_a_sure_part_leads_an_unsure_one() -> None:
    category = chain(("revolute",))
    rng = np.random.default_rng(3)
    truth = posed(category, [1.2], random_pose(rng))
    turned = np.r_[rng.normal(size=3) * 0.15, np.zeros(4)]
    found = articulate(category, [evidence(truth[0], SIGMAS / 30), evidence(truth[1], 2 * SIGMAS, turned)])
    base, lid = errors(found, truth)
    hinge = truth[0][:3, 0]
    across = np.linalg.norm(turned[:3] - hinge * (hinge @ turned[:3]))
    assert base < 0.01
    assert found.parts[1] is not None
    left = so3_log((found.parts[1].T_camera_part[:3, :3] @ truth[1][:3, :3].T)[None])[0]
    assert np.linalg.norm(left - hinge * (hinge @ left)) < 0.15 * across
    assert lid < np.linalg.norm(turned[:3]) + 1e-9


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_the_answer_does_not_depend_on_where_the_camera_stands(seed: int) -> None:
    rng = np.random.default_rng(seed)
    category, motion = chain(("revolute", "prismatic")), random_pose(rng)
    truth = posed(category, [1.0, 0.1], random_pose(rng))
    here = [evidence(T, SIGMAS, rng.normal(size=7) * SIGMAS * 0.3) for T in truth]
    turn = np.zeros((7, 7))
    turn[:3, :3] = turn[3:6, 3:6] = motion[:3, :3]
    turn[6, 6] = 1.0
    there = [replace(p, T_camera_part=motion @ p.T_camera_part, covariance=turn @ p.covariance @ turn.T) for p in here]
    a, b = articulate(category, here), articulate(category, there)
    for one, other in zip(a.parts, b.parts, strict=True):
        assert one is not None
        assert other is not None
        np.testing.assert_allclose(other.T_camera_part, motion @ one.T_camera_part, atol=1e-6)
    for one, other in zip(a.joints, b.joints, strict=True):
        assert one.value == pytest.approx(other.value, abs=1e-6)


@pytest.mark.parametrize("turn_rad", [0.9, 2.0, np.pi])
def test_parts_that_contradict_each_other_are_left_alone_and_said_so(turn_rad: float) -> None:
    category = chain(("revolute",))
    truth = posed(category, [1.2], random_pose(np.random.default_rng(6)))
    wrong = truth[1] @ transform_from(rotation_about(np.array([0.0, 0.0, 1.0]), turn_rad), np.zeros(3))
    found = articulate(category, [evidence(truth[0], SIGMAS), evidence(wrong, SIGMAS)])
    assert found.parts[0] is not None
    assert found.parts[1] is not None
    np.testing.assert_allclose(found.parts[0].T_camera_part, truth[0], atol=1e-9)
    np.testing.assert_allclose(found.parts[1].T_camera_part, wrong, atol=1e-9)
    assert found.joints[0].value is None
    assert found.joints[0].reason.startswith("the poses of 0 and 1 contradict each other")


def test_a_missing_part_silences_its_joints_only() -> None:
    category = chain(("revolute", "revolute", "revolute"))
    truth = posed(category, [0.5, 0.6, 0.7], random_pose(np.random.default_rng(7)))
    parts = [evidence(T, SIGMAS) for T in truth]
    found = articulate(category, [parts[0], parts[1], None, parts[3]])
    assert [joint.reason for joint in found.joints] == ["", "no pose of 2", "no pose of 2"]
    assert found.joints[0].value == pytest.approx(0.5, abs=1e-6)
    assert found.parts[2] is None
    nothing = articulate(category, [None] * 4)
    assert nothing.parts == (None,) * 4
    assert all("no pose of" in joint.reason for joint in nothing.joints)


def test_a_free_joint_and_one_of_unknown_place_couple_only_what_they_know() -> None:
    rng = np.random.default_rng(8)
    category = chain(("free",))
    parts = [evidence(random_pose(rng), SIGMAS) for _ in range(2)]
    found = articulate(category, parts)
    for one, other in zip(found.parts, parts, strict=True):
        assert one is not None
        np.testing.assert_allclose(one.T_camera_part, other.T_camera_part, atol=1e-12)
    axis_only = replace(category, joints=(replace(chain(("revolute",)).joints[0], geometry=None),))
    truth = posed(chain(("revolute",)), [1.0], random_pose(rng))
    moved = [evidence(truth[0], SIGMAS), evidence(truth[1], SIGMAS, np.r_[np.zeros(3), 0.05, -0.02, 0.03, 0.1])]
    found = articulate(axis_only, moved)
    assert found.parts[1] is not None
    np.testing.assert_allclose(found.parts[1].T_camera_part, moved[1].T_camera_part, atol=1e-9)


@given(st.integers(0, 10_000), st.sampled_from(["revolute", "prismatic", "free"]))
@settings(max_examples=30, deadline=None)
def test_derivatives_are_those_of_finite_differences(seed: int, kind: JointKind) -> None:
    rng = np.random.default_rng(seed)
    category = chain((kind,))
    joint, extents = category.joints[0], np.array([EXTENTS, EXTENTS])
    truth = posed(category, [0.8], random_pose(rng))
    pair = Similarities(np.array(truth)[:, :3, :3], np.array(truth)[:, :3, 3], np.full(2, SIZE_M))
    near = pair.moved(rng.normal(size=(2, 7)) * 0.003)
    pair = pair.moved(rng.normal(size=(2, 7)) * np.r_[np.full(3, 0.1), np.full(4, 0.02)])
    h = 1e-5

    def central(function: Callable[[Similarities], Array | float], pair: Similarities) -> Array:
        columns = []
        for k in range(14):
            step = np.zeros(14)
            step[k] = h
            ahead, behind = (np.atleast_1d(function(pair.moved(s.reshape(2, 7)))) for s in (step, -step))
            columns.append((ahead - behind) / (2 * h))
        return np.stack(columns, axis=-1)

    for rows, at, share in ((slice(0, 3), pair, 2e-3), (slice(3, 5), near, 2e-2)):
        # The spread's own change with the pose is of second order, and left out.
        if kind == "prismatic" or (kind == "revolute" and rows.start == 0):
            numeric = central(lambda moved, rows=rows: joint_residual(joint, moved, extents).value[rows], at)
            jacobian = joint_residual(joint, at, extents).jacobian[rows]
            np.testing.assert_allclose(jacobian, numeric, atol=share * np.abs(numeric).max())
    # A revolute state's derivative is exact where the axes agree.
    _, derivative = joint_state(joint, near, extents)
    numeric = central(lambda moved: joint_state(joint, moved, extents)[0], near)[0]
    np.testing.assert_allclose(derivative, numeric, atol=0.02 if kind == "revolute" else 1e-4)


@given(st.integers(0, 10_000), st.floats(0.0, 3.14159))
@settings(max_examples=60, deadline=None)
def test_logarithm_undoes_exponential_and_its_jacobian_is_right(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    turn = angle * axis / np.linalg.norm(axis)
    np.testing.assert_allclose(so3_log(so3_exp(turn[None]))[0], turn, atol=1e-7)
    if angle < 3.0:
        step = rng.normal(size=3) * 1e-6
        moved = so3_log(so3_exp(step[None]) @ so3_exp(turn[None]))[0]
        np.testing.assert_allclose(moved - turn, inverse_left_jacobian(turn) @ step, atol=1e-9)


def test_another_number_of_parts_is_an_error() -> None:
    with pytest.raises(ValueError, match="expected 2"):
        articulate(chain(("revolute",)), [None])


def test_states_count_turns_from_the_middle_of_the_limits() -> None:
    category = chain(("revolute",), limits=(3.0, 6.0))
    truth = posed(category, [4.0], np.eye(4))
    found = articulate(category, [evidence(T, SIGMAS) for T in truth])
    assert found.joints[0].value == pytest.approx(4.0, abs=1e-6)
    assert np.allclose(invert(truth[0]) @ truth[0], np.eye(4))
