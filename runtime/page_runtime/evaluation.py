"""Estimates against truth: rotation, translation, exact box IoU, and how often it failed.

Rotation errors are geodesic angles, neither folded nor capped. What is counted:

- Parts whose truth says that less than VISIBLE_SHARE of them can be seen are left out (a truth without a visible share
  counts as visible).
- Rotation and translation mean and median are over the visible parts that have a pose; null when there are none.
- Everything else is over all visible parts, a missing pose counting as IoU 0, as no hit and as a failure.
- Of the true poses that look the same (`symmetry`) the one nearest to the estimate is the truth.
- A failure is a missing pose, or one worse than FAILURE_ROTATION_RAD or FAILURE_SHARE of the part's true diagonal.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from page_runtime.boxes import box_iou
from page_runtime.category import Category
from page_runtime.geometry import Array, rotation_angle, transform_from
from page_runtime.pose import ArticulatedPose, NotSeen, PartPose
from page_runtime.recorded import PartTruth
from page_runtime.symmetry import nearest_turn, turn_of

VISIBLE_SHARE = 0.1
FAILURE_ROTATION_RAD = float(np.radians(30.0))
FAILURE_SHARE = 0.5
# Shares of a part that are hidden, itself and other things in front of it counted alike (the paper's Table VIII).
OCCLUSION_LEVELS = ((0.0, 0.4), (0.4, 0.8), (0.8, 1.0))


@dataclass(frozen=True, slots=True)
class PartError:
    """One visible part of one object in one frame. rotation_rad, translation_m: None when it has no pose. iou: of the
    boxes, 0 when it has no pose. diagonal_m: of the true box. visible_share: as the truth has it."""

    name: str
    rotation_rad: float | None
    translation_m: float | None
    iou: float
    diagonal_m: float
    visible_share: float | None = None

    @property
    def failed(self) -> bool:
        """No pose, or one that is of no use (see the module)."""
        return not self.within(FAILURE_ROTATION_RAD, FAILURE_SHARE * self.diagonal_m)

    def within(self, rotation_rad: float, translation_m: float) -> bool:
        """Whether the pose is at most this far from the truth; never when there is none."""
        if self.rotation_rad is None or self.translation_m is None:
            return False
        return self.rotation_rad <= rotation_rad and self.translation_m <= translation_m


def is_visible(truth: PartTruth) -> bool:
    """Whether the part is seen enough to be asked for."""
    return truth.visible_share is None or truth.visible_share >= VISIBLE_SHARE


def rotation_error(T_camera_estimate: Array, T_camera_truth: Array) -> float:
    """Geodesic angle between two poses' rotations, rad in [0, pi]."""
    return float(rotation_angle(T_camera_estimate[:3, :3], T_camera_truth[:3, :3]))


def translation_error(T_camera_estimate: Array, T_camera_truth: Array) -> float:
    """Distance between two poses' origins, m."""
    return float(np.linalg.norm(T_camera_estimate[:3, 3] - T_camera_truth[:3, 3]))


def part_errors(category: Category, pose: ArticulatedPose, truths: Sequence[PartTruth]) -> tuple[PartError, ...]:
    """The error of every visible part; pose and truths name the same parts in any order, else ValueError."""
    estimates = {part.name: part for part in pose.parts}
    if estimates.keys() != {truth.name for truth in truths} or len(estimates) != len(truths):
        raise ValueError(
            f"truth: expected the parts {', '.join(estimates)} of the bundle, got {', '.join(t.name for t in truths)}"
        )
    nearest = nearest_truths(category, pose, truths)
    return tuple(_part_error(estimates[truth.name], truth) for truth in nearest if is_visible(truth))


