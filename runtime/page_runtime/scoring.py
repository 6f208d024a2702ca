"""Proposal integration scoring: every point votes for the voxels at its radius (PAGE Eq. 16-18).

A point p with radius r votes for a voxel with centre g when | |p - g| - r | <= eta, eta = sqrt(3) rho: Eq.
16, two-sided (METHOD 1: the paper's Algorithm 1 is one-sided, and biased towards the part). Voxel centres
are the integer multiples of rho, so neither the result nor a tie depends on where a grid begins.

The dense accumulator evaluates 1e7 to 1e9 voxels for each point. `branch_and_bound` finds the same maximum,
the same ties and the same first of the ties (C order of x, y, z), unless `gap` says that the evaluation
budget ran out first.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime import multilateration
from page_runtime.branch_and_bound import Found, Shells, rival_votes, search, voters_from
from page_runtime.multilateration import UNUSABLE_RADIUS_M, Anchors, FloatArray

MAX_PEAKS = 4
# No depth camera measures further; beyond it voxel indices and float32 bounds would lose their meaning.
MAX_RANGE_M = 1e4

_MAX_PICKS = 12
_SEED_POINTS = 224


@dataclass(frozen=True, eq=False, slots=True)
class Peak:
    """One mode of the votes. position_camera: (3,) m, refined below the voxel on the inlier radii, or the
    voxel's where that strays 10 eta from it; voxel_camera: (3,) m, the centre of the mode's best voxel;
    votes of that voxel; share = votes / N (Eq. 17)."""

    position_camera: FloatArray
    voxel_camera: FloatArray
    votes: int
    share: float


@dataclass(frozen=True, eq=False, slots=True)
class KeypointVotes:
    """What the votes of a part say of one keypoint.

    peaks: at most MAX_PEAKS modes with >= rival_share of the maximum, best first, more than 2 eta apart;
    the first holds the first of the tied voxels. Empty if and only if `reason` says why. ties_camera: (T,
    3) m, every voxel with max_votes. evaluations: distance tests made. gap: no voxel has more than
    max_votes + gap votes; 0 certifies that maximum, ties and first peak equal the dense accumulator's.
    rivals_complete: nor was any voxel with a rival's votes left out.
    """

    peaks: tuple[Peak, ...]
    max_votes: int
    ties_camera: FloatArray
    evaluations: int
    gap: int
    rivals_complete: bool
    reason: str = ""

    @property
    def ties(self) -> int:
        return len(self.ties_camera)


def score_keypoints(
    points_camera: NDArray[np.floating],
    radii_m: NDArray[np.floating],
    *,
    voxel_m: float = 0.005,
    rival_share: float = 0.95,
    max_evaluations: int = 20_000_000,
) -> tuple[KeypointVotes, ...]:
    """Vote for the n keypoints of one part (Eq. 16-18), exactly, within a budget.

    points_camera: (N, 3) m, points of the part; radii_m: (N, n) m, each point's distance to each keypoint.
    Both are taken as float32. voxel_m: rho. rival_share: modes with this share of the maximum are reported
    too, so that the mirror image of a planar part's keypoint (METHOD 12) is seen; smaller costs more.
    max_evaluations: budget of distance tests for each keypoint, beyond some 300 N for its seeds; when it is
    spent, or 2^18 cells at once (8 MB) do not suffice, the best voxel so far is returned with its gap.

    A point or radius that is not finite, is negative, or exceeds MAX_RANGE_M does not vote. Fewer than four
    voters, or voters on one line, leave a keypoint undetermined: no peaks, and the reason. Raises
    ValueError for wrong shapes or parameters, never for values of points and radii.
    """
    points, radii = _checked(points_camera, radii_m, voxel_m, rival_share, max_evaluations)
    usable_points = np.all(np.abs(points) <= MAX_RANGE_M, axis=1)
    usable = usable_points[:, None] & (radii >= 0.0) & (radii <= MAX_RANGE_M)
    reasons = [_undetermined(points, usable[:, 0])] if usable.shape[1] else []
    for j in range(1, usable.shape[1]):
        same = bool((usable[:, j] == usable[:, j - 1]).all())
        reasons.append(reasons[-1] if same else _undetermined(points, usable[:, j]))
    active = [j for j, reason in enumerate(reasons) if not reason]
    results = [KeypointVotes((), 0, np.empty((0, 3)), 0, 0, True, reason) for reason in reasons]
    if not active:
        return tuple(results)
    counted = np.where(usable, radii, UNUSABLE_RADIUS_M).T[active][:, usable_points]
    points_voting = points[usable_points]
    seeds = _seeds(points_voting, counted, voxel_m)
    voters = voters_from(points_voting, voxel_m)
    founds = []
    for row, radii_row in enumerate(counted):
        own = radii_row < UNUSABLE_RADIUS_M
        whole = bool(own.all())
        shells = Shells(voters if whole else voters_from(points_voting[own], voxel_m), radii_row[own])
        founds.append(search(shells, seeds[row], rival_share, max_evaluations))
    anchors = multilateration.anchors_from(points_voting)
    peaks = _peaks(founds, anchors, counted, voxel_m, len(points))
    for j, found, modes in zip(active, founds, peaks, strict=True):
        best = int(found.votes[0])
        unsearched = found.unsearched_bound
        results[j] = KeypointVotes(
            peaks=modes,
            max_votes=best,
            ties_camera=found.voxels[found.votes == best] * voxel_m,
            evaluations=found.evaluations,
            gap=max(0, unsearched + 1 - best),
            rivals_complete=unsearched < rival_votes(best, rival_share),
        )
    return tuple(results)


def _checked(
    points_camera: NDArray[np.floating],
    radii_m: NDArray[np.floating],
    voxel_m: float,
    rival_share: float,
    max_evaluations: int,
) -> tuple[FloatArray, FloatArray]:
    with np.errstate(over="ignore", invalid="ignore"):
        points = np.asarray(points_camera, np.float32)
        radii = np.asarray(radii_m, np.float32)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points_camera: expected (N, 3) metres, got {points.shape}; pass one part's points as rows")
    if radii.ndim != 2 or len(radii) != len(points):
        raise ValueError(
            f"radii_m: expected ({len(points)}, n) metres, a row for each point, got {radii.shape}; "
            "select the same points from both"
        )
    if not 1e-6 <= voxel_m <= 1e3:
        raise ValueError(f"voxel_m: expected metres in [1e-6, 1e3], got {voxel_m}; 0.005 suits errors of 5 mm")
    if not 0.0 < rival_share <= 1.0:
        raise ValueError(f"rival_share: expected a share in (0, 1], got {rival_share}; 0.95 lists mirror modes")
    if max_evaluations < 0:
        raise ValueError(f"max_evaluations: expected >= 0, got {max_evaluations}; the default is 20 million")
    return points.astype(np.float64), radii.astype(np.float64)


def _undetermined(points: FloatArray, usable: NDArray[np.bool_]) -> str:
    """Why the votes of these points determine no keypoint, or nothing."""
    voting = points[usable]
    if len(voting) < 4:
        return f"{len(voting)} points vote, four are needed"
    spread, _ = multilateration.principal_axes(voting - voting.mean(axis=0))
    if spread[1] <= max(1e-3 * spread[0], 1e-5):
        return "the voting points lie on one line, which leaves a circle of keypoints"
    return ""


def _seeds(points: FloatArray, radii_m: FloatArray, voxel_m: float) -> FloatArray:
    """(n, 3, 3) m: for every keypoint the refined hypotheses of multilateration. They only bound the
    search.
    """
    chosen = multilateration.thinned(len(points), _SEED_POINTS)
    anchors = multilateration.anchors_from(points[chosen])
    radii_m = radii_m[:, chosen]
    starts = multilateration.linear_hypotheses(anchors, radii_m)
    tolerance_m = math.sqrt(3.0) * voxel_m
    schedule_m = [max(tolerance_m, 0.3 * 0.6**k) for k in range(8)]
    refined = multilateration.refine_positions(
        starts.reshape(-1, 3), anchors, np.repeat(radii_m, 3, axis=0), schedule_m
    )
    return refined.reshape(-1, 3, 3)


def _peaks(
    founds: list[Found], anchors: Anchors, radii_m: FloatArray, voxel_m: float, num_points: int
) -> list[tuple[Peak, ...]]:
    """Separate, refine and merge the modes of each keypoint; radii_m: (n, N) m of the anchors."""
    tolerance_m = math.sqrt(3.0) * voxel_m
    centres = [np.multiply(found.voxels, voxel_m, dtype=np.float64) for found in founds]
    picks = [_spread_rows(each, 3.0 * tolerance_m) for each in centres]
    rows = np.repeat(np.arange(len(founds)), [len(pick) for pick in picks])
    voxels = np.concatenate([each[pick] for each, pick in zip(centres, picks, strict=True)])
    refined = multilateration.settle_positions(voxels, anchors, radii_m[rows], 6.0 * tolerance_m, 0.01 * tolerance_m)
    # Voters too few or too alike leave directions in which the refinement is not held.
    strayed = np.linalg.norm(refined - voxels, axis=1) > 10.0 * tolerance_m
    refined[strayed] = voxels[strayed]
    results = []
    for row, (found, pick) in enumerate(zip(founds, picks, strict=True)):
        modes: list[Peak] = []
        for voxel, position, at in zip(voxels[rows == row], refined[rows == row], pick, strict=True):
            if all(np.linalg.norm(position - mode.position_camera) > 2.0 * tolerance_m for mode in modes):
                votes = int(found.votes[at])
                modes.append(Peak(position, voxel, votes, votes / num_points))
        results.append(tuple(modes[:MAX_PEAKS]))
    return results


def _spread_rows(centres_m: FloatArray, separation_m: float) -> list[int]:
    """Rows of (T, 3), in order, each farther than the separation from those before; together they cover all.

    A flat maximum needs a wider separation to be covered by _MAX_PICKS. Linking neighbours instead would
    lose a mirror image: a ridge of rivals often leads to it.
    """
    picks: list[int] = []
    free = np.ones(len(centres_m), np.bool_)
    while free.any():
        if len(picks) == _MAX_PICKS:
            return _spread_rows(centres_m, 2.0 * separation_m)
        picks.append(int(free.argmax()))
        away = centres_m - centres_m[picks[-1]]
        free &= np.einsum("tk,tk->t", away, away) > separation_m * separation_m
    return picks
