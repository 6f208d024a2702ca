"""The metrics on a thousand random cases against ways to compute them that share nothing with ours."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import toy
from page_runtime.boxes import box_iou
from page_runtime.evaluation import PartError, joint_errors, part_errors, rotation_error, translation_error
from page_runtime.geometry import Array, apply, rotation_about, transform_from
from page_runtime.pose import ArticulatedPose, JointState, NotSeen, PartPose
from page_runtime.recorded import PartTruth
from page_runtime.validation.comparison import compared
from page_runtime.validation.figures import figures_of, folded_and_capped_deg, paper_compatible
from page_runtime.validation.statistics import PERCENTILES, Resampling, distribution, share_interval
from page_runtime.validation.symmetry_choice import symmetry_choice, with_symmetries

CASES = 1000
TRIPLES = np.array(list(combinations(range(12), 3)))


def iou_by_corners(one: tuple[Array, Array], other: tuple[Array, Array]) -> float:
    """Every point that three of the twelve faces' planes share, those inside both boxes, and their convex hull."""
    planes = []
    for T, extents in (one, other):
        normals = np.concatenate([T[:3, :3].T, -T[:3, :3].T])
        planes.append(np.column_stack([normals, normals @ T[:3, 3] + np.tile(extents / 2, 2)]))
    normals, offsets = np.concatenate(planes)[:, :3], np.concatenate(planes)[:, 3]
    solvable = np.abs(np.linalg.det(normals[TRIPLES])) > 1e-9
    chosen = TRIPLES[solvable]
    points = np.linalg.solve(normals[chosen], offsets[chosen][..., None])[..., 0]
    corners = points[(points @ normals.T <= offsets + 1e-9).all(axis=1)]
    volume = 0.0
    if len(corners) >= 4 and np.linalg.matrix_rank(corners - corners.mean(axis=0), tol=1e-6) == 3:
        volume = float(ConvexHull(corners).volume)
    return volume / (float(np.prod(one[1]) + np.prod(other[1])) - volume)


def random_pose(rng: np.random.Generator, spread_m: float) -> Array:
    return transform_from(Rotation.random(None, rng).as_matrix(), rng.normal(0, spread_m, 3))


def test_rotation_and_translation_are_those_of_an_independent_implementation_in_a_thousand_cases() -> None:
    rng = np.random.default_rng(7)
    for case in range(CASES):
        one = random_pose(rng, 0.5)
        axis = rng.normal(size=3)
        # Every tenth is half a turn, every eleventh next to none: where arc cosines lose their digits.
        angle = np.pi if case % 10 == 0 else 1e-7 if case % 11 == 0 else rng.uniform(0, np.pi)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle).as_matrix()
        other = transform_from(one[:3, :3] @ turn, rng.normal(0, 0.5, 3))
        relative = Rotation.from_matrix(one[:3, :3]).inv() * Rotation.from_matrix(other[:3, :3])
        assert np.degrees(rotation_error(one, other)) == pytest.approx(np.degrees(relative.magnitude()), abs=1e-6)
        assert translation_error(one, other) == pytest.approx(np.sqrt(((one - other)[:3, 3] ** 2).sum()), abs=1e-12)


def test_iou_is_that_of_the_polyhedron_of_common_corners_in_a_thousand_cases() -> None:
    rng = np.random.default_rng(8)
    apart = 0
    for case in range(CASES):
        one = random_pose(rng, 0.08), rng.uniform(0.02, 0.5, 3)
        if case % 5 == 0:  # As estimates are: nearly the same box.
            T = one[0] @ transform_from(rotation_about(rng.normal(size=3), 0.05), rng.normal(0, 0.01, 3))
            other = T, one[1] * rng.uniform(0.9, 1.1, 3)
        else:
            other = random_pose(rng, 0.08), rng.uniform(0.02, 0.5, 3)
        expected = iou_by_corners(one, other)
        apart += expected == 0.0
        assert box_iou(*one, *other) == pytest.approx(expected, abs=1e-4)
    assert 0 < apart < CASES / 2


