"""Robust multilateration: a position from its distances to known points.

Two users. `scoring` needs start positions whose vote count bounds its search from below, and the sub-voxel
position of a peak; `registration` needs an estimate of every keypoint of a part, and the sums over points
that are the normal equations of a part's pose. Both are batched over rows, one row for each (keypoint,
hypothesis), because at 500 points the cost of a numpy call exceeds the cost of its arithmetic. `stacked` anchors of
several parts do all of it for all parts at once.

Shapes: m points, H rows, n keypoints; all may follow one axis of P parts, that of the anchors. Lengths in metres,
positions in the frame of the points (here always the camera's).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# 1.4826 turns the median of |e| into a Gaussian sigma. Of scales of 2.5, 3.5 and 5 sigma, 3.5 was best or
# second best on independent and correlated radius errors alike; 2.5 cost some 5 %.
_SIGMAS = 3.5
# Stands for a radius that must not count: finite, so that its vanishing weight times its residual is no NaN.
UNUSABLE_RADIUS_M = 1e6

_L1_ROUNDS = 3
_QUADRATIC = np.array([[4, 5, 6], [5, 7, 8], [6, 8, 9]])
_PLANAR = np.array([0, 1, 3])


@dataclass(frozen=True, eq=False, slots=True)
class Anchors:
    """Points to which distances are known, with the products that every normal equation sums.

    origin: (3,) m, their mean, subtracted because the sums below cancel badly far from the origin.
    relative: (m, 3) m, points - origin. norm2: (m,) m^2. features: (m, 10), 1 x y z xx xy xz yy yz zz.
    """

    origin: FloatArray
    relative: FloatArray
    norm2: FloatArray
    features: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class RadialSystem:
    """Weighted normal equations of `H` positions, each from its own radii.

    hessian: (H, 3, 3), sum_i w u u^T with u the unit vector from point i to the position. gradient: (H, 3)
    m, sum_i w e u. residuals: (H, m) m, e = |x - p| - r. weights: (H, m), w = (1 + (e/c)^2)^-2 with c the
    scales: (H, 1) m, of Geman-McClure.
    """

    hessian: FloatArray
    gradient: FloatArray
    residuals: FloatArray
    weights: FloatArray
    scales: FloatArray


def anchors_from(points: NDArray[np.floating]) -> Anchors:
    """Precompute the sums of (m, 3) finite points in metres."""
    points = np.asarray(points, np.float64)
    origin = points.mean(axis=0)
    relative = points - origin
    x, y, z = relative.T
    squares = (x * x, x * y, x * z, y * y, y * z, z * z)
    features = np.stack((np.ones_like(x), x, y, z, *squares), axis=1)
    return Anchors(origin, relative, squares[0] + squares[3] + squares[5], features)


def stacked(parts: Sequence[Anchors]) -> Anchors:
    """One of P parts, each array with a first axis (P, ...). Points that fill a part up to the most are at its origin;
    their radii must be UNUSABLE_RADIUS_M.
    """
    most = max(len(part.norm2) for part in parts)

    def filled(arrays: Sequence[FloatArray]) -> FloatArray:
        result = np.zeros((len(arrays), most, *arrays[0].shape[1:]))
        for row, array in zip(result, arrays, strict=True):
            row[: len(array)] = array
        return result

    return Anchors(
        np.stack([part.origin for part in parts])[:, None],
        filled([part.relative for part in parts]),
        filled([part.norm2 for part in parts])[:, None],
        filled([part.features for part in parts]),
    )


def thinned(count: int, limit: int) -> NDArray[np.intp]:
    """Indices of at most `limit` of `count` rows, evenly spread, the same at every call."""
    if count <= limit:
        return np.arange(count)
    return np.linspace(0, count - 1, limit).astype(np.intp)


def distances(positions: FloatArray, anchors: Anchors) -> FloatArray:
    """(H, m) m, from (H, 3) positions given relative to the anchors' origin to every anchor."""
    squared = positions @ (-2.0 * anchors.relative.mT)
    squared += anchors.norm2
    squared += np.einsum("...hk,...hk->...h", positions, positions)[..., None]
    # A millionth of a metre keeps the unit vectors finite where a position meets a point.
    np.maximum(squared, 1e-12, out=squared)
    return np.sqrt(squared, out=squared)


