"""One estimate against its truth: rotation, translation, exact box IoU, keypoints, joint states and axes.

Rotation errors are geodesic angles, neither folded nor capped. What is counted:

- Parts whose truth says that less than VISIBLE_SHARE of them can be seen are left out (a truth without a visible share
  counts as visible).
- A pose that is not finite counts as missing.
- A missing pose has IoU 0 and is a failure; it has no rotation, translation or keypoint error.
- Of the true poses that look the same (`equivalents`) the one nearest to the estimate is the truth.
- A failure is a missing pose, or one worse than FAILURE_ROTATION_RAD or FAILURE_SHARE of the part's true diagonal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime.boxes import box_iou
from page_runtime.category import Category, Joint, Part
from page_runtime.equivalents import is_visible, nearest_truths
from page_runtime.geometry import Array, apply, rotation_angle
from page_runtime.pose import ArticulatedPose, NotSeen, PartPose
from page_runtime.recorded import PartTruth

FAILURE_ROTATION_RAD = float(np.radians(30.0))
FAILURE_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class PartError:
    """One visible part of one object in one frame.

    rotation_rad, translation_m: None when it has no pose. iou: of the boxes, 0 when it has no pose. diagonal_m: of the
    true box. visible_share: as the truth has it. keypoint_m: mean distance of its keypoints from their true places,
    None when it has no pose. confidence: of the pose, None when there is none. reason: why there is none.
    """

    name: str
    rotation_rad: float | None
    translation_m: float | None
    iou: float
    diagonal_m: float
    visible_share: float | None = None
    keypoint_m: float | None = None
    confidence: float | None = None
    reason: str = ""

    @property
    def failed(self) -> bool:
        """No pose, or one that is of no use (see the module)."""
        return not self.within(FAILURE_ROTATION_RAD, FAILURE_SHARE * self.diagonal_m)

    def within(self, rotation_rad: float, translation_m: float) -> bool:
        """Whether the pose is at most this far from the truth; never when there is none."""
        if self.rotation_rad is None or self.translation_m is None:
            return False
        return self.rotation_rad <= rotation_rad and self.translation_m <= translation_m


def rotation_error(T_camera_estimate: Array, T_camera_truth: Array) -> float:
    """Geodesic angle between two poses' rotations, rad in [0, pi]."""
    return float(rotation_angle(T_camera_estimate[:3, :3], T_camera_truth[:3, :3]))


def translation_error(T_camera_estimate: Array, T_camera_truth: Array) -> float:
    """Distance between two poses' origins, m."""
    return float(np.linalg.norm(T_camera_estimate[:3, 3] - T_camera_truth[:3, 3]))


def true_keypoints(part: Part, truth: PartTruth) -> Array:
    """(n,3) where the part's keypoints truly are, camera frame: the category's, at the size of this instance."""
    return apply(truth.T_camera_part, float(np.linalg.norm(truth.extents_m)) * part.keypoints_unit)


def part_errors(category: Category, pose: ArticulatedPose, truths: Sequence[PartTruth]) -> tuple[PartError, ...]:
    """The error of every visible part; pose and truths name the same parts in any order, else ValueError."""
    estimates = {part.name: part for part in pose.parts}
    if estimates.keys() != {truth.name for truth in truths} or len(estimates) != len(truths):
        raise ValueError(
            f"truth: expected the parts {', '.join(estimates)} of the bundle, got {', '.join(t.name for t in truths)}"
        )
    known = {part.name: part for part in category.parts}
    nearest = nearest_truths(category, pose, truths)
    return tuple(_part_error(known[truth.name], estimates[truth.name], truth) for truth in nearest if is_visible(truth))


def _part_error(part: Part, estimate: PartPose | NotSeen, truth: PartTruth) -> PartError:
    diagonal_m = float(np.linalg.norm(truth.extents_m))
    if isinstance(estimate, NotSeen):
        return PartError(truth.name, None, None, 0.0, diagonal_m, truth.visible_share, reason=estimate.reason)
    if not (np.isfinite(estimate.T_camera_part).all() and np.isfinite(estimate.extents_m).all()):
        reason = "the pose is not finite"
        return PartError(truth.name, None, None, 0.0, diagonal_m, truth.visible_share, reason=reason)
    apart = np.linalg.norm(estimate.keypoints_camera - true_keypoints(part, truth), axis=1)
    return PartError(
        name=truth.name,
        rotation_rad=rotation_error(estimate.T_camera_part, truth.T_camera_part),
        translation_m=translation_error(estimate.T_camera_part, truth.T_camera_part),
        iou=box_iou(estimate.T_camera_part, estimate.extents_m, truth.T_camera_part, truth.extents_m),
        diagonal_m=diagonal_m,
        visible_share=truth.visible_share,
        keypoint_m=float(apart.mean()),
        confidence=float(estimate.confidence),
    )


@dataclass(frozen=True, slots=True)
class JointError:
    """One joint of one object both of whose parts are visible.

    error: rad or m, of the state's size; None when the estimate has no state. axis_rad: angle between
    the true and the estimated axis, None where the parent has no pose or the joint is free. axis_offset_m: distance of
    the estimated pivot from the true axis of a revolute joint, both where the category has them on the parent; None
    where it does not say.
    """

    name: str
    unit: str
    error: float | None
    axis_rad: float | None = None
    axis_offset_m: float | None = None


def joint_errors(category: Category, pose: ArticulatedPose, truths: Sequence[PartTruth]) -> tuple[JointError, ...]:
    """The error of every joint whose parts are visible and whose true state is known."""
    truth_of = {truth.name: truth for truth in nearest_truths(category, pose, truths)}
    estimate_of = {part.name: part for part in pose.parts if isinstance(part, PartPose)}
    found = []
    for joint, state in zip(category.joints, pose.joints, strict=True):
        parent, child = (truth_of[category.parts[k].name] for k in (joint.parent, joint.child))
        if child.joint_state is None or not (is_visible(parent) and is_visible(child)):
            continue
        error = None if state.value is None else abs(state.value - child.joint_state)
        if error is not None and joint.kind == "revolute":
            error = abs((error + np.pi) % (2.0 * np.pi) - np.pi)
        axis_rad, offset_m = _axis_errors(joint, estimate_of.get(parent.name), parent)
        found.append(JointError(joint.name, state.unit, None if error is None else float(error), axis_rad, offset_m))
    return tuple(found)


def _axis_errors(joint: Joint, estimate: PartPose | None, truth: PartTruth) -> tuple[float | None, float | None]:
    """Angle [rad] between the axes, and distance [m] of the estimated pivot from the true axis; estimate, truth: of the
    joint's parent."""
    if estimate is None or joint.kind == "free":
        return None, None
    axis = np.array(joint.axis)
    found, true = estimate.T_camera_part[:3, :3] @ axis, truth.T_camera_part[:3, :3] @ axis
    angle = float(np.arctan2(np.linalg.norm(np.cross(found, true)), found @ true))
    if joint.kind != "revolute" or joint.geometry is None:
        return angle, None
    pivot = np.array(joint.geometry.pivot_parent)
    between = apply(estimate.T_camera_part, pivot * estimate.extents_m) - apply(
        truth.T_camera_part, pivot * truth.extents_m
    )
    return angle, float(np.linalg.norm(np.cross(between, true)))