def part_pose(name: str, T: Array, extents_m: Array) -> PartPose:
    unit = {part.name: part.keypoints_unit for part in toy.CATEGORY.parts}[name]
    keypoints = apply(T, float(np.linalg.norm(extents_m)) * unit)
    return PartPose(name, T, extents_m, keypoints, np.ones(3), 0.9, 1.0, 0.0, 0, 100, 0.0, np.eye(6))


def toy_truths() -> tuple[PartTruth, ...]:
    states = (None, toy.STATE_RAD)
    return tuple(
        PartTruth(name, T, extents, 1.0, state)
        for name, T, extents, state in zip(("base", "lid"), toy.part_poses(), toy.EXTENTS_M, states, strict=True)
    )


def pose_of(*parts: PartPose | NotSeen, state: float | None = toy.STATE_RAD) -> ArticulatedPose:
    return ArticulatedPose(parts, (JointState("hinge", "revolute", state, 0.1, (0.0, np.pi)),), {})


def exact_parts() -> list[PartPose]:
    return [part_pose(truth.name, truth.T_camera_part, truth.extents_m) for truth in toy_truths()]


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1)])
def test_half_a_turn_is_180_degrees_unless_the_part_looks_the_same_after_it(axis: tuple[int, int, int]) -> None:
    base, lid = exact_parts()
    turned = lid.T_camera_part @ transform_from(rotation_about(np.array(axis, float), np.pi), np.zeros(3))
    pose = pose_of(base, part_pose("lid", turned, lid.extents_m))
    _, error = part_errors(toy.CATEGORY, pose, toy_truths())
    assert error.rotation_rad == pytest.approx(np.pi)
    assert error.iou == pytest.approx(1.0)
    symmetric = with_symmetries(toy.CATEGORY, [symmetry_choice(f"lid={'xyz'[axis.index(1)]}:2")])
    _, error = part_errors(symmetric, pose, toy_truths())
    assert error.rotation_rad == pytest.approx(0.0, abs=1e-7)
    without = with_symmetries(symmetric, [symmetry_choice("none")])
    assert part_errors(without, pose, toy_truths())[1].rotation_rad == pytest.approx(np.pi)


def test_a_pose_that_is_not_finite_counts_as_a_missing_one_and_leaves_no_nan_in_the_figures() -> None:
    base, lid = exact_parts()
    broken = replace(lid, T_camera_part=np.full((4, 4), np.nan))
    figures = figures_of(toy.CATEGORY, [(pose_of(base, broken), toy_truths()), (pose_of(base, lid), toy_truths())])
    _, part = figures["parts"]
    assert (part["visible"], part["missing"], part["failure_rate"]) == (2, 1, 0.5)
    assert part["rotation_deg"]["mean"] == pytest.approx(0.0, abs=1e-7)
    assert part["iou"]["mean"] == pytest.approx(0.5)
    json.dumps(figures, allow_nan=False)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_keypoints_move_as_far_as_their_part(seed: int) -> None:
    rng = np.random.default_rng(seed)
    base, lid = exact_parts()
    shift = transform_from(np.eye(3), rng.normal(0, 0.05, 3))
    pose = pose_of(base, part_pose("lid", shift @ lid.T_camera_part, lid.extents_m))
    errors = part_errors(toy.CATEGORY, pose, toy_truths())
    assert errors[0].keypoint_m == pytest.approx(0.0, abs=1e-12)
    assert errors[1].keypoint_m == pytest.approx(np.linalg.norm(shift[:3, 3]))
    assert errors[1].translation_m == pytest.approx(errors[1].keypoint_m)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 3.0))