def nearest_truths(category: Category, pose: ArticulatedPose, truths: Sequence[PartTruth]) -> tuple[PartTruth, ...]:
    """Of the descriptions of the true object that look the same the one whose rotations are nearest to the estimate's,
    joint states included, in the order of `truths`."""
    if category.interchange is None and not any(part.symmetry for part in category.parts):
        return tuple(truths)
    estimates = {part.name: part for part in pose.parts if isinstance(part, PartPose)}
    true = {truth.name: truth for truth in truths}
    described = [true] if category.interchange is None else [true, _interchanged(category, true)]
    turned = [_turned(category, one, estimates) for one in described]
    best = min(turned, key=lambda one: sum(
        rotation_error(estimates[name].T_camera_part, truth.T_camera_part)
        for name, truth in one.items() if name in estimates and is_visible(truth)
    ))  # fmt: skip
    return tuple(best[truth.name] for truth in truths)


def _interchanged(category: Category, truths: dict[str, PartTruth]) -> dict[str, PartTruth]:
    """The same object with its parts renamed."""
    assert category.interchange is not None
    turn = transform_from(category.interchange.turn, np.zeros(3))
    states = {
        category.joints[own].child: truths[category.parts[category.joints[other].child].name].joint_state
        for own, other in enumerate(category.interchanged_joints)
    }
    renamed = {}
    for k, part in enumerate(category.parts):
        other = truths[category.parts[category.interchange.parts[k]].name]
        T_camera_part = other.T_camera_part @ turn
        renamed[part.name] = replace(other, name=part.name, T_camera_part=T_camera_part, joint_state=states.get(k))
    return renamed


def _turned(category: Category, truths: dict[str, PartTruth], estimates: dict[str, PartPose]) -> dict[str, PartTruth]:
    """Symmetric parts turned towards the estimate, and the states of the joints about whose axes they were."""
    turned = dict(truths)
    for k, part in enumerate(category.parts):
        if part.symmetry is None or part.name not in estimates:
            continue
        truth, T_estimate = turned[part.name], estimates[part.name].T_camera_part
        angle = nearest_turn(part.symmetry, truth.T_camera_part[:3, :3].T @ T_estimate[:3, :3])
        T = truth.T_camera_part @ transform_from(turn_of(part.symmetry, angle), np.zeros(3))
        turned[part.name] = replace(truth, T_camera_part=T)
        for joint in category.joints:
            along = float(np.dot(part.symmetry.axis, joint.axis))
            if joint.kind != "revolute" or k not in (joint.parent, joint.child) or abs(along) < 1.0 - 1e-6:
                continue
            child = category.parts[joint.child].name
            state = turned[child].joint_state
            if state is not None:
                sense = 1.0 if k == joint.child else -1.0
                turned[child] = replace(turned[child], joint_state=state + sense * along * angle)
    return turned


def _part_error(estimate: PartPose | NotSeen, truth: PartTruth) -> PartError:
    diagonal_m = float(np.linalg.norm(truth.extents_m))
    if isinstance(estimate, NotSeen):
        return PartError(truth.name, None, None, 0.0, diagonal_m, truth.visible_share)
    return PartError(
        name=truth.name,
        rotation_rad=rotation_error(estimate.T_camera_part, truth.T_camera_part),
        translation_m=translation_error(estimate.T_camera_part, truth.T_camera_part),
        iou=box_iou(estimate.T_camera_part, estimate.extents_m, truth.T_camera_part, truth.extents_m),
        diagonal_m=diagonal_m,
        visible_share=truth.visible_share,
    )


@dataclass(frozen=True, slots=True)
class JointError:
    """One joint of one object both of whose parts are visible. error: rad or m, of the state's size; None when the
    estimate has no state."""

    name: str
    unit: str
    error: float | None


