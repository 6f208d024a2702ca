"""From the votes and radii of one part to its pose and scale (PAGE Sec. III-E; METHOD 10, 11, 12).

Keypoints are given in units of the part's diagonal: x_camera = s R kappa + t with s the diagonal in metres,
so a pose has seven degrees of freedom. Three keypoints give a pose in closed form, but three points have no
handedness: where a part is planar their mirror image fits as well. Hence poses of several triples and modes
are compared on all N n radii, on the part's box and, where the part is planar, on the learned side of the
keypoints; the few best are refined on all radii at once, which uses every vote again and yields a
covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime import multilateration
from page_runtime.geometry import transform_from
from page_runtime.hypotheses import candidates, modes_of
from page_runtime.multilateration import UNUSABLE_RADIUS_M, FloatArray
from page_runtime.pose_refinement import Evidence, pose_system, refined, stacked_radii
from page_runtime.pose_support import SUPPORT_GATE, distinct_best, ranked_by_support, support_of
from page_runtime.scoring import MAX_RANGE_M, KeypointVotes
from page_runtime.similarity import Similarities

# A runner-up with this share of the best pose's support is not told apart from it: the share at which scoring
# still calls a mode a rival.
AMBIGUOUS_RATIO = 0.95

_POSE_POINTS = 400
_CANDIDATE_POINTS = 112
# Lengths in units of the part's diagonal.
_COARSE_GATES = (SUPPORT_GATE, 0.12, 0.08, 0.08)
_FINE_GATES = (0.08, 0.08, 0.08)
# From the last frame's pose: what an object does in a tenth of a second.
_NEAR_GATES = (0.12, 0.08, 0.08, 0.08)
# Smallest over middle standard deviation of the points, below which the principal normal is the surface's.
_PLANAR = 0.2


@dataclass(frozen=True, eq=False, slots=True)
class Registration:
    """Pose of a part. T_camera_part: (4, 4) rigid; scale_m: diagonal s, so x_camera = s R kappa + t.

    covariance: (7, 7) of (rotation vector about the part's origin in camera axes, rad; t, m; log s), from
    the normal equations under independent radius errors, so optimistic where a network's errors are
    correlated. residual_m: sigma of the radii by weighted root mean square; inlier_share: radii within 3.5
    sigma; runner_up_ratio: support of the second distinct pose over that of this one, 1 =
    indistinguishable, 0 = none. keypoints_camera: (n, 3) m, of the pose.
    """

    T_camera_part: FloatArray
    scale_m: float
    covariance: FloatArray
    residual_m: float
    inlier_share: float
    runner_up_ratio: float
    keypoints_camera: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Ambiguous:
    """Two poses between which neither radii, box nor sides decide, the better supported first. The object's joints
    may."""

    poses: tuple[Registration, Registration]
    reason: str


@dataclass(frozen=True, eq=False, slots=True)
class Observed:
    """What is known of one part before its pose.

    points_camera: (N, 3) m; radii_m: (N, n) m, to all n keypoints, n >= 3; keypoints_unit: (n, 3), in the
    part's canonical frame in units of its diagonal; votes: of the first len(votes) keypoints, from
    `score_parts`; extents_unit: (3,), the part's box about the canonical origin, in diagonals;
    scale_range_m: diagonals that the category's parts can have, with what margin is wanted; side_logits:
    (N, len(votes)), > 0 where keypoint j lies on the camera's side of the surface at point i, used where
    the points are nearly planar; diagonal_m: what the network takes its size for, if it says so.
    """

    points_camera: NDArray[np.floating]
    radii_m: NDArray[np.floating]
    keypoints_unit: NDArray[np.floating]
    votes: tuple[KeypointVotes, ...]
    extents_unit: NDArray[np.floating]
    scale_range_m: tuple[float, float]
    side_logits: NDArray[np.floating] | None = None
    diagonal_m: float | None = None


def register_part(observed: Observed) -> Registration | Ambiguous | str:
    """`register_parts` of one."""
    return register_parts([observed])[0]


def register_parts(parts: Sequence[Observed]) -> list[Registration | Ambiguous | str]:
    """Pose and scale of each part, or two that are as good as each other, or the reason why there is none.

    1. Modes of each keypoint: the peaks of its votes and the robust multilateration of its radii from both
       mirror starts. A keypoint without votes, or whose votes have no peak, thus has modes as well.
    2. Poses by Umeyama of the combinations of modes of a few keypoint triples; those whose scale or
       triangle is wrong are dropped.
    3. Support of a pose: mean Geman-McClure inlier mass of all its radii x share of the points in the
       part's box x agreement of the sides. The best distinct poses are refined by Gauss-Newton over
       rotation, translation and log scale on all radii, and the best supported is returned.

    A runner-up with over AMBIGUOUS_RATIO of its support makes the answer ambiguous. Points and radii that are not
    finite do not count. Raises ValueError for wrong shapes, or parts with different numbers of keypoints.
    """
    checked = [_evidence(one) for one in parts]
    if len({len(one.keypoints_unit) for one in parts}) > 1:
        raise ValueError(
            f"parts: expected as many keypoints of each, got {[len(one.keypoints_unit) for one in parts]}; "
            "register parts with other numbers by themselves"
        )
    results: list[Registration | Ambiguous | str] = [one if isinstance(one, str) else "" for one in checked]
    tried = [
        _Attempt(index, one, one.thinned(_CANDIDATE_POINTS), part.scale_range_m)
        for index, (one, part) in enumerate(zip(checked, parts, strict=True))
        if isinstance(one, Evidence)
    ]
    votes = [parts[attempt.index].votes for attempt in tried]
    modes = modes_of([attempt.sketch for attempt in tried], votes, [attempt.scale_range_m[0] for attempt in tried])
    started: list[_Attempt] = []
    starts: list[Similarities] = []
    for attempt, own_modes, own_votes in zip(tried, modes, votes, strict=True):
        kappa, (low, high) = attempt.evidence.keypoints_unit, attempt.scale_range_m
        poses = candidates(kappa, own_modes, len(own_votes), attempt.scale_range_m)
        if len(poses):
            started.append(attempt)
            starts.append(poses.take(distinct_best(poses, support_of(poses, attempt.sketch), kappa)))
        else:
            results[attempt.index] = (
                f"no combination of keypoint modes forms the part's triangle at a scale of {low:.3g} to {high:.3g} m"
            )
    coarse = refined(starts, [attempt.sketch for attempt in started], _COARSE_GATES)
    ranked = [ranked_by_support(poses, attempt.evidence) for poses, attempt in zip(coarse, started, strict=True)]
    # The runner-up is refined only where it is as good.
    kept = [poses.take(np.arange(1 if ratio <= AMBIGUOUS_RATIO else 2)) for poses, ratio in ranked]
    evidence = [attempt.evidence for attempt in started]
    fine = refined(kept, evidence, _FINE_GATES)
    for attempt, poses, (_, ratio) in zip(started, fine, ranked, strict=True):
        results[attempt.index] = _result(poses, attempt, ratio)
    return results


def register_near(
    parts: Sequence[Observed], starts: Sequence[Similarities], runner_up_ratios: Sequence[float]
) -> list[Registration | str]:
    """Pose and scale of each part from a pose that is nearly right (starts, of one pose each), by step 3 of
    `register_parts` alone; a part's runner_up_ratio is what is known of it from before. ValueError as there."""
    checked = [_evidence(one) for one in parts]
    usable = [(k, one) for k, one in enumerate(checked) if isinstance(one, Evidence)]
    evidence = [one for _, one in usable]
    fine = refined([starts[k] for k, _ in usable], evidence, _NEAR_GATES)
    results: list[Registration | str] = [one if isinstance(one, str) else "" for one in checked]
    for (k, one), pose in zip(usable, fine, strict=True):
        low, high = parts[k].scale_range_m
        results[k] = (
            _registration(pose, one, runner_up_ratios[k])
            if low <= pose.s[0] <= high
            else f"the refined scale {pose.s[0]:.3g} m is outside {low:.3g} to {high:.3g} m"
        )
    return results


def registered_at(part: Observed, pose: Similarities) -> Registration | str:
    """What the part's radii say of one pose that was found otherwise, which they leave where it is and do not tell from
    others: runner_up_ratio is 1. Errors as of `register_parts`."""
    evidence = _evidence(part)
    low, high = part.scale_range_m
    if not low <= pose.s[0] <= high:
        return f"the scale {pose.s[0]:.3g} m is outside {low:.3g} to {high:.3g} m"
    return evidence if isinstance(evidence, str) else _registration(pose, evidence, 1.0)


@dataclass(frozen=True, eq=False, slots=True)
class _Attempt:
    """A part that may have a pose: its place among the parts, all evidence, and less of it for a first look."""

    index: int
    evidence: Evidence
    sketch: Evidence
    scale_range_m: tuple[float, float]


def _evidence(part: Observed) -> Evidence | str:
    """What poses of a part are judged by, or why there can be none."""
    points, radii, kappa = _checked(part)
    usable_points = np.all(np.abs(points) <= MAX_RANGE_M, axis=1)
    chosen = np.flatnonzero(usable_points)
    chosen = chosen[multilateration.thinned(len(chosen), _POSE_POINTS)]
    if len(chosen) < 4:
        return f"{len(chosen)} usable points, four are needed"
    counted = radii[chosen].T
    counted = np.where((counted >= 0.0) & (counted <= MAX_RANGE_M), counted, UNUSABLE_RADIUS_M)
    anchors = multilateration.anchors_from(points[chosen])
    spread, axes = multilateration.principal_axes(anchors.relative)
    if spread[1] <= max(1e-3 * spread[0], 1e-5):
        return "the points lie on one line, about which the part can turn"
    normal = axes[:, 2] * (1.0 if axes[:, 2] @ anchors.origin < 0.0 else -1.0)
    sides = None
    if part.side_logits is not None and len(part.votes) and spread[2] <= _PLANAR * spread[1]:
        logits = np.nan_to_num(np.asarray(part.side_logits, np.float64)[chosen], posinf=40.0, neginf=-40.0)
        sides = np.tanh(0.5 * logits)
    return Evidence(anchors, counted, kappa, np.asarray(part.extents_unit, np.float64), sides, normal)


def _result(poses: Similarities, attempt: _Attempt, ratio: float) -> Registration | Ambiguous | str:
    """Of the best pose, and a second where it is as good."""
    low, high = attempt.scale_range_m
    fitting = np.flatnonzero((poses.s >= low) & (poses.s <= high))
    if not len(fitting):
        return f"the refined scale {poses.s[0]:.3g} m is outside {low:.3g} to {high:.3g} m"
    best = _registration(poses.take(fitting[:1]), attempt.evidence, ratio)
    if len(fitting) == 1:
        return best
    return Ambiguous(
        (best, _registration(poses.take(fitting[1:2]), attempt.evidence, 1.0)),
        f"ambiguous: another pose has {ratio:.3f} of this one's support, and neither box nor sides decide",
    )


def _checked(part: Observed) -> tuple[FloatArray, FloatArray, FloatArray]:
    points, radii = np.asarray(part.points_camera, np.float64), np.asarray(part.radii_m, np.float64)
    num_voted = len(part.votes)
    kappa = np.asarray(part.keypoints_unit, np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points_camera: expected (N, 3) metres, got {points.shape}; pass one part's points as rows")
    if kappa.ndim != 2 or kappa.shape[1] != 3 or len(kappa) < 3:
        raise ValueError(
            f"keypoints_unit: expected (n, 3) with n >= 3, got {kappa.shape}; a pose needs three keypoints"
        )
    if radii.shape != (len(points), len(kappa)):
        raise ValueError(
            f"radii_m: expected {(len(points), len(kappa))}, a row for each point and a column for each keypoint, "
            f"got {radii.shape}; select the same points and the part's own keypoints"
        )
    if num_voted > len(kappa):
        raise ValueError(f"votes: expected at most {len(kappa)}, one for each keypoint, got {num_voted}; score fewer")
    if np.shape(part.extents_unit) != (3,):
        raise ValueError(
            f"extents_unit: expected (3,), got {np.shape(part.extents_unit)}; pass the part's box in diagonals"
        )
    if not 0.0 < part.scale_range_m[0] <= part.scale_range_m[1] < float("inf"):
        raise ValueError(f"scale_range_m: expected 0 < low <= high, got {part.scale_range_m}; pass diagonals in metres")
    if part.side_logits is not None and np.shape(part.side_logits) != (len(points), num_voted):
        raise ValueError(
            f"side_logits: expected {(len(points), num_voted)}, a column for each voted keypoint, "
            f"got {np.shape(part.side_logits)}; pass the columns of the voted keypoints, or None"
        )
    return points, radii, kappa


def _registration(pose: Similarities, evidence: Evidence, runner_up_ratio: float) -> Registration:
    """The one pose with its covariance and residuals."""
    equations = pose_system(pose, stacked_radii([evidence]), None, _FINE_GATES[-1])
    system = equations.radial
    squares = (system.weights * system.residuals**2)[0]
    weight = np.maximum(system.weights[0].sum(axis=1), 1e-12)
    variance = np.maximum(squares.sum(axis=1) / weight, 1e-14)
    information = (equations.hessian[0] / variance[:, None, None]).sum(axis=0)
    return Registration(
        T_camera_part=np.asarray(transform_from(pose.R[0], pose.t[0]), np.float64),
        scale_m=float(pose.s[0]),
        covariance=np.linalg.inv(information + 1e-9 * np.eye(7)),
        residual_m=float(np.sqrt(squares.sum() / weight.sum())),
        inlier_share=float(np.mean(np.abs(system.residuals) <= system.scales)),
        runner_up_ratio=runner_up_ratio,
        keypoints_camera=pose.place(evidence.keypoints_unit)[0],
    )