def gated_scales(residuals: FloatArray, gate_m: float | FloatArray, floor_m: float | FloatArray) -> FloatArray:
    """(H, 1) m, the Geman-McClure scale: 3.5 sigma by the median of |e| among the residuals within the gate, of all
    or (H, 1).

    The gate keeps the median honest above 50 % outliers, where that of all residuals is an outlier itself.
    """
    magnitudes = np.abs(residuals).astype(np.float32)
    magnitudes.sort(axis=-1)
    within = np.count_nonzero(magnitudes <= gate_m, axis=-1)[..., None]
    median = np.take_along_axis(magnitudes, np.maximum(within - 1, 0) // 2, axis=-1).astype(np.float64)
    scales = np.where(within > 0, _SIGMAS * 1.4826 * median, gate_m)
    return np.minimum(np.maximum(scales, floor_m), np.maximum(gate_m, floor_m))


def radial_system(
    positions: FloatArray,
    anchors: Anchors,
    radii_m: FloatArray,
    scales_m: FloatArray | None,
    gate_m: float | FloatArray,
    floor_m: float | FloatArray,
) -> RadialSystem:
    """Normal equations of sum_i rho(|x - p_i| - r_i), rho Geman-McClure at scales_m (H, 1), or at the gated
    scales.

    positions: (H, 3) m relative to the anchors' origin. radii_m: (H, m).
    """
    distance = distances(positions, anchors)
    residuals = distance - radii_m
    if scales_m is None:
        scales_m = gated_scales(residuals, gate_m, floor_m)
    ratio = residuals * (1.0 / scales_m)
    ratio *= ratio
    ratio += 1.0
    ratio *= ratio
    weights = np.reciprocal(ratio, out=ratio)
    pull = weights / distance
    first = (pull * residuals) @ anchors.features[..., :4]
    pull /= distance
    sums = pull @ anchors.features
    cross = positions[..., :, None] * sums[..., None, 1:4]
    outer = positions[..., :, None] * (positions * sums[..., :1])[..., None, :]
    hessian = outer - cross - cross.mT + sums[..., _QUADRATIC]
    gradient = positions * first[..., :1] - first[..., 1:]
    return RadialSystem(hessian, gradient, residuals, weights, scales_m)


def refine_positions(
    positions: FloatArray, anchors: Anchors, radii_m: FloatArray, schedule_m: Sequence[float]
) -> FloatArray:
    """Gauss-Newton on the Geman-McClure cost, one iteration at each scale of a schedule that anneals.

    positions: (H, 3) m in the frame of the points; radii_m: (H, m) m. Returns (H, 3) m; finite for finite
    input.
    """
    current = positions - anchors.origin
    for scale_m in schedule_m:
        scales_m = np.full((*current.shape[:-1], 1), scale_m)
        system = radial_system(current, anchors, radii_m, scales_m, scale_m, scale_m)
        current = current - damped_step(system.hessian, system.gradient, limit=0.25)
    return current + anchors.origin


def settle_positions(
    positions: FloatArray, anchors: Anchors, radii_m: FloatArray, gate_m: float, floor_m: float
) -> FloatArray:
    """As `refine_positions` from close by, at the scale that the residuals within the gate have themselves; four steps,
    each at most a third of the gate: voters too few or too alike leave directions in which nothing else holds it."""
    current = positions - anchors.origin
    scales_m = None
    for round_ in range(4):
        # The scale moves little and its sort costs as much as the rest of an iteration.
        system = radial_system(current, anchors, radii_m, scales_m if round_ % 2 else None, gate_m, floor_m)
        scales_m = system.scales
        current = current - damped_step(system.hessian, system.gradient, limit=gate_m / 3)
    return current + anchors.origin


def damped_step(hessian: FloatArray, gradient: FloatArray, *, limit: float) -> FloatArray:
    """(H, d): H^-1 g with a trace of damping, its first three components together no longer than `limit`."""
    size = hessian.shape[-1]
    trace = hessian.trace(axis1=-2, axis2=-1)[..., None, None]
    damped = hessian + (1e-6 / size * trace + 1e-12) * np.eye(size)
    step = np.linalg.solve(damped, gradient[..., None])[..., 0]
    length = np.sqrt(np.einsum("...hk,...hk->...h", step[..., :3], step[..., :3]))[..., None]
    return step * np.minimum(1.0, limit / np.maximum(length, 1e-12))


def principal_axes(relative: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (3,) m, largest first, and axes (3, 3) in columns, of centred points (m, 3)."""
    variances, axes = np.linalg.eigh(relative.mT @ relative / max(relative.shape[-2], 1))
    return np.sqrt(np.maximum(variances[..., ::-1], 0.0)), np.ascontiguousarray(axes[..., ::-1])


def linear_hypotheses(anchors: Anchors, radii_m: FloatArray) -> FloatArray:
    """Start positions from r^2 = |p|^2 - 2 p.x + |x|^2, linear in (x, |x|^2).

    radii_m: (n, m) m, UNUSABLE_RADIUS_M where unknown. Returns (n, 3, 3) m in the frame of the points: for
    each keypoint the two mirror images about the points' principal plane, then the plain linear solution. A
    planar part leaves the sign of the height open (METHOD 12), and both must be tried; |x|^2 then gives its
    size. The residuals are weighted towards the least absolute sum: squares would follow the outliers.
    """
    _, axes = principal_axes(anchors.relative)
    local = anchors.relative @ axes
    features = np.concatenate((local, np.ones((*local.shape[:-1], 1))), axis=-1)
    products = (features[..., :, None] * features[..., None, :]).reshape(*local.shape[:-1], 16)
    usable = radii_m < UNUSABLE_RADIUS_M
    radii_m = np.where(usable, radii_m, 0.0)
    targets = radii_m * radii_m - anchors.norm2
    # Unusable radii are zeros here and come first, so this is the median of the others.
    middle_at = radii_m.shape[-1] - 1 - np.count_nonzero(usable, axis=-1)[..., None] // 2
    middle = np.take_along_axis(np.sort(radii_m, axis=-1), middle_at, axis=-1)
    middle = np.maximum(middle, 1e-3)
    # e = (f.theta - t) / 2r is the radius error; a floor under r, as tiny radii would take all the weight.
    precision = usable / np.maximum(radii_m, 0.5 * middle)
    spread2 = np.einsum("...mk,...mk->...", local, local)[..., None, None, None] / local.shape[-2]
    ridge = np.eye(4) * (1e-9 * (1.0 + spread2))
    weights = precision * precision
    rows = radii_m.shape[:-1]
    matrix = np.empty((*rows, 4, 4))
    vector = np.empty((*rows, 4, 1))
    solution = np.zeros((*rows, 4, 1))
    for _ in range(_L1_ROUNDS):
        matrix = (weights @ products).reshape(*rows, 4, 4)
        matrix += ridge * (matrix[..., 3:, 3:] + 1e-12)
        vector = ((weights * targets) @ features)[..., None]
        solution = np.linalg.solve(matrix, vector)
        errors = 0.5 * precision * np.abs(solution[..., 0] @ features.mT - targets)
        weights = precision * precision / (errors + 0.01 * middle)
    planar = np.linalg.solve(matrix[..., _PLANAR[:, None], _PLANAR], vector[..., _PLANAR, :])[..., 0]
    in_plane = -0.5 * planar[..., :2]
    height2 = planar[..., 2] - np.einsum("...nk,...nk->...n", in_plane, in_plane)
    height = np.sqrt(np.maximum(height2, (0.05 * middle[..., 0]) ** 2))
    starts = np.empty((*rows, 3, 3))
    starts[..., :2, :2] = in_plane[..., None, :]
    starts[..., 0, 2], starts[..., 1, 2] = height, -height
    starts[..., 2, :] = -0.5 * solution[..., :3, 0]
    starts = starts.reshape(*rows[:-1], -1, 3) @ axes.mT + anchors.origin
    return starts.reshape(*rows, 3, 3)
