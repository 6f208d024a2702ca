"""The figures of many comparisons, as `page-runtime validate` writes them.

Rotation, translation, keypoints and radii are over the visible parts that have a pose (radii: that the network gave
points); null where there are none. Everything else is over all visible parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from page_runtime.category import Category
from page_runtime.confidence import RIGHT_ROTATION_RAD, RIGHT_TRANSLATION_M
from page_runtime.evaluation import JointError, PartError
from page_runtime.pose import ArticulatedPose
from page_runtime.recorded import PartTruth
from page_runtime.validation.comparison import Comparison, compared
from page_runtime.validation.reliability import calibration_error, reliability
from page_runtime.validation.statistics import Resampling, distribution, share, share_interval

# Shares of a part that are hidden, itself and other things in front of it counted alike (the paper's Table VIII).
OCCLUSION_LEVELS = ((0.0, 0.4), (0.4, 0.8), (0.8, 1.0))
# METHOD of the paper's figures: see `paper_compatible`.
_FOLD_DEG, _CAP_DEG = 90.0, 50.0
PAPER_COMPATIBLE = (
    "as the paper's evaluation counts: rotations over 90 deg folded (180 - e), then capped at 50 deg, and a missing "
    "pose counted as an error of 0. For comparison with Tables I to V only: a random pose has 36 deg on this scale, "
    "127 on the true one. IoU stays exact, and so is not comparable with the paper's"
)


@dataclass(frozen=True, slots=True)
class _Seen:
    """A part's error, the frame it is of (its place in the resampling), and the error of its radii."""

    error: PartError
    frame: int
    radius_m: float | None


def figures_of(category: Category, found: Sequence[tuple[ArticulatedPose, Sequence[PartTruth]]]) -> dict[str, Any]:
    """Of estimates with their truths, without intervals: category, instances, parts, joints."""
    each = [compared(category, pose, truths, frame=index) for index, (pose, truths) in enumerate(found)]
    return category_figures(category, each, list(range(len(each))), None)


def category_figures(
    category: Category, comparisons: Sequence[Comparison], frames: Sequence[int], resampling: Resampling | None
) -> dict[str, Any]:
    """category, instances, parts and joints of one category. frames: of each comparison, its place in the resampling,
    without which there are no intervals."""
    seen = [
        _Seen(error, frame, one.radius_m.get(error.name))
        for one, frame in zip(comparisons, frames, strict=True)
        for error in one.parts
    ]
    joints = [(joint, frame) for one, frame in zip(comparisons, frames, strict=True) for joint in one.joints]
    return {
        "category": category.name,
        "instances": len(comparisons),
        "parts": [
            _part_figures(category, k, [s for s in seen if s.error.name == part.name], comparisons, resampling)
            for k, part in enumerate(category.parts)
        ],
        "joints": [_joint_figures(joints, joint.name, resampling) for joint in category.joints],
    }


def pooled_figures(
    comparisons: Sequence[Comparison], frames: Sequence[int], resampling: Resampling | None
) -> dict[str, Any]:
    """The figures of all visible parts together, whatever their name, and their segmentation."""
    seen = [
        _Seen(error, frame, one.radius_m.get(error.name))
        for one, frame in zip(comparisons, frames, strict=True)
        for error in one.parts
    ]
    return {**_figures(seen, resampling), "segmentation": segmentation_figures(comparisons)}


def summarise(errors: Sequence[PartError], name: str) -> dict[str, Any]:
    """The figures of part `name` without intervals, each error from a frame of its own."""
    own = [_Seen(error, index, None) for index, error in enumerate(errors) if error.name == name]
    return {"name": name, **_figures(own, None), "by_occlusion": _by_occlusion(own, None)}


def _part_figures(
    category: Category,
    index: int,
    own: Sequence[_Seen],
    comparisons: Sequence[Comparison],
    resampling: Resampling | None,
) -> dict[str, Any]:
    segmented = [one.segmentation for one in comparisons if one.segmentation is not None]
    points = sum(one.part_points[index] for one in segmented)
    return {
        "name": category.parts[index].name,
        "category": category.name,
        **_figures(own, resampling),
        "segmentation_accuracy": sum(one.part_right[index] for one in segmented) / points if points else None,
        "by_occlusion": _by_occlusion(own, resampling),
    }


def _by_occlusion(own: Sequence[_Seen], resampling: Resampling | None) -> list[dict[str, Any]]:
    """The figures of the parts hidden that much, for the levels there are parts of; none where nobody measured it."""
    hidden = [(1.0 - one.error.visible_share, one) for one in own if one.error.visible_share is not None]
    found = []
    for low, high in OCCLUSION_LEVELS:
        level = [one for share, one in hidden if low <= share and (share < high or high == 1.0)]
        if level:
            found.append({"occlusion": [low, high], **_figures(level, resampling)})
    return found


