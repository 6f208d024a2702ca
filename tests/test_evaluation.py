"""Laws of the metrics, and the exact box intersection against two independent ways to compute it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection

from page_runtime.boxes import EDGES, box_corners, box_iou, intersection_volume
from page_runtime.category import Category, Part
from page_runtime.evaluation import PartError, part_errors, rotation_error, translation_error
from page_runtime.geometry import Array, apply, invert, rotation_about, transform_from
from page_runtime.pose import ArticulatedPose, NotSeen, PartPose
from page_runtime.recorded import PartTruth
from page_runtime.validation.figures import summarise

Box = tuple[Array, Array]
ONE_PART = Category("one", (Part("base", "", np.eye(3), np.ones(3), (0.1, 2.0)),), (), 3, 1.0)
seeds = st.integers(0, 2**32 - 1)


def random_rotation(rng: np.random.Generator) -> Array:
    return rotation_about(rng.normal(size=3), rng.uniform(0, np.pi))


def random_box(rng: np.random.Generator, *, spread: float = 0.15) -> Box:
    return transform_from(random_rotation(rng), rng.normal(0, spread, 3)), rng.uniform(0.02, 0.5, 3)


def half_spaces(T: Array, extents: Array) -> Array:
    """(6,4) rows a, b with a x + b <= 0 inside."""
    normals = np.concatenate([T[:3, :3].T, -T[:3, :3].T])
    return np.column_stack([normals, -normals @ T[:3, 3] - np.tile(extents / 2, 2)])


def volume_by_half_spaces(one: Box, other: Box) -> float:
    """The shared volume by scipy: the most interior point by a linear programme, then qhull."""
    planes = np.concatenate([half_spaces(*one), half_spaces(*other)])
    inward = np.column_stack([planes[:, :3], np.ones(12)])
    solved = linprog([0, 0, 0, -1], inward, -planes[:, 3], bounds=[(None, None)] * 4)
    if not solved.success or solved.x[3] <= 1e-9:
        return 0.0
    return float(ConvexHull(HalfspaceIntersection(planes, solved.x[:3]).intersections).volume)


@settings(deadline=None, max_examples=60)
@given(seeds)
def test_the_shared_volume_is_what_half_space_intersection_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = random_box(rng), random_box(rng)
    assert intersection_volume(*one, *other) == pytest.approx(volume_by_half_spaces(one, other), rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_shared_volume_is_what_counting_points_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = random_box(rng, spread=0.05), random_box(rng, spread=0.05)
    points = rng.uniform(-0.5, 0.5, (200_000, 3)) * one[1]
    inside = np.abs(apply(invert(other[0]) @ one[0], points)) <= other[1] / 2
    share = inside.all(axis=1).mean()
    error = 4 * np.sqrt(share * (1 - share) / len(points)) + 1e-4
    assert intersection_volume(*one, *other) / np.prod(one[1]) == pytest.approx(share, abs=error)


@settings(deadline=None)
@given(seeds)
def test_iou_is_one_of_a_box_with_itself_and_zero_of_boxes_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, extents = random_box(rng)
    assert box_iou(T, extents, T, extents) == pytest.approx(1.0, abs=1e-9)
    apart = T @ transform_from(random_rotation(rng), np.array([np.linalg.norm(extents) + 1.0, 0, 0]))
    assert box_iou(T, extents, apart, rng.uniform(0.1, 0.5, 3)) == 0.0


@settings(deadline=None)
@given(seeds)
def test_iou_does_not_know_order_frame_unit_or_which_axis_is_which(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = random_box(rng, spread=0.05), random_box(rng, spread=0.05)
    iou = box_iou(*one, *other)
    assert box_iou(*other, *one) == pytest.approx(iou, abs=1e-9)
    T_b_a = transform_from(random_rotation(rng), rng.normal(size=3))
    assert box_iou(T_b_a @ one[0], one[1], T_b_a @ other[0], other[1]) == pytest.approx(iou, abs=1e-9)
    in_mm = [(transform_from(T[:3, :3], T[:3, 3] * 1e3), extents * 1e3) for T, extents in (one, other)]
    assert box_iou(*in_mm[0], *in_mm[1]) == pytest.approx(iou, abs=1e-9)
    turned = transform_from(np.roll(np.eye(3), 1, axis=0), np.zeros(3))
    assert box_iou(one[0] @ turned, np.roll(one[1], -1), *other) == pytest.approx(iou, abs=1e-9)


@given(st.lists(st.floats(-0.6, 0.6), min_size=3, max_size=3), st.lists(st.floats(0.1, 1), min_size=6, max_size=6))
def test_parallel_boxes_share_the_product_of_their_overlaps(offset: list[float], sizes: list[float]) -> None:
    one, other = np.array(sizes[:3]), np.array(sizes[3:])
    shift = np.array(offset)
    low, high = np.maximum(-one / 2, shift - other / 2), np.minimum(one / 2, shift + other / 2)
    expected = np.prod(np.clip(high - low, 0, None))
    shared = intersection_volume(np.eye(4), one, transform_from(np.eye(3), shift), other)
    assert shared == pytest.approx(expected, rel=1e-8, abs=1e-9)


def test_boxes_that_only_touch_share_nothing_and_a_common_face_is_counted_once() -> None:
    unit = np.ones(3)
    beside = transform_from(np.eye(3), np.array([1.0, 0, 0]))
    assert intersection_volume(np.eye(4), unit, beside, unit) == pytest.approx(0.0, abs=1e-9)
    inner = transform_from(np.eye(3), np.array([0.25, 0, 0]))
    assert intersection_volume(np.eye(4), unit, inner, np.array([0.5, 1, 1])) == pytest.approx(0.5)


def test_a_box_has_twelve_edges_as_long_as_its_sizes() -> None:
    rng = np.random.default_rng(0)
    T, extents = random_box(rng)
    corners = box_corners(T, extents)
    lengths = sorted(float(np.linalg.norm(corners[i] - corners[j])) for i, j in EDGES)
    np.testing.assert_allclose(lengths, sorted(np.repeat(extents, 4)))


@given(seeds, st.floats(0, np.pi))
def test_rotation_error_is_the_angle_turned_by_unfolded(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    T = transform_from(random_rotation(rng), rng.normal(size=3))
    turned = T @ transform_from(rotation_about(rng.normal(size=3), angle), np.zeros(3))
    assert rotation_error(T, turned) == pytest.approx(angle, abs=1e-7)
    assert translation_error(T, turned) == pytest.approx(0.0, abs=1e-12)


def truth(visible_share: float | None = 1.0, name: str = "base") -> PartTruth:
    return PartTruth(name, np.eye(4), np.array([0.3, 0.4, 1.2]), visible_share)


def estimate(T: Array, name: str = "base") -> PartPose:
    return PartPose(name, T, truth().extents_m, np.zeros((3, 3)), np.zeros(3), 1.0, 1.0, 0.0, 0, 100, 0.0, np.eye(6))


def moved(distance_m: float, angle_deg: float = 0.0) -> Array:
    return transform_from(rotation_about(np.array([0, 0, 1.0]), np.radians(angle_deg)), np.array([distance_m, 0, 0]))


def errors_of(*parts: PartPose | NotSeen, visible_share: float | None = 1.0) -> list[PartError]:
    return [
        e for part in parts for e in part_errors(ONE_PART, ArticulatedPose((part,), (), {}), [truth(visible_share)])
    ]


def test_a_missing_part_is_a_failure_and_leaves_the_means_of_the_others_alone() -> None:
    figures = summarise(errors_of(estimate(moved(0.02, 3.0)), NotSeen("base", "hidden")), "base")
    assert figures["visible"] == 2
    assert figures["missing"] == 1
    assert figures["rotation_deg"]["mean"] == pytest.approx(3.0)
    assert figures["translation_m"]["median"] == pytest.approx(0.02)
    assert figures["translation_share"]["mean"] == pytest.approx(0.02 / 1.3)
    assert figures["failure_rate"] == 0.5
    assert figures["acc_5deg5cm"] == 0.5
    assert 0.4 < figures["iou"]["mean"] < 0.5


@pytest.mark.parametrize(
    ("T", "failed"), [(moved(0.64), False), (moved(0.66), True), (moved(0, 29.9), False), (moved(0, 30.1), True)]
)
def test_a_pose_fails_beyond_30_degrees_or_half_the_diagonal(T: Array, failed: bool) -> None:
    (error,) = errors_of(estimate(T))
    assert error.failed is failed


def test_a_part_that_can_hardly_be_seen_is_not_asked_for() -> None:
    assert errors_of(NotSeen("base", "hidden"), visible_share=0.09) == []
    assert len(errors_of(NotSeen("base", "hidden"), visible_share=0.1)) == 1
    assert len(errors_of(NotSeen("base", "hidden"), visible_share=None)) == 1


@pytest.mark.parametrize("errors", [[], errors_of(NotSeen("base", "hidden"))])
def test_figures_that_do_not_exist_are_null_and_never_nan(errors: list[PartError]) -> None:
    figures = summarise(errors, "base")
    assert set(figures["rotation_deg"].values()) == {None}
    assert {"mean", "median"} <= set(figures["rotation_deg"])
    json.dumps(figures, allow_nan=False)


def test_truth_of_other_parts_is_refused() -> None:
    with pytest.raises(ValueError, match="expected the parts base of the bundle, got lid"):
        part_errors(ONE_PART, ArticulatedPose((estimate(np.eye(4)),), (), {}), [truth(name="lid")])


@settings(deadline=None, max_examples=40)
@given(st.lists(st.tuples(st.floats(0.1, 1.0), st.floats(0.0, 3.0)), min_size=1, max_size=40))
def test_occlusion_levels_share_the_parts_out_between_them(parts: list[tuple[float, float]]) -> None:
    errors = [PartError("lid", angle, 0.01, 0.5, 0.3, visible) for visible, angle in parts]
    figures = summarise(errors, "lid")
    levels = figures["by_occlusion"]
    assert sum(level["visible"] for level in levels) == figures["visible"] == len(parts)
    for level in levels:
        low, high = level["occlusion"]
        own = [error for error in errors if low <= 1.0 - (error.visible_share or 0.0) < high]
        expected = summarise(own, "lid")
        assert level == {"occlusion": [low, high], **{name: expected[name] for name in level if name != "occlusion"}}


def test_parts_whose_visible_share_nobody_measured_are_of_no_occlusion_level() -> None:
    assert summarise([PartError("lid", 0.1, 0.01, 0.5, 0.3)], "lid")["by_occlusion"] == []
