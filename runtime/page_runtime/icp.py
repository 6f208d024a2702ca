"""Fitting a part's visible points to its category's template, held by what the radii say (METHOD 11).

Plain ICP to a template whose proportions are 5 % off makes good poses worse, and on plates and cylinders it slides
along the symmetry (SCORING 4). Here the pose from the radii is a prior with a covariance, the proportions of the
template are three more unknowns with a prior of their own, and the least of

    sum_i rho(n_i . (p_i - x_i)) / sigma^2 + sum_i rho(overshoot_i) / sigma^2 + |step|^2_prior + |stretch|^2_prior

is sought: rho of Geman and McClure, x_i and n_i the template's sample nearest to point p_i and its normal, the
overshoot how far a point stands out of the template's box sideways. So the points move the pose only along what the
radii leave open, and a face that is not where the template has it is put down to whichever is less certain, the pose or
the proportions. Points do not say where a plate is in its own plane; that none may lie beyond its rim does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime import multilateration
from page_runtime.geometry import require_rigid, transform_from
from page_runtime.multilateration import FloatArray
from page_runtime.similarity import Similarities
from page_runtime.surface_pairs import Pairs, Placed, paired
from page_runtime.template import Template

_MIN_POINTS = 16
SENSOR_SIGMA_M = 0.002
# Points in each round: more to know where it starts and to settle than to get there. 400 in each were no better.
ROUNDS = (256, 160, 160, 160, 160, 160, 256)

# Depth noise, the template's details and the network's cut of the part err over whole faces, so that 400 points are
# evidence of far fewer. On 780 parts from the shipped bundles 20 to 40 was best; from 100 on, poses went beyond the
# prior or got worse.
_INDEPENDENT = 40.0
# What a template's proportions are off by: in diagonals, the same for a thickness and a length, because that is how
# size heads and instances were found to err.
_STRETCH = 0.02
# But as a share of a thickness no more than this, or a lid grows as thick as fits it.
_MOST_STRETCH = 0.2

# Pairs further apart than this, in diagonals, are not of one surface.
_GATE = 0.1
_TRIM = 0.75
# The 99 % quantile of chi-square with the ten degrees of freedom of pose, scale and stretch.
_PLAUSIBLE = 23.2
# Above this many sigmas of the sensor and this share of the diagonal, what remains is another shape.
_FIT_SIGMAS = 3.0
_FIT_UNIT = 0.01


@dataclass(frozen=True, eq=False, slots=True)
class IcpResult:
    """What became of a pose. T_camera_part: (4,4) rigid, scale_m, extents_m (3,) full sizes of the stretched template's
    box, and covariance, of the shape it was given in: the refined ones if `accepted`, else those that went in.

    residual_before_m, residual_after_m: root mean square distance to the template from the nearest _TRIM of the points
    within the gate, before and at the last step, inf where there was nothing to compare. reason: a sentence, empty if
    accepted.
    """

    T_camera_part: FloatArray
    scale_m: float
    extents_m: FloatArray
    covariance: FloatArray
    accepted: bool
    residual_before_m: float
    residual_after_m: float
    reason: str


def refine_to_template(
    points_camera: NDArray[np.floating],
    T_camera_part: NDArray[np.floating],
    scale_m: float,
    covariance: NDArray[np.floating],
    template: Template,
    *,
    extents_unit: NDArray[np.floating] | None = None,
    sensor_sigma_m: float = SENSOR_SIGMA_M,
    rounds: Sequence[int] = ROUNDS,
) -> IcpResult:
    """Refine the pose of one part by its visible points and the template of that part.

    points_camera: (N,3) m, seen from the origin; T_camera_part, scale_m: the pose and diagonal that the radii gave;
    covariance: (7,7) of `Registration`, or (6,6) when the scale is known, and honest: see `uncertainty`;
    extents_unit: (3,) proportions of the part's box, to which the template is stretched first, if they are known
    better than the template's own; sensor_sigma_m: depth noise; rounds: points in each.

    Each round pairs the points with the samples that face the camera and takes a Gauss-Newton step over rotation,
    translation, log scale and three log stretches. The result is accepted only if the points then fit better, the
    change is plausible under the priors and what remains is no more than noise and detail explain. Points that are not
    finite do not count. Raises ValueError for wrong shapes and a pose that is not rigid.
    """
    points, given, surface = _checked(points_camera, covariance, template, extents_unit, scale_m, sensor_sigma_m)
    T_prior = np.asarray(require_rigid(T_camera_part, name="T_camera_part"), np.float64)

    def kept(reason: str, before_m: float = np.inf, after_m: float = np.inf) -> IcpResult:
        extents_m = scale_m * surface.extents_unit
        return IcpResult(T_prior, float(scale_m), extents_m, given, False, before_m, after_m, reason)

    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < _MIN_POINTS:
        return kept(f"{len(points)} finite points, {_MIN_POINTS} are needed")
    information = _prior_information(given, surface)
    if information is None:
        return kept("the covariance of the pose is not positive definite")

    prior = Similarities(T_prior[None, :3, :3], T_prior[None, :3, 3], np.array([float(scale_m)]))
    unknowns, placed, before_m = np.zeros(10), Placed(prior, np.zeros(3)), np.inf
    posterior = information
    gate_m = _GATE * scale_m
    for round_, count in enumerate(rounds):
        chosen = points[multilateration.thinned(len(points), count)]
        pairs = paired(chosen, placed, surface, gate_m)
        if pairs is None or len(pairs.residuals) < _MIN_POINTS:
            return kept(f"under {_MIN_POINTS} points are near a side of the template that faces the camera", before_m)
        before_m = _trimmed_rms(pairs) if round_ == 0 else before_m
        hessian, gradient = normal_equations(pairs, placed, gate_m, sensor_sigma_m)
        posterior = hessian + information
        step = np.linalg.solve(posterior, gradient + information @ unknowns)
        unknowns = unknowns - step
        # Rotation vectors add up to second order in the angle; the prior keeps it to some degrees.
        placed = Placed(prior.moved(unknowns[None, :7]), unknowns[7:])
    pairs = paired(points[multilateration.thinned(len(points), rounds[0])], placed, surface, gate_m)
    after_m = np.inf if pairs is None or len(pairs.residuals) < _MIN_POINTS else _trimmed_rms(pairs)

    if not after_m < before_m:
        return kept(
            f"the points fit no better: {1e3 * after_m:.2f} mm, {1e3 * before_m:.2f} mm before", before_m, after_m
        )
    surprise = float(unknowns @ information @ unknowns)
    if not surprise <= _PLAUSIBLE:
        reason = f"the change is implausible under the radii: chi-square {surprise:.1f}, expected <= {_PLAUSIBLE}"
        return kept(reason, before_m, after_m)
    fit_m = fit_limit_m(scale_m, sensor_sigma_m)
    if after_m > fit_m:
        reason = f"the template is of another shape: {1e3 * after_m:.1f} mm remain, expected <= {1e3 * fit_m:.1f} mm"
        return kept(reason, before_m, after_m)
    pose, size = placed.pose, len(given)
    return IcpResult(
        T_camera_part=np.asarray(transform_from(pose.R[0], pose.t[0]), np.float64),
        scale_m=float(pose.s[0]),
        extents_m=placed.size_m * surface.extents_unit,
        covariance=np.asarray(np.linalg.inv(posterior)[:size, :size], np.float64),
        accepted=True,
        residual_before_m=before_m,
        residual_after_m=after_m,
        reason="",
    )


def fit_limit_m(scale_m: float, sensor_sigma_m: float = SENSOR_SIGMA_M) -> float:
    """Points of a part of this diagonal that are farther than this from its template, root mean square over those that
    `IcpResult` counts, are of another shape."""
    return max(_FIT_SIGMAS * sensor_sigma_m, _FIT_UNIT * scale_m)


def _checked(
    points_camera: NDArray[np.floating],
    covariance: NDArray[np.floating],
    template: Template,
    extents_unit: NDArray[np.floating] | None,
    scale_m: float,
    sensor_sigma_m: float,
) -> tuple[FloatArray, FloatArray, Template]:
    points, given = np.asarray(points_camera, np.float64), np.asarray(covariance, np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points_camera: expected (N, 3) metres, got {points.shape}; pass one part's points as rows")
    if given.shape not in ((7, 7), (6, 6)):
        raise ValueError(
            f"covariance: expected (7, 7) of rotation, translation and log scale, or (6, 6), got {given.shape}; "
            "pass that of the registration"
        )
    if not 0.0 < scale_m < np.inf:
        raise ValueError(f"scale_m: expected a positive diagonal in metres, got {scale_m}; pass the registration's")
    if not 0.0 < sensor_sigma_m < np.inf:
        raise ValueError(f"sensor_sigma_m: expected positive metres, got {sensor_sigma_m}; 0.002 suits most cameras")
    return points, given, template if extents_unit is None else template.stretched(extents_unit)


def _prior_information(covariance: FloatArray, surface: Template) -> FloatArray | None:
    """(10,10) inverse covariance of pose, log scale and log stretches; None if there is none."""
    size = len(covariance)
    if not np.isfinite(covariance).all() or np.linalg.eigvalsh(covariance)[0] <= 0.0:
        return None
    information = np.zeros((10, 10))
    # A scale that is known, for a covariance without one.
    information[6, 6] = 1e12
    information[:size, :size] = np.linalg.inv(covariance)
    information[range(7, 10), range(7, 10)] = np.maximum(surface.extents_unit / _STRETCH, 1.0 / _MOST_STRETCH) ** 2
    return information


def _trimmed_rms(pairs: Pairs) -> float:
    """Root mean square, m, of the least _TRIM of the points' distances to the template."""
    squares = pairs.residuals**2
    np.add.at(squares, pairs.overshooting, pairs.overshoot**2)
    count = max(int(_TRIM * len(squares)), 1)
    return float(np.sqrt(np.partition(squares, count - 1)[:count].mean()))


