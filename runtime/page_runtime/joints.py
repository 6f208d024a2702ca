"""One joint between two parts: how far their poses are from what it allows, and its state.

Poses are similarities (`similarity`); steps are seven numbers a part: rotation vector about the part's origin in
camera axes [rad], translation [m], log scale. Every function takes the two parts' poses as a batch of two, parent
first, and gives derivatives by the fourteen numbers of both steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.category import Joint
from page_runtime.similarity import FloatArray, Similarities, inverse_left_jacobian, skew, so3_log

# Play of a joint, and what an axis learned from many instances differs from this one's.
AXIS_SIGMA_RAD = 0.006
_UNKNOWN_PIVOT = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Residual:
    """value (m,), each number in its standard deviations; jacobian (m, 14)."""

    value: FloatArray
    jacobian: FloatArray

    def add_to(self, hessian: FloatArray, gradient: FloatArray, columns: NDArray[np.intp]) -> None:
        """Add its share to the normal equations of many parts, of which `columns` (14,) are its two parts' steps."""
        hessian[np.ix_(columns, columns)] += self.jacobian.T @ self.jacobian
        gradient[columns] += self.jacobian.T @ self.value


def pair_columns(rows: Sequence[int]) -> NDArray[np.intp]:
    """(14,) columns of two parts' steps in the normal equations of many, by their rows."""
    return (np.array(rows)[:, None] * 7 + np.arange(7)).reshape(-1)


def joint_residual(joint: Joint, pair: Similarities, extents_unit: FloatArray) -> Residual:
    """How far two parts are from what their joint allows: direction, place and relative size.

    extents_unit: (2,3), the parts' boxes in their diagonals. Nothing, (0,) and (0,14), for a free joint.
    """
    if joint.kind == "free":
        return Residual(np.zeros(0), np.zeros((0, 14)))
    terms = [_turn(joint, pair)]
    if joint.geometry is not None:
        terms += [_place(joint, pair, extents_unit), _size(joint, pair)]
    return Residual(np.concatenate([t.value for t in terms]), np.concatenate([t.jacobian for t in terms]))


def opposed(joint: Joint, pair: Similarities) -> bool:
    """Whether the two parts see the axis of a revolute joint in opposite directions: no small turn mends that."""
    axes = pair.R @ np.array(joint.axis)
    return joint.kind == "revolute" and bool(axes[0] @ axes[1] <= 0.0)


def joint_state(joint: Joint, pair: Similarities, extents_unit: FloatArray) -> tuple[float, FloatArray]:
    """The state and its derivative (14,): an angle [rad], of all its turns the one nearest the middle of the limits,
    or a displacement [m] along the axis; for a free joint the angle between the parts."""
    axis = pair.R[0] @ np.array(joint.axis)
    derivative = np.zeros(14)
    if joint.kind == "prismatic":
        gap, by_step = _gap(joint, pair, extents_unit)
        derivative[:] = axis @ by_step
        derivative[:3] += np.cross(axis, gap)
        return float(axis @ gap), derivative
    turn = pair.R[0].T @ pair.R[1]
    if joint.kind == "free":
        vector = so3_log(turn[None])[0]
        angle = float(np.linalg.norm(vector))
        direction = pair.R[0] @ (vector / max(angle, 1e-12))
        derivative[:3], derivative[7:10] = -direction, direction
        return angle, derivative
    angle = turned_about(np.array(joint.axis) / np.linalg.norm(joint.axis), turn)
    middle = 0.5 * (joint.limits[0] + joint.limits[1])
    derivative[:3], derivative[7:10] = -axis, axis
    return middle + float(np.remainder(angle - middle + np.pi, 2.0 * np.pi)) - np.pi, derivative


def zero_variance(joint: Joint, pair: Similarities) -> float:
    """m^2: how uncertain a slide's zero is, which lies elsewhere on every object; 0 for joints that turn.

    The same in every frame of an object, so no covariance of its parts' poses holds it.
    """
    if joint.kind != "prismatic" or joint.geometry is None:
        return 0.0
    along = np.array([joint.geometry.sigma_parent, joint.geometry.sigma_child]) * np.array(joint.axis)
    return float(np.square(pair.s[:, None] * along).sum())


