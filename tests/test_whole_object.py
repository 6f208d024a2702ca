"""A chain whose parts say nothing of how they are turned: found from one of them, its joints and its surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from chain_objects import (
    AXES,
    DIAGONAL_M,
    KEYPOINTS,
    STATES,
    TEMPLATE,
    chain_of,
    errors,
    piece,
    posed,
    root_pose,
    similarity,
)
from page_runtime.articulation import PartEvidence, articulate
from page_runtime.category import Category, JointKind
from page_runtime.chain_fit import WholePose, whole_pose
from page_runtime.geometry import rotation_about, transform_from
from page_runtime.pieces import Piece, misfits
from page_runtime.registration import Observed, registered_at
from page_runtime.similarity import FloatArray as Array
from page_runtime.similarity import Similarities, so3_exp
from page_runtime.whole_object import whole_instead

COVARIANCE = np.diag([0.03] * 3 + [0.003] * 3 + [0.02]) ** 2


@pytest.mark.parametrize("kinds", [("revolute",) * 3, ("revolute", "prismatic"), ("prismatic", "revolute")])
@pytest.mark.parametrize("root", [0, 1, 2])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_chain_is_found_from_any_of_its_parts(kinds: tuple[JointKind, ...], root: int, seed: int) -> None:
    category = chain_of(kinds)
    states = tuple(s if kind == "revolute" else 0.08 for s, kind in zip(STATES, kinds, strict=False))
    T = posed(category, states, root_pose(seed))
    whole = whole_pose(category, [piece(one, seed) for one in T], {root: similarity(T[root])})
    assert whole is not None
    assert whole.parts == tuple(range(len(T)))
    turned, off = errors(whole, T)
    assert turned < 3.0
    assert off < 8.0


def test_errors_do_not_add_up_along_a_long_chain() -> None:
    count = 15
    category = chain_of(("revolute",) * count)
    T = posed(category, tuple(0.4 * (-1) ** k for k in range(count)), root_pose(0))
    whole = whole_pose(category, [piece(one) for one in T], {0: similarity(T[0])})
    assert whole is not None
    turned, off = errors(whole, T)
    assert turned < 1.0
    assert off < 2.0


def test_a_first_part_turned_about_its_joint_is_turned_back() -> None:
    category = chain_of(("revolute",) * 3)
    T = posed(category, STATES, root_pose(3))
    wrong = T[0] @ transform_from(rotation_about(np.array([1.0, 0.0, 0.0]), 1.1), np.zeros(3))
    whole = whole_pose(category, [piece(one) for one in T], {0: similarity(wrong)})
    assert whole is not None
    assert errors(whole, T)[0] < 3.0


@pytest.mark.parametrize("turns", [-1, 1])
def test_limits_may_be_told_a_turn_further(turns: int) -> None:
    category = chain_of(("revolute",) * 2)
    shifted = tuple(
        replace(joint, limits=(joint.limits[0] + turns * 2 * np.pi, joint.limits[1] + turns * 2 * np.pi))
        for joint in category.joints
    )
    T = posed(category, STATES, root_pose(0))
    pieces = [piece(one) for one in T]
    whole = whole_pose(replace(category, joints=shifted), pieces, {0: similarity(T[0])})
    assert whole is not None
    assert errors(whole, T)[0] < 3.0


def test_a_part_that_its_points_do_not_hold_is_told_as_unknown() -> None:
    category = chain_of(("revolute",) * 3)
    T = posed(category, STATES, root_pose(0))
    pieces = [piece(one) for one in T]
    pieces[3] = replace(pieces[3], points=pieces[3].points + np.array([0.0, 0.0, 3.0]))
    whole = whole_pose(category, pieces, {0: similarity(T[0])})
    assert whole is not None
    assert whole.misfit[3] > 0.5
    spread = np.linalg.eigvalsh(whole.covariances[3])
    assert spread[0] > 0.0
    assert spread[-1] > 1.0
    assert np.linalg.cond(whole.covariances[3]) < 1e9


@pytest.mark.parametrize("unseen", [1, 2])
@pytest.mark.parametrize("states", [STATES, (-1.9, 0.4, -0.7), (1.6, -1.5, 0.2), (0.1, 1.2, 1.8)])
def test_what_is_behind_a_part_without_points_is_placed_through_it(unseen: int, states: tuple[float, ...]) -> None:
    category = chain_of(("revolute",) * 3)
    T = posed(category, states, root_pose(0))
    pieces: list[Piece | None] = [piece(one) for one in T]
    pieces[unseen] = None
    whole = whole_pose(category, pieces, {0: similarity(T[0])})
    assert whole is not None
    assert whole.parts == tuple(k for k in range(4) if k != unseen)
    assert errors(whole, T)[0] < 4.0
    assert whole_pose(category, pieces, {}) is None


def test_what_is_behind_two_parts_without_points_is_left_out() -> None:
    category = chain_of(("revolute",) * 3)
    T = posed(category, STATES, root_pose(0))
    whole = whole_pose(category, [piece(T[0]), None, None, piece(T[3])], {0: similarity(T[0])})
    assert whole is not None
    assert whole.parts == (0,)


@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1), (1, 0, 2), (2, 1, 0)])
def test_the_order_of_a_trees_joints_does_not_matter(order: tuple[int, ...]) -> None:
    """Two branches, one of them begun by a part without points."""
    category = chain_of(("revolute",) * 3)
    T_0 = root_pose(0)
    first = posed(category, (1.5, -0.6), T_0)
    second = posed(replace(category, joints=category.joints[1:]), (0.3,), T_0)
    T = [T_0, first[1], second[1], first[2]]
    ends = ((0, 1, 0), (0, 2, 1), (1, 3, 1))
    joints = [
        replace(category.joints[0], name=f"j{k}", parent=parent, child=child, axis=AXES[axis])
        for k, (parent, child, axis) in enumerate(ends)
    ]
    tree = replace(category, joints=tuple(joints[k] for k in order))
    whole = whole_pose(tree, [piece(T[0]), None, piece(T[2]), piece(T[3])], {0: similarity(T[0])})
    assert whole is not None
    assert whole.parts == (0, 2, 3)
    assert errors(whole, T)[0] < 4.0


def test_what_is_behind_a_part_without_points_and_surface_is_left_out() -> None:
    category = chain_of(("revolute",) * 3)
    T = posed(category, STATES, root_pose(0))
    bare = tuple(replace(part, template=None) if k == 2 else part for k, part in enumerate(category.parts))
    pieces = [piece(T[0]), piece(T[1]), None, piece(T[3])]
    whole = whole_pose(replace(category, parts=bare), pieces, {0: similarity(T[0])})
    assert whole is not None
    assert whole.parts == (0, 1)


def test_turning_the_camera_turns_what_is_found() -> None:
    category = chain_of(("revolute",) * 2)
    T = posed(category, STATES, root_pose(1))
    turn = so3_exp(np.array([[0.1, -0.2, 0.4]]))[0]
    pieces = [piece(one) for one in T]
    turned = [replace(one, points=one.points @ turn.T) for one in pieces]
    start = transform_from(turn, np.zeros(3)) @ T[0]
    here, there = (
        whole_pose(category, pieces, {0: similarity(T[0])}),
        whole_pose(category, turned, {0: similarity(start)}),
    )
    assert here is not None
    assert there is not None
    assert np.allclose(turn @ here.poses.R, there.poses.R, atol=1e-3)
    assert np.allclose(here.poses.t @ turn.T, there.poses.t, atol=1e-3)


def test_misfits_are_those_of_every_point_and_sample() -> None:
    T = root_pose(2)
    own = piece(T, told=True).sketch()
    poses = [T, T @ transform_from(rotation_about(np.array([0.0, 0.0, 1.0]), 0.3), np.array([0.02, 0.0, 0.0]))]
    found = misfits(own, np.array([p[:3, :3] for p in poses]), np.array([p[:3, 3] for p in poses]))
    for pose, value in zip(poses, found, strict=True):
        places = DIAGONAL_M * own.surface.points_unit @ pose[:3, :3].T + pose[:3, 3]
        normals = own.surface.normals_unit @ pose[:3, :3].T
        near2 = max(0.006, 0.03 * DIAGONAL_M) ** 2
        surface = []
        for point in own.points:
            apart = point - places
            squares = (np.sum(apart**2, axis=1) + 15.0 * np.sum(normals * apart, axis=1) ** 2) / 16.0
            least = (squares + near2 * (np.sum(normals * places, axis=1) > 0.0)).min()
            surface.append(least / (least + near2))
        keypoints = DIAGONAL_M * KEYPOINTS @ pose[:3, :3].T + pose[:3, 3]
        off = np.linalg.norm(own.points[:, None] - keypoints, axis=2) - own.radii_m
        ratio2 = (off / (0.1 * DIAGONAL_M)) ** 2
        assert value == pytest.approx(0.7 * np.mean(surface) + 0.3 * np.mean(ratio2 / (1.0 + ratio2)), abs=2e-3)
    assert found[0] < found[1] < 1.0


def observed(one: Piece) -> Observed:
    return Observed(
        one.points, one.radii_m, KEYPOINTS, (), TEMPLATE.extents_unit, (0.1, 1.0), None, diagonal_m=DIAGONAL_M
    )


def evidence(T: Array) -> PartEvidence:
    return PartEvidence(T, DIAGONAL_M, COVARIANCE, TEMPLATE.extents_unit)


def asked(category: Category, pieces: list[Piece], poses: list[PartEvidence | None]) -> WholePose | None:
    own = [() if one is None else (one,) for one in poses]
    return whole_instead(category, [observed(one) for one in pieces], own, articulate(category, poses))


def test_parts_that_make_sense_are_left_alone() -> None:
    category = chain_of(("revolute",) * 2)
    T = posed(category, STATES, root_pose(0))
    assert asked(category, [piece(one) for one in T], [evidence(one) for one in T]) is None


def test_a_part_without_a_pose_and_one_that_contradicts_its_joint_are_placed() -> None:
    category = chain_of(("revolute",) * 3)
    T = posed(category, STATES, root_pose(0))
    wrong = T[2] @ transform_from(rotation_about(np.array([0.0, 1.0, 0.0]), 1.5), np.zeros(3))
    whole = asked(category, [piece(one) for one in T], [evidence(T[0]), None, evidence(wrong), evidence(T[3])])
    assert whole is not None
    assert errors(whole, T)[0] < 3.0


def test_an_impossible_size_is_taken_for_the_nearest_possible_one() -> None:
    category = chain_of(("revolute",))
    T = posed(category, STATES, root_pose(0))
    seen = [replace(observed(piece(one)), diagonal_m=5.0, scale_range_m=(0.1, DIAGONAL_M)) for one in T]
    poses = [evidence(T[0]), None]
    whole = whole_instead(category, seen, [(evidence(T[0]),), ()], articulate(category, poses))
    assert whole is not None
    assert errors(whole, T)[0] < 3.0


def test_an_object_of_another_shape_is_not_explained_as_a_whole() -> None:
    category = chain_of(("revolute",) * 2)
    T = posed(category, STATES, root_pose(0))
    rng = np.random.default_rng(0)
    clouds = []
    for one in T:
        points = one[:3, 3] + rng.normal(scale=0.4, size=(120, 3))
        radii = rng.uniform(0.5, 2.0, (120, len(KEYPOINTS)))
        clouds.append(Piece(points, radii, KEYPOINTS, DIAGONAL_M, TEMPLATE))
    before = [evidence(one) for one in T]
    before[2] = evidence(T[2] @ transform_from(rotation_about(np.array([0.0, 1.0, 0.0]), 2.0), np.zeros(3)))
    assert asked(category, clouds, list(before)) is None


@pytest.mark.parametrize("missing", ["template", "size", "geometry"])
def test_without_surfaces_sizes_or_places_nothing_is_tried(missing: str) -> None:
    category = chain_of(("revolute",) * 2)
    T = posed(category, STATES, root_pose(0))
    seen: list[Observed | str] = [observed(piece(one)) for one in T]
    if missing == "template":
        category = replace(category, parts=tuple(replace(part, template=None) for part in category.parts))
    elif missing == "size":
        seen = [replace(one, diagonal_m=None) for one in seen if isinstance(one, Observed)]
    else:
        category = replace(category, joints=tuple(replace(joint, geometry=None) for joint in category.joints))
    poses = [evidence(T[0]), None, None]
    assert whole_instead(category, seen, [(evidence(T[0]),), (), ()], articulate(category, poses)) is None


def test_registered_at_a_pose_leaves_it_and_calls_it_no_better_than_others() -> None:
    T = root_pose(0)
    found = registered_at(observed(piece(T, told=True)), similarity(T))
    assert not isinstance(found, str)
    assert np.allclose(found.T_camera_part, T)
    assert found.runner_up_ratio == 1.0
    assert found.inlier_share > 0.9
    larger = Similarities(T[None, :3, :3], T[None, :3, 3], np.array([1.1]))
    assert "outside 0.1 to 1 m" in str(registered_at(observed(piece(T)), larger))