def normal_equations(
    pairs: Pairs, placed: Placed, gate_m: float, sensor_sigma_m: float
) -> tuple[FloatArray, FloatArray]:
    """(10,10) and (10,) of both residuals, rotation and translation in camera axes.

    With y the point and n the plane's normal seen from the part's origin, f = y - e n the point's foot in the plane:
    de = -(y x n) . omega - n . dt - (n . f) dlog s - sum_k n_k f_k dstretch_k.
    """
    count, rows = len(pairs.residuals), pairs.overshooting
    y = np.concatenate((pairs.points, pairs.points[rows]))
    n = np.concatenate((pairs.normals, np.zeros((len(rows), 3))))
    n[np.arange(count, len(n)), pairs.axis] = np.sign(pairs.overshoot)
    e = np.concatenate((pairs.residuals, np.abs(pairs.overshoot)))
    jacobian = np.empty((len(e), 10))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        jacobian[:, i] = n[:, j] * y[:, k] - n[:, k] * y[:, j]
    jacobian[:, 3:6] = -n
    jacobian[:, 7:] = n * (e[:, None] * n - y)
    jacobian[:, 6] = np.einsum("nk,nk->n", n, e[:, None] * n - y)
    turned = placed.pose.R[0].T
    jacobian[:, :3] = jacobian[:, :3] @ turned
    jacobian[:, 3:6] = jacobian[:, 3:6] @ turned
    scale_m = multilateration.gated_scales(pairs.residuals[None], gate_m, 3.5 * sensor_sigma_m)[0, 0]
    weights = 1.0 / (1.0 + (e / scale_m) ** 2) ** 2
    weights *= min(1.0, _INDEPENDENT / count) * (3.5 / scale_m) ** 2
    weighted = jacobian.T * weights
    return weighted @ jacobian, weighted @ e