def joint_errors(category: Category, pose: ArticulatedPose, truths: Sequence[PartTruth]) -> tuple[JointError, ...]:
    """The error of every joint whose parts are visible and whose true state is known."""
    truth_of = {truth.name: truth for truth in nearest_truths(category, pose, truths)}
    found = []
    for joint, state in zip(category.joints, pose.joints, strict=True):
        parent, child = (truth_of[category.parts[k].name] for k in (joint.parent, joint.child))
        if child.joint_state is None or not (is_visible(parent) and is_visible(child)):
            continue
        error = None if state.value is None else abs(state.value - child.joint_state)
        if error is not None and joint.kind == "revolute":
            error = abs((error + np.pi) % (2.0 * np.pi) - np.pi)
        found.append(JointError(joint.name, state.unit, error))
    return tuple(found)


def summarise_joint(errors: Iterable[JointError], name: str) -> dict[str, Any]:
    """The figures of joint `name` as `page-runtime validate` writes them; angles in degrees."""
    own = [error for error in errors if error.name == name]
    unit = own[0].unit if own else "rad"
    known = [error.error for error in own if error.error is not None]
    degrees = unit == "rad"
    return {
        "name": name,
        "visible": len(own),
        "missing": len(own) - len(known),
        "unit": "deg" if degrees else "m",
        "error": _mean_median([float(np.degrees(e)) if degrees else float(e) for e in known]),
    }


def figures_of(category: Category, compared: Sequence[tuple[ArticulatedPose, Sequence[PartTruth]]]) -> dict[str, Any]:
    """Of estimates with their truths, as `page-runtime validate` writes them: category, instances, parts, joints."""
    errors = [error for pose, truths in compared for error in part_errors(category, pose, truths)]
    joints = [error for pose, truths in compared for error in joint_errors(category, pose, truths)]
    return {
        "category": category.name,
        "instances": len(compared),
        "parts": [summarise(errors, part.name) for part in category.parts],
        "joints": [summarise_joint(joints, joint.name) for joint in category.joints],
    }


def summarise(errors: Iterable[PartError], name: str) -> dict[str, Any]:
    """The figures of part `name` as `page-runtime validate` writes them; the module says what counts."""
    own = [error for error in errors if error.name == name]
    return {"name": name, **_figures(own), "by_occlusion": _by_occlusion(own)}


def _by_occlusion(own: Sequence[PartError]) -> list[dict[str, Any]]:
    """The figures of the parts hidden that much, for the levels there are parts of; none where nobody measured it."""
    hidden = [(1.0 - error.visible_share, error) for error in own if error.visible_share is not None]
    found = []
    for low, high in OCCLUSION_LEVELS:
        level = [error for share, error in hidden if low <= share and (share < high or high == 1.0)]
        if level:
            found.append({"occlusion": [low, high], **_figures(level)})
    return found


def _figures(own: Sequence[PartError]) -> dict[str, Any]:
    posed = [error for error in own if error.rotation_rad is not None]
    rotations = [float(np.degrees(error.rotation_rad)) for error in posed if error.rotation_rad is not None]
    translations = [error.translation_m for error in posed if error.translation_m is not None]
    shares = [error.translation_m / error.diagonal_m for error in posed if error.translation_m is not None]
    ious = [error.iou for error in own]
    return {
        "visible": len(own),
        "missing": len(own) - len(posed),
        "rotation_deg": _mean_median(rotations),
        "translation_m": _mean_median(translations),
        "translation_share": _mean_median(shares),
        "iou": _mean_median(ious),
        "iou25": _share([iou >= 0.25 for iou in ious]),
        "iou50": _share([iou >= 0.50 for iou in ious]),
        "acc_5deg5cm": _share([error.within(np.radians(5.0), 0.05) for error in own]),
        "acc_10deg10cm": _share([error.within(np.radians(10.0), 0.10) for error in own]),
        "failure_rate": _share([error.failed for error in own]),
    }


def _mean_median(values: list[float]) -> dict[str, float | None]:
    if not values:
        return {"mean": None, "median": None}
    return {"mean": float(np.mean(values)), "median": float(np.median(values))}


def _share(hits: list[bool]) -> float | None:
    return float(np.mean(hits)) if hits else None