def test_a_joints_axis_turns_with_its_parent_but_not_about_itself(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    base, lid = exact_parts()
    axis = np.array(toy.CATEGORY.joints[0].axis)
    across = np.cross(axis, rng.normal(size=3))
    for about, expected in ((across, angle), (axis, 0.0)):
        turned = base.T_camera_part @ transform_from(rotation_about(about, angle), np.zeros(3))
        pose = pose_of(part_pose("base", turned, base.extents_m), lid, state=toy.STATE_RAD + 0.1)
        (joint,) = joint_errors(toy.CATEGORY, pose, toy_truths())
        assert joint.axis_rad == pytest.approx(expected, abs=1e-6)
        assert joint.error == pytest.approx(0.1)


def test_a_random_pose_has_127_degrees_and_36_as_the_paper_counts() -> None:
    rng = np.random.default_rng(3)
    angles = Rotation.random(20_000, rng).magnitude()
    assert np.degrees(angles).mean() == pytest.approx(126.5, abs=1.0)
    assert np.mean([folded_and_capped_deg(float(angle)) for angle in angles]) == pytest.approx(36.1, abs=0.5)


def test_a_missing_pose_is_an_error_of_0_only_where_the_paper_counts() -> None:
    base, _ = exact_parts()
    one = compared(toy.CATEGORY, pose_of(base, NotSeen("lid", "hidden"), state=None), toy_truths(), frame=0)
    assert paper_compatible(toy.CATEGORY, [one])[1]["rotation_deg"] == 0.0
    assert one.parts[1].failed
    assert one.parts[1].reason == "hidden"


@pytest.mark.parametrize("text", ["", "lid", "lid=z", "lid=w:2", "lid=z:0", "lid=z:-1", "lid=z:two", "=z:2"])
def test_a_symmetry_that_cannot_be_understood_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected none, or PART=AXIS:FOLD"):
        symmetry_choice(text)


def test_a_symmetry_of_a_part_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match="no part 'door' in box; it has base, lid"):
        with_symmetries(toy.CATEGORY, [symmetry_choice("door=z:2")])


def written_out(values: list[float], frames: list[int], counts: np.ndarray) -> list[float]:
    return [value for value, frame in zip(values, frames, strict=True) for _ in range(counts[frame])]


@settings(deadline=None, max_examples=40)
@given(st.lists(st.tuples(st.floats(0, 100), st.integers(0, 7)), min_size=1, max_size=30), st.integers(0, 1000))
def test_intervals_are_those_of_samples_written_out(drawn: list[tuple[float, int]], seed: int) -> None:
    values, frames = [value for value, _ in drawn], [frame for _, frame in drawn]
    resampling = Resampling.of(8, seed=seed, replicates=40)
    assert (resampling.counts.sum(axis=1) == 8).all()
    replicates = [written_out(values, frames, counts) for counts in resampling.counts]
    known = [one for one in replicates if one]
    figures = distribution(values, frames, resampling)
    assert figures["median"] == pytest.approx(float(np.median(values)))
    for name, of in (("mean", np.mean), *((f"p{p}", lambda one, p=p: np.percentile(one, p)) for p in PERCENTILES)):
        expected = np.percentile([of(one) for one in known], (2.5, 97.5))
        np.testing.assert_allclose(figures["ci95"][name], expected, atol=1e-9)


def test_the_interval_of_a_mean_holds_the_truth_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    resampling = Resampling.of(80)
    held = 0
    for _ in range(200):
        low, high = distribution(list(rng.exponential(1.0, 80)), list(range(80)), resampling)["ci95"]["mean"]
        held += low <= 1.0 <= high
    assert 0.88 <= held / 200 <= 0.98


@given(st.integers(0, 200), st.integers(1, 200))
def test_the_interval_of_a_share_holds_it_and_has_a_width(hits: int, count: int) -> None:
    known = [i < hits for i in range(count)]
    low, high = share_interval(known) or (1.0, 0.0)
    assert 0.0 <= low <= np.mean(known) <= high <= 1.0
    assert high - low > 0.0
    assert share_interval([]) is None


def test_an_error_that_is_nan_is_no_hit() -> None:
    assert PartError("lid", float("nan"), 0.0, 0.0, 1.0).failed
