"""Poses refined on all radii at once: Gauss-Newton over rotation, translation and scale (METHOD 11).

The poses of all parts of a frame advance together: with 400 points and eight keypoints a numpy call costs as much as
its arithmetic. Shapes: P parts with n keypoints each and B poses each.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime import multilateration
from page_runtime.multilateration import UNUSABLE_RADIUS_M, Anchors, FloatArray, RadialSystem
from page_runtime.similarity import Similarities, skew


@dataclass(frozen=True, eq=False, slots=True)
class Evidence:
    """Everything a pose of one part is judged by. anchors: m points; radii_m (n, m); keypoints_unit (n, 3);
    extents_unit (3,); sides (m, v), tanh(logit / 2), or None where they do not apply; normal (3,) of a
    planar part, to the camera."""

    anchors: Anchors
    radii_m: FloatArray
    keypoints_unit: FloatArray
    extents_unit: FloatArray
    sides: FloatArray | None
    normal: FloatArray

    def thinned(self, count: int) -> "Evidence":
        """The same with at most `count` of the points."""
        chosen = multilateration.thinned(len(self.anchors.norm2), count)
        anchors = multilateration.anchors_from(self.anchors.relative[chosen] + self.anchors.origin)
        sides = None if self.sides is None else self.sides[chosen]
        return Evidence(anchors, self.radii_m[:, chosen], self.keypoints_unit, self.extents_unit, sides, self.normal)


@dataclass(frozen=True, eq=False, slots=True)
class StackedRadii:
    """What P parts are refined by: anchors, `stacked`; radii_m (P, n, m) m, UNUSABLE_RADIUS_M where a part has fewer
    points; keypoints_unit (P, n, 3)."""

    anchors: Anchors
    radii_m: FloatArray
    keypoints_unit: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class PoseSystem:
    """Normal equations of P B poses: hessian (P B, n, 7, 7) and gradient (P B, n, 7) for each keypoint, unscaled;
    radial: the sums over points they come from, (P, B n, ...)."""

    hessian: FloatArray
    gradient: FloatArray
    radial: RadialSystem


def stacked_radii(parts: Sequence[Evidence]) -> StackedRadii:
    """Of P parts with as many keypoints."""
    anchors = multilateration.stacked([part.anchors for part in parts])
    radii_m = np.full((len(parts), len(parts[0].radii_m), anchors.norm2.shape[-1]), UNUSABLE_RADIUS_M)
    for row, part in zip(radii_m, parts, strict=True):
        row[:, : part.radii_m.shape[1]] = part.radii_m
    return StackedRadii(anchors, radii_m, np.stack([part.keypoints_unit for part in parts]))


def refined(poses: Sequence[Similarities], parts: Sequence[Evidence], gates: tuple[float, ...]) -> list[Similarities]:
    """Each part's poses after an iteration for each gate, in units of the pose's scale; each keypoint is weighted by
    the scale of its own residuals."""
    if not parts:
        return []
    stack, most = stacked_radii(parts), max(map(len, poses))
    # Parts with fewer poses repeat the last.
    rows = [one.take(np.minimum(np.arange(most), len(one) - 1)) for one in poses]
    current = Similarities(*(np.concatenate([getattr(row, name) for row in rows]) for name in ("R", "t", "s")))
    scales_m: NDArray[np.float64] | None = None
    for round_, gate in enumerate(gates):
        # The scale moves little and its sort costs as much as the rest of an iteration.
        system = pose_system(current, stack, scales_m if round_ % 2 else None, gate)
        scales_m = system.radial.scales
        precision = (1.0 / scales_m**2).reshape(len(current), -1, 1)
        step = multilateration.damped_step(
            (system.hessian * precision[..., None]).sum(axis=1), (system.gradient * precision).sum(axis=1), limit=0.3
        )
        step[:, 6] = np.clip(step[:, 6], -0.5, 0.5)
        current = current.moved(-step)
    return [current.take(most * part + np.arange(len(one))) for part, one in enumerate(poses)]


def pose_system(poses: Similarities, stack: StackedRadii, scales_m: FloatArray | None, gate: float) -> PoseSystem:
    """Of P B poses, those of a part one after the other; scales_m: (P, B n, 1) m, or by the residuals within the gate.

    d e_ij = u_ij . (omega x a_j + dt + a_j dlog s) = u_ij . B_j step, so the points enter by sum w u u^T
    alone.
    """
    num_parts, num_keypoints = stack.radii_m.shape[:2]
    each = len(poses) // num_parts
    arms = poses.arms(np.repeat(stack.keypoints_unit, each, axis=0))
    place = (arms + poses.t[:, None]).reshape(num_parts, -1, 3) - stack.anchors.origin
    size_m = np.repeat(poses.s, num_keypoints).reshape(num_parts, -1, 1)
    radii_m = np.tile(stack.radii_m, (1, each, 1))
    radial = multilateration.radial_system(place, stack.anchors, radii_m, scales_m, gate * size_m, 1e-4 * size_m)
    jacobian = np.empty((len(poses), num_keypoints, 3, 7))
    jacobian[..., :3] = -skew(arms)
    jacobian[..., 3:6] = np.eye(3)
    jacobian[..., 6] = arms
    transposed = jacobian.transpose(0, 1, 3, 2)
    hessian = transposed @ radial.hessian.reshape(len(poses), num_keypoints, 3, 3) @ jacobian
    gradient = (transposed @ radial.gradient.reshape(len(poses), num_keypoints, 3, 1))[..., 0]
    return PoseSystem(hessian, gradient, radial)