def turned_about(axis: FloatArray, R: FloatArray) -> float:
    """The angle, rad in (-pi, pi], of the turn about a unit axis (3,) that is nearest to a rotation R (3,3)."""
    twice_sine = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(axis @ twice_sine, np.trace(R) - axis @ R @ axis))


def _turn(joint: Joint, pair: Similarities) -> Residual:
    """Parts of a revolute joint share its axis, those of a prismatic one every direction."""
    jacobian = np.zeros((3, 14))
    if joint.kind == "revolute":
        parent, child = pair.R @ np.array(joint.axis)
        by_parent, by_child = skew(parent), skew(child)
        jacobian[:, :3], jacobian[:, 7:10] = by_child @ by_parent, -by_parent @ by_child
        return Residual(by_parent @ child / AXIS_SIGMA_RAD, jacobian / AXIS_SIGMA_RAD)
    turn = so3_log((pair.R[1] @ pair.R[0].T)[None])[0]
    left = inverse_left_jacobian(turn)
    # A step of the parent enters from the right, by the inverse right Jacobian: the left one transposed.
    jacobian[:, :3], jacobian[:, 7:10] = -left.T, left
    return Residual(turn / AXIS_SIGMA_RAD, jacobian / AXIS_SIGMA_RAD)


def _gap(joint: Joint, pair: Similarities, extents_unit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) m from the joint's point seen from the parent to the same seen from the child, camera axes; (3,14)."""
    geometry = joint.geometry
    pivots = (_UNKNOWN_PIVOT, _UNKNOWN_PIVOT) if geometry is None else (geometry.pivot_parent, geometry.pivot_child)
    arms = pair.s[:, None] * (pair.R @ (np.array(pivots) * extents_unit)[:, :, None])[:, :, 0]
    jacobian = np.zeros((3, 14))
    for at, sign, arm in ((0, -1.0, arms[0]), (7, 1.0, arms[1])):
        jacobian[:, at : at + 3] = -sign * skew(arm)
        jacobian[:, at + 3 : at + 6] = sign * np.eye(3)
        jacobian[:, at + 6] = sign * arm
    places = pair.t + arms
    return places[1] - places[0], jacobian


def _place(joint: Joint, pair: Similarities, extents_unit: FloatArray) -> Residual:
    """The joint's point is the same seen from either part; on a prismatic joint, across its axis."""
    geometry = joint.geometry
    assert geometry is not None
    gap, jacobian = _gap(joint, pair, extents_unit)
    scaled = pair.R * (pair.s[:, None] * np.array([geometry.sigma_parent, geometry.sigma_child]))[:, None, :]
    spread = (scaled @ scaled.transpose(0, 2, 1)).sum(axis=0)
    if joint.kind == "prismatic":
        # The axis turns with the parent, and what lies across it with the axis.
        jacobian[:, :3] += skew(gap)
        across = np.linalg.svd(np.array(joint.axis)[None])[2][1:] @ pair.R[0].T
        whitening = np.linalg.inv(np.linalg.cholesky(across @ spread @ across.T)) @ across
    else:
        whitening = np.linalg.inv(np.linalg.cholesky(spread))
    return Residual(whitening @ gap, whitening @ jacobian)


def _size(joint: Joint, pair: Similarities) -> Residual:
    """The parts' diagonals are in the category's proportion."""
    geometry = joint.geometry
    assert geometry is not None
    jacobian = np.zeros((1, 14))
    jacobian[0, 6], jacobian[0, 13] = -1.0, 1.0
    ratio = np.log(pair.s[1] / pair.s[0]) - geometry.log_size_ratio
    return Residual(np.array([ratio]) / geometry.log_size_sigma, jacobian / geometry.log_size_sigma)