def _figures(own: Sequence[_Seen], resampling: Resampling | None) -> dict[str, Any]:
    errors = [one.error for one in own]

    def of(values: Sequence[tuple[float | None, int]]) -> dict[str, Any]:
        known = [(value, frame) for value, frame in values if value is not None]
        return distribution([value for value, _ in known], [frame for _, frame in known], resampling)

    def angle(error: PartError) -> float | None:
        return None if error.rotation_rad is None else float(np.degrees(error.rotation_rad))

    def relative(error: PartError) -> float | None:
        return None if error.translation_m is None else error.translation_m / error.diagonal_m

    shares = {
        "iou25": [error.iou >= 0.25 for error in errors],
        "iou50": [error.iou >= 0.50 for error in errors],
        "acc_5deg5cm": [error.within(np.radians(5.0), 0.05) for error in errors],
        "acc_10deg10cm": [error.within(np.radians(10.0), 0.10) for error in errors],
        "failure_rate": [error.failed for error in errors],
    }
    intervals = {"share_ci95": {name: share_interval(hits) for name, hits in shares.items()}} if resampling else {}
    return {
        "visible": len(own),
        "missing": sum(error.rotation_rad is None for error in errors),
        "rotation_deg": of([(angle(one.error), one.frame) for one in own]),
        "translation_m": of([(one.error.translation_m, one.frame) for one in own]),
        "translation_share": of([(relative(one.error), one.frame) for one in own]),
        "keypoint_m": of([(one.error.keypoint_m, one.frame) for one in own]),
        "radius_m": of([(one.radius_m, one.frame) for one in own]),
        "iou": of([(one.error.iou, one.frame) for one in own]),
        **{name: share(hits) for name, hits in shares.items()},
        **intervals,
    }


def _joint_figures(
    joints: Sequence[tuple[JointError, int]], name: str, resampling: Resampling | None
) -> dict[str, Any]:
    own = [(joint, frame) for joint, frame in joints if joint.name == name]
    unit = own[0][0].unit if own else "rad"
    times = 180.0 / np.pi if unit == "rad" else 1.0

    def of(values: Sequence[tuple[float | None, int]], times: float) -> dict[str, Any]:
        known = [(value, frame) for value, frame in values if value is not None]
        return distribution([value * times for value, _ in known], [frame for _, frame in known], resampling)

    return {
        "name": name,
        "visible": len(own),
        "missing": sum(joint.error is None for joint, _ in own),
        "unit": "deg" if unit == "rad" else "m",
        "error": of([(joint.error, frame) for joint, frame in own], times),
        "axis_deg": of([(joint.axis_rad, frame) for joint, frame in own], 180.0 / np.pi),
        "axis_offset_m": of([(joint.axis_offset_m, frame) for joint, frame in own], 1.0),
    }


def segmentation_figures(comparisons: Sequence[Comparison]) -> dict[str, Any]:
    """Shares of points with the right class (the paper's Table IV): of all points, background included, and of those
    that truly are on the object. Null where no recording has masks."""
    known = [one.segmentation for one in comparisons if one.segmentation is not None]
    points, on_object = sum(one.points for one in known), sum(sum(one.part_points) for one in known)
    return {
        "points": points,
        "accuracy": sum(one.right for one in known) / points if points else None,
        "accuracy_on_object": sum(sum(one.part_right) for one in known) / on_object if on_object else None,
    }


def confidence_figures(comparisons: Sequence[Comparison]) -> dict[str, Any]:
    """How well the confidence of parts with a pose says whether they are within 5 degrees and 5 cm."""
    posed = [part for one in comparisons for part in one.parts if part.confidence is not None]
    if not posed:
        return {"parts": 0, "right": None, "calibration_error": None, "bins": []}
    right = np.array([part.within(RIGHT_ROTATION_RAD, RIGHT_TRANSLATION_M) for part in posed])
    bins = reliability(np.array([part.confidence for part in posed], float), right)
    return {
        "parts": len(posed),
        "right": float(right.mean()),
        "calibration_error": calibration_error(bins),
        "bins": [asdict(one) for one in bins],
    }


def paper_compatible(category: Category, comparisons: Sequence[Comparison]) -> list[dict[str, Any]]:
    """Mean errors of each part by the rules of the paper's own evaluation (PAPER_COMPATIBLE)."""
    found = []
    for part in category.parts:
        own = [error for one in comparisons for error in one.parts if error.name == part.name]
        rotations = [folded_and_capped_deg(error.rotation_rad) for error in own]
        translations = [error.translation_m or 0.0 for error in own]
        found.append({
            "name": part.name,
            "category": category.name,
            "rotation_deg": float(np.mean(rotations)) if own else None,
            "translation_m": float(np.mean(translations)) if own else None,
        })  # fmt: skip
    return found


def folded_and_capped_deg(rotation_rad: float | None) -> float:
    """A rotation error as the paper's evaluation counts it; None, no pose, as 0."""
    if rotation_rad is None:
        return 0.0
    angle = float(np.degrees(rotation_rad))
    return min(180.0 - angle if angle > _FOLD_DEG else angle, _CAP_DEG)
