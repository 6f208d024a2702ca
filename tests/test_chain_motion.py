"""Placements of a chain moved onto their points: never off the joints, and nearer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from chain_objects import DIAGONAL_M, KEYPOINTS, PIVOTS, TEMPLATE, chain_of, piece, posed, root_pose
from page_runtime.category import Category, JointKind
from page_runtime.chain_motion import Link, settled
from page_runtime.geometry import rotation_angle, transform_from
from page_runtime.pieces import Placements, misfits
from page_runtime.similarity import FloatArray, so3_exp

KINDS: tuple[tuple[JointKind, ...], ...] = (
    ("revolute", "revolute", "revolute"),
    ("revolute", "prismatic"),
    ("prismatic", "revolute"),
)
MIDDLE = (0.9, -0.8, 1.1)
OFF = (0.1, -0.1, 0.1)


def states_of(kinds: tuple[JointKind, ...], off: float) -> tuple[float, ...]:
    return tuple(
        value + off * by if kind == "revolute" else 0.06 + 0.1 * off * by
        for kind, value, by in zip(kinds, MIDDLE, OFF, strict=False)
    )


def outwards(category: Category, root: int) -> tuple[list[Link], list[FloatArray]]:
    """Links of a chain from one of its parts, and where their joints are on the parts before them."""
    up = [Link(category.joints[k], k, k + 1) for k in range(root, len(category.joints))]
    down = [Link(category.joints[k - 1], k, k - 1) for k in range(root, 0, -1)]
    links = up + down
    extents_m = DIAGONAL_M * TEMPLATE.extents_unit
    return links, [np.array(PIVOTS[0 if one.known == one.joint.parent else 1]) * extents_m for one in links]


def placements(poses: list[list[FloatArray]]) -> Placements:
    T = np.array(poses)
    return Placements(T[..., :3, :3].copy(), T[..., :3, 3].copy(), np.ones(T.shape[:2]))


def starts(kinds: tuple[JointKind, ...], seed: int) -> tuple[Category, list[FloatArray], Placements]:
    """A chain, its true poses, and two placements on its joints: near the truth, and nearer."""
    category, T = chain_of(kinds), root_pose(seed)
    true = posed(category, states_of(kinds, 0.0), T)
    shift = transform_from(so3_exp(np.array([[0.04, -0.03, 0.05]]))[0], np.array([0.01, -0.006, 0.008]))
    about = transform_from(np.eye(3), T[:3, 3])
    near = about @ shift @ np.linalg.inv(about) @ T
    return (
        category,
        true,
        placements([posed(category, states_of(kinds, 1.0), near), posed(category, states_of(kinds, 0.5), T)]),
    )


@pytest.mark.parametrize("kinds", KINDS)
@pytest.mark.parametrize("root", [0, 1, 2])
def test_joints_are_kept_and_the_parts_come_nearer(kinds: tuple[JointKind, ...], root: int) -> None:
    category, true, state = starts(kinds, 4)
    sketches = [piece(one).sketch() for one in true]
    before = [misfits(one, state.R[:, k], state.t[:, k]) for k, one in enumerate(sketches)]
    given = state.R.copy(), state.t.copy()
    links, pivots = outwards(category, root)
    found = state
    for _ in range(3):
        found = settled(found, sketches, root, links, pivots)
    np.testing.assert_array_equal(state.R, given[0])
    np.testing.assert_array_equal(state.t, given[1])
    assert (found.misfit.sum(axis=1) < np.sum(before, axis=0)).all()
    for k, one in enumerate(sketches):
        np.testing.assert_allclose(found.misfit[:, k], misfits(one, found.R[:, k], found.t[:, k]))
    np.testing.assert_allclose(
        found.R.transpose(0, 1, 3, 2) @ found.R, np.broadcast_to(np.eye(3), found.R.shape), atol=1e-9
    )
    extents_m = DIAGONAL_M * TEMPLATE.extents_unit
    for joint in category.joints:
        parent, child = found.R[:, joint.parent], found.R[:, joint.child]
        axis = np.array(joint.axis)
        np.testing.assert_allclose(parent @ axis, child @ axis, atol=1e-9)
        ends = [
            found.t[:, k] + found.R[:, k] @ (np.array(pivot) * extents_m)
            for k, pivot in ((joint.parent, PIVOTS[0]), (joint.child, PIVOTS[1]))
        ]
        gap = ends[1] - ends[0]
        if joint.kind == "prismatic":
            np.testing.assert_allclose(parent, child, atol=1e-9)
            gap -= np.einsum("ck,ck->c", gap, parent @ axis)[:, None] * (parent @ axis)
        np.testing.assert_allclose(gap, 0.0, atol=1e-9)


def turned_deg(found: Placements, true: list[FloatArray]) -> FloatArray:
    """(C,) the mean over the parts."""
    own = np.array([[rotation_angle(R, T[:3, :3]) for R, T in zip(one, true, strict=True)] for one in found.R])
    return np.degrees(own).mean(axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_what_steps_of_the_states_left_is_made_good(seed: int) -> None:
    category, true, state = starts(("revolute",) * 3, seed)
    pieces = [piece(one, seed) for one in true]
    links, pivots = outwards(category, 0)
    assert turned_deg(state, true)[1] > 3.0
    for _ in range(3):
        state = settled(state, pieces, 0, links, pivots)
    assert turned_deg(state, true)[1] < 0.5


def test_the_truth_stays_within_the_noise() -> None:
    category = chain_of(("revolute",) * 3)
    true = posed(category, MIDDLE, root_pose(1))
    links, pivots = outwards(category, 0)
    found = settled(placements([true]), [piece(one).sketch() for one in true], 0, links, pivots)
    np.testing.assert_allclose(found.R[0], np.array(true)[:, :3, :3], atol=0.02)
    np.testing.assert_allclose(found.t[0], np.array(true)[:, :3, 3], atol=0.002)


def test_parts_without_points_go_where_their_neighbours_take_them() -> None:
    category, true, state = starts(("revolute",) * 3, 2)
    pieces = [piece(one) for one in true]
    unseen = replace(pieces[1], points=np.zeros((0, 3)), radii_m=np.zeros((0, len(KEYPOINTS))))
    assert not unseen.seen
    pieces[1] = unseen
    links, pivots = outwards(category, 0)
    before = turned_deg(state, true)
    for _ in range(3):
        state = settled(state, [one.sketch() for one in pieces], 0, links, pivots)
    assert turned_deg(state, true)[1] < 0.5 * before[1]
    np.testing.assert_array_equal(misfits(unseen, state.R[:, 1], state.t[:, 1]), 0.0)
