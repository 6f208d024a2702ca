"""From the parts one by one to the object: what the joints allow, and the state of each joint (METHOD 15).

Radii know each part's pose with a covariance. Joints know more: two parts on a hinge share its direction and its
place. The most probable poses under both are found by Gauss-Newton over all parts at once, each part with seven
degrees of freedom as in `registration`. A part well seen thereby helps its neighbour along the directions in which
the neighbour's own radii say little, and errors do not grow along a chain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.category import Category, Joint
from page_runtime.geometry import Array, transform_from
from page_runtime.joints import Residual, joint_residual, joint_state, opposed, pair_columns, zero_variance
from page_runtime.pose import JointState
from page_runtime.similarity import FloatArray, Similarities, inverse_left_jacobian, so3_log

# Root mean square of a joint's residuals, or excess of its state over a limit, in standard deviations, above which
# its parts contradict each other.
CONTRADICTION = 3.5
_LIMIT_SIGMA = {"revolute": 0.01, "prismatic": 0.002, "free": 1.0}
_ROUNDS = 5
_SIZE = 7


@dataclass(frozen=True, eq=False, slots=True)
class PartEvidence:
    """What is known of one part. T_camera_part (4,4); scale_m its diagonal; covariance (7,7) of (rotation vector about
    the part's origin in camera axes [rad], m, log scale), as honest as can be (`uncertainty`); extents_unit (3,) its
    box in diagonals."""

    T_camera_part: Array
    scale_m: float
    covariance: Array
    extents_unit: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Articulation:
    """parts: the evidence made consistent, None where there was none. joints: of the
    category, in its order."""

    parts: tuple[PartEvidence | None, ...]
    joints: tuple[JointState, ...]


@dataclass(frozen=True, eq=False, slots=True)
class _Object:
    """The K seen parts. row_of: their rows by index in the category. start: their own poses; information (7K,7K)."""

    row_of: dict[int, int]
    start: Similarities
    information: FloatArray
    extents_unit: FloatArray

    def rows(self, joint: Joint) -> list[int]:
        return [self.row_of[joint.parent], self.row_of[joint.child]]

    def columns(self, joint: Joint) -> NDArray[np.intp]:
        """(14,) columns of the two parts' steps."""
        return pair_columns(self.rows(joint))

    def residual(self, joint: Joint, poses: Similarities) -> Residual:
        rows = self.rows(joint)
        return joint_residual(joint, poses.take(np.array(rows)), self.extents_unit[rows])

    def state(self, joint: Joint, poses: Similarities) -> tuple[float, FloatArray]:
        rows = self.rows(joint)
        return joint_state(joint, poses.take(np.array(rows)), self.extents_unit[rows])

    def zero_variance(self, joint: Joint) -> float:
        return zero_variance(joint, self.start.take(np.array(self.rows(joint))))


def articulate(category: Category, parts: Sequence[PartEvidence | None]) -> Articulation:
    """Poses of all parts that the joints allow, and the joints' states.

    parts: in the category's order, None for one without a pose. A joint one of whose parts is missing, or whose parts
    contradict each other or its limits, changes nothing and says why. A state a little beyond its limits draws the
    parts back, as far as the limit is surer than their poses, and is told as the limit. Raises ValueError for another
    number of parts than the category's.
    """
    if len(parts) != len(category.parts):
        raise ValueError(f"parts: expected {len(category.parts)}, as the category has, got {len(parts)}")
    seen = [(k, part) for k, part in enumerate(parts) if part is not None]
    if not seen:
        states = tuple(_unknown(joint, _missing(joint, category, ())) for joint in category.joints)
        return Articulation(tuple(parts), states)
    whole = _object([k for k, _ in seen], [part for _, part in seen])
    missing = {joint.name: _missing(joint, category, list(whole.row_of)) for joint in category.joints}
    pairs = {
        joint.name: (_given(parts[joint.parent]), _given(parts[joint.child]))
        for joint in category.joints
        if not missing[joint.name] and joint.kind != "free"
    }
    judged = [joint for joint in category.joints if joint.name in pairs]
    apart = {
        name: max(joint_disagreement(joint, *pairs[name])[0], limit_excess(joint, *pairs[name]))
        for name, joint in ((joint.name, joint) for joint in judged)
    }
    reasons = missing | {
        joint.name: _contradiction(joint, category) for joint in judged if not apart[joint.name] <= CONTRADICTION
    }
    coupling = [joint for joint in judged if not reasons[joint.name]]
    held: dict[str, float] = {}
    while True:
        poses, covariance = _solved(whole, coupling, held)
        states_now = {joint.name: whole.state(joint, poses)[0] for joint in coupling}
        outside = [joint for joint in coupling if joint.name not in held and _beyond(joint, states_now[joint.name])]
        if not outside:
            break
        # One that is held may push another out.
        held |= {joint.name: _nearest_limit(joint, states_now[joint.name]) for joint in outside}
    consistent: list[PartEvidence | None] = list(parts)
    for k, row in whole.row_of.items():
        own = slice(_SIZE * row, _SIZE * (row + 1))
        consistent[k] = PartEvidence(
            T_camera_part=transform_from(poses.R[row], poses.t[row]),
            scale_m=float(poses.s[row]),
            covariance=covariance[own, own],
            extents_unit=whole.extents_unit[row],
        )
    states = []
    for joint in category.joints:
        state = _unknown(joint, reasons[joint.name])
        if not state.reason:
            value, derivative = whole.state(joint, poses)
            columns = whole.columns(joint)
            moving = derivative @ covariance[np.ix_(columns, columns)] @ derivative
            zero = whole.zero_variance(joint)
            if joint.kind != "free":
                value = float(np.clip(value, *joint.limits))
            state = replace(state, value=value, sigma=float(np.sqrt(moving + zero)), zero_sigma=float(np.sqrt(zero)))
        states.append(replace(state, disagreement=apart.get(joint.name)))
    return Articulation(tuple(consistent), tuple(states))


def joint_disagreement(joint: Joint, parent: PartEvidence, child: PartEvidence) -> tuple[float, int]:
    """How far two parts' own poses are from what their joint allows: root mean square in standard deviations of both
    covariances and the joint's own, infinite where they see its axis in opposite directions; and of how many
    numbers."""
    pair = _similarities((parent, child))
    residual = joint_residual(joint, pair, np.array([parent.extents_unit, child.extents_unit]))
    number = len(residual.value)
    if opposed(joint, pair):
        return float("inf"), number
    by_parent, by_child = residual.jacobian[:, :_SIZE], residual.jacobian[:, _SIZE:]
    spread = by_parent @ parent.covariance @ by_parent.T + by_child @ child.covariance @ by_child.T + np.eye(number)
    return float(np.sqrt(residual.value @ np.linalg.solve(spread, residual.value) / number)), number


def limit_excess(joint: Joint, parent: PartEvidence, child: PartEvidence) -> float:
    """How far the state of two parts' own poses lies beyond the joint's limits, in standard deviations of both
    covariances, of the joint's zero and of what a limit is sure to; 0 within them."""
    pair = _similarities((parent, child))
    value, derivative = joint_state(joint, pair, np.array([parent.extents_unit, child.extents_unit]))
    if not _beyond(joint, value):
        return 0.0
    by_parent, by_child = derivative[:_SIZE], derivative[_SIZE:]
    variance = by_parent @ parent.covariance @ by_parent + by_child @ child.covariance @ by_child
    variance += zero_variance(joint, pair) + _LIMIT_SIGMA[joint.kind] ** 2
    return abs(value - _nearest_limit(joint, value)) / float(np.sqrt(variance))


def _given(part: PartEvidence | None) -> PartEvidence:
    assert part is not None
    return part


def _similarities(parts: Sequence[PartEvidence]) -> Similarities:
    transforms = np.array([part.T_camera_part for part in parts], np.float64)
    return Similarities(transforms[:, :3, :3], transforms[:, :3, 3], np.array([part.scale_m for part in parts]))


def _object(indices: Sequence[int], parts: Sequence[PartEvidence]) -> _Object:
    information = np.zeros((_SIZE * len(parts), _SIZE * len(parts)))
    for row, part in enumerate(parts):
        own = slice(_SIZE * row, _SIZE * (row + 1))
        information[own, own] = np.linalg.inv(part.covariance)
    extents = np.array([part.extents_unit for part in parts])
    return _Object({k: row for row, k in enumerate(indices)}, _similarities(parts), information, extents)


def unknown_reason(joint: Joint, category: Category, seen: Sequence[int]) -> str:
    """Why a joint has no state, where the parts with these indices have poses."""
    return _missing(joint, category, seen) or _contradiction(joint, category)


def _missing(joint: Joint, category: Category, seen: Sequence[int]) -> str:
    """Which of the joint's parts have no pose, or nothing."""
    names = [category.parts[k].name for k in (joint.parent, joint.child) if k not in seen]
    return f"no pose of {' and '.join(names)}" if names else ""


def _contradiction(joint: Joint, category: Category) -> str:
    parent, child = category.parts[joint.parent].name, category.parts[joint.child].name
    return f"the poses of {parent} and {child} contradict each other: no state within the joint's limits explains both"


def _solved(
    whole: _Object, joints: Sequence[Joint], held: Mapping[str, float]
) -> tuple[Similarities, NDArray[np.float64]]:
    """Most probable poses under radii and joints, those of `held` at their limit; and the covariance (7K,7K) of their
    steps."""
    poses, hessian = whole.start, whole.information
    limited = [
        (joint, 1.0 / np.sqrt(whole.zero_variance(joint) + _LIMIT_SIGMA[joint.kind] ** 2))
        for joint in joints
        if joint.name in held
    ]
    for _ in range(_ROUNDS if joints else 0):
        offset, by_step = _offset(poses, whole.start)
        hessian = by_step.T @ whole.information @ by_step
        gradient = by_step.T @ whole.information @ offset
        for joint in joints:
            whole.residual(joint, poses).add_to(hessian, gradient, whole.columns(joint))
        for joint, surety in limited:
            (value, derivative), columns = whole.state(joint, poses), whole.columns(joint)
            derivative = derivative * surety
            hessian[np.ix_(columns, columns)] += np.outer(derivative, derivative)
            gradient[columns] += derivative * ((value - held[joint.name]) * surety)
        steps = np.asarray(np.linalg.solve(hessian, gradient), np.float64)
        poses = poses.moved(-steps.reshape(-1, _SIZE))
    return poses, np.asarray(np.linalg.inv(hessian), np.float64)


def _offset(poses: Similarities, start: Similarities) -> tuple[FloatArray, FloatArray]:
    """(7K,) the step that leads from `start` to `poses`, and its derivative (7K,7K) by a further step."""
    turns = so3_log(poses.R @ start.R.transpose(0, 2, 1))
    offset = np.concatenate([turns, poses.t - start.t, np.log(poses.s / start.s)[:, None]], axis=1)
    by_step = np.eye(offset.size)
    for row, turn in enumerate(turns):
        own = slice(_SIZE * row, _SIZE * row + 3)
        by_step[own, own] = inverse_left_jacobian(turn)
    return offset.reshape(-1), by_step


def _beyond(joint: Joint, value: float) -> bool:
    return not joint.limits[0] <= value <= joint.limits[1]


def _nearest_limit(joint: Joint, value: float) -> float:
    return min(joint.limits, key=lambda limit: abs(value - limit))


def _unknown(joint: Joint, reason: str) -> JointState:
    return JointState(joint.name, joint.kind, None, None, joint.limits, reason)
