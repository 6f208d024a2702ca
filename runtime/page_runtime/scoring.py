"""Proposal integration scoring: every point votes for the voxels at its radius (PAGE Eq. 16-18).

A point p with radius r votes for a voxel with centre g when | |p - g| - r | <= eta, eta = sqrt(3) rho: Eq. 16,
two-sided. The paper's Algorithm 1 has 0 < r - |p - g| < eta, which is biased towards the part (METHOD 1); both are a
`VoteRule`. Voxel centres are the integer multiples of rho, so neither the result nor a tie depends on where a grid
begins.

The dense accumulator evaluates 1e7 to 1e9 voxels for each point. `branch_and_bound` finds the same maximum, the same
ties and the same first of the ties (C order of x, y, z), unless `gap` says that a budget ran out first.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from page_runtime import multilateration
from page_runtime.branch_and_bound import search
from page_runtime.multilateration import UNUSABLE_RADIUS_M, Anchors, FloatArray
from page_runtime.rival_modes import candidate_places, rival_voxels
from page_runtime.vote_peaks import MAX_PEAKS, Modes, Peak, peaks_of
from page_runtime.vote_race import Found
from page_runtime.vote_shells import ONE_SIDED, TWO_SIDED, Shells, VoteRule, shells_from

__all__ = ["MAX_PEAKS", "MAX_RANGE_M", "ONE_SIDED", "TWO_SIDED", "KeypointVotes", "Peak", "VoteRule"]
__all__ += ["score_keypoints", "score_parts"]

# No depth camera measures further; beyond it voxel indices and float32 bounds would lose their meaning.
MAX_RANGE_M = 1e4

_SEED_POINTS = 224
# Set aside for what follows the search, in the time that the seeds took: a measure of this machine at this moment.
_AFTER_SEEDS = 1.0


@dataclass(frozen=True, eq=False, slots=True)
class KeypointVotes:
    """What the votes of a part say of one keypoint.

    peaks: at most MAX_PEAKS modes with >= rival_share of the maximum, best first, more than 2 eta apart; the first
    holds the first of the tied voxels, the others are ties and what `rival_modes` finds. Empty if and only if `reason`
    says why. ties_camera: (T, 3) m, every voxel with max_votes. evaluations: distance tests made for the maximum. gap:
    no voxel has more than max_votes + gap votes; 0 certifies that maximum, ties and first peak equal the dense
    accumulator's.
    """

    peaks: tuple[Peak, ...]
    max_votes: int
    ties_camera: FloatArray
    evaluations: int
    gap: int
    reason: str = ""

    @property
    def ties(self) -> int:
        return len(self.ties_camera)


@dataclass(frozen=True, eq=False, slots=True)
class _Ballot:
    """Of one part: points (V, 3) m that vote, radii_m (a, V) of the keypoints that are determined, inf where one does
    not vote; reasons of all n keypoints, empty for these; num_points, those given."""

    points: FloatArray
    radii_m: FloatArray
    reasons: list[str]
    num_points: int


@dataclass(frozen=True, eq=False, slots=True)
class _Thinned:
    """P parts with fewer points: anchors, `stacked`; radii_m (P, n, m) m, UNUSABLE_RADIUS_M where one does not vote or
    the part has fewer keypoints or points; counts, the keypoints of each part."""

    anchors: Anchors
    radii_m: FloatArray
    counts: list[int]

    def of_keypoints(self, rows: FloatArray) -> FloatArray:
        """(J, ...): what belongs to the J keypoints there are, of (P, n, ...)."""
        return np.concatenate([own[:count] for own, count in zip(rows, self.counts, strict=True)])


def score_keypoints(
    points_camera: NDArray[np.floating],
    radii_m: NDArray[np.floating],
    *,
    voxel_m: float = 0.005,
    rule: VoteRule = TWO_SIDED,
    rival_share: float = 0.95,
    max_evaluations: int = 200_000_000,
    max_seconds: float | None = None,
) -> tuple[KeypointVotes, ...]:
    """Vote for the n keypoints of one part (Eq. 16-18), exactly, within a budget.

    points_camera: (N, 3) m, points of the part; radii_m: (N, n) m, each point's distance to each keypoint. The rest is
    as in `score_parts`.
    """
    return score_parts(
        [(points_camera, radii_m)],
        voxel_m=voxel_m,
        rule=rule,
        rival_share=rival_share,
        max_evaluations=max_evaluations,
        max_seconds=max_seconds,
    )[0]


def score_parts(
    parts: Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]],
    *,
    voxel_m: float = 0.005,
    rule: VoteRule = TWO_SIDED,
    rival_share: float = 0.95,
    max_evaluations: int = 200_000_000,
    max_seconds: float | None = None,
    full_share: float = 0.0,
) -> tuple[tuple[KeypointVotes, ...], ...]:
    """`score_keypoints` of every part of a frame, sooner than one after the other.

    parts: for each, points_camera (N, 3) m and radii_m (N, n) m, taken as float32; N and n may differ. voxel_m: rho.
    rule: which voxels get a vote. rival_share: modes with this share of the maximum are reported too, so that the
    mirror image of a planar part's keypoint (METHOD 12) is seen. max_evaluations: budget of
    distance tests for each keypoint, beyond some 300 N for its seeds; 512 points need 0.2 to 0.8 million at 10 mm in
    the median, 5 to 28 million at 2 mm, where all of the default may be needed. max_seconds: budget of wall time for
    the call; the seeds are found whatever it is, which takes 2 ms for a part and 4 ms for seven. When one is spent, or
    more than 2^15 voxels share the most votes, the best voxel so far is returned with its gap; with max_seconds that
    may differ from call to call. full_share: a keypoint for which the seeds find no voxel with this share of the votes
    gets so much less of max_evaluations: certifying what radii that agree on nothing have most of takes longest of all.

    A point or radius that is not finite, is negative, or exceeds MAX_RANGE_M does not vote. Fewer than four voters, or
    voters on one line, leave a keypoint undetermined: no peaks, and the reason. Raises ValueError for wrong shapes or
    parameters, never for values of points and radii.
    """
    began = perf_counter()
    _check_parameters(voxel_m, rival_share, max_evaluations, max_seconds)
    if not 0.0 <= full_share <= 1.0:
        raise ValueError(f"full_share: expected a share in [0, 1], got {full_share}; 0 gives all the whole budget")
    ballots = [_ballot(*_checked(points_camera, radii_m)) for points_camera, radii_m in parts]
    voting = [ballot for ballot in ballots if len(ballot.radii_m)]
    founds: list[Found] = []
    peaks: list[tuple[Peak, ...]] = []
    if voting:
        limit = math.inf if max_seconds is None else began + max_seconds
        thinned = _thinned(voting, voxel_m, rule)
        seeds = _seeds(thinned, voxel_m)
        shells = shells_from([(ballot.points, ballot.radii_m) for ballot in voting], voxel_m, rule)
        after = _AFTER_SEEDS * (perf_counter() - began)
        founds = search(shells, thinned.of_keypoints(seeds), max_evaluations, limit - after, full_share)
        modes = [Modes(found.voxels, np.full(len(found.voxels), found.votes)) for found in founds]
        if perf_counter() < limit - 0.75 * after:
            founds, modes = _with_rivals(shells, founds, thinned, seeds, rival_share)
        given = [(ballot.points, ballot.radii_m, ballot.num_points) for ballot in voting]
        peaks = peaks_of(modes, given, voxel_m, refine=perf_counter() < limit - 0.5 * after)
    remaining = zip(founds, peaks, strict=True)
    return tuple(
        tuple(_undetermined_votes(reason) if reason else _votes(*next(remaining), voxel_m) for reason in ballot.reasons)
        for ballot in ballots
    )


def _undetermined_votes(reason: str) -> KeypointVotes:
    return KeypointVotes((), 0, np.empty((0, 3)), 0, 0, reason)


def _votes(found: Found, peaks: tuple[Peak, ...], voxel_m: float) -> KeypointVotes:
    unsearched = found.unsearched_bound
    reason = "" if peaks else "no voxel has a vote" if not unsearched else "no voxel with a vote was found in time"
    return KeypointVotes(
        peaks=peaks,
        max_votes=found.votes,
        ties_camera=np.multiply(found.voxels, voxel_m, dtype=np.float64),
        evaluations=found.evaluations,
        gap=max(0, unsearched + 1 - found.votes) if peaks else unsearched,
        reason=reason,
    )


def _check_parameters(voxel_m: float, rival_share: float, max_evaluations: int, max_seconds: float | None) -> None:
    if not 1e-6 <= voxel_m <= 1e3:
        raise ValueError(f"voxel_m: expected metres in [1e-6, 1e3], got {voxel_m}; 0.005 suits errors of 5 mm")
    if not 0.0 < rival_share <= 1.0:
        raise ValueError(f"rival_share: expected a share in (0, 1], got {rival_share}; 0.95 lists mirror modes")
    if max_evaluations < 0:
        raise ValueError(f"max_evaluations: expected >= 0, got {max_evaluations}; the default is 200 million")
    if max_seconds is not None and not max_seconds >= 0.0:
        raise ValueError(f"max_seconds: expected seconds >= 0 or None, got {max_seconds}; None is no limit")


def _checked(points_camera: NDArray[np.floating], radii_m: NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
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
    return points.astype(np.float64), radii.astype(np.float64)


def _ballot(points: FloatArray, radii_m: FloatArray) -> _Ballot:
    """Points (N, 3) and radii (N, n) without those that cannot vote."""
    usable_points = np.all(np.abs(points) <= MAX_RANGE_M, axis=1)
    usable = usable_points[:, None] & (radii_m >= 0.0) & (radii_m <= MAX_RANGE_M)
    reasons = [_undetermined(points, usable[:, 0])] if usable.shape[1] else []
    for j in range(1, usable.shape[1]):
        same = bool((usable[:, j] == usable[:, j - 1]).all())
        reasons.append(reasons[-1] if same else _undetermined(points, usable[:, j]))
    active = [j for j, reason in enumerate(reasons) if not reason]
    counted = np.where(usable, radii_m, np.inf).T[active][:, usable_points]
    return _Ballot(points[usable_points], counted, reasons, len(points))


def _undetermined(points: FloatArray, usable: NDArray[np.bool_]) -> str:
    """Why the votes of these points determine no keypoint, or nothing."""
    voting = points[usable]
    if len(voting) < 4:
        return f"{len(voting)} points vote, four are needed"
    spread, _ = multilateration.principal_axes(voting - voting.mean(axis=0))
    if spread[1] <= max(1e-3 * spread[0], 1e-5):
        return "the voting points lie on one line, which leaves a circle of keypoints"
    return ""


def _thinned(ballots: Sequence[_Ballot], voxel_m: float, rule: VoteRule) -> _Thinned:
    chosen = [multilateration.thinned(len(ballot.points), _SEED_POINTS) for ballot in ballots]
    pairs = list(zip(ballots, chosen, strict=True))
    anchors = multilateration.stacked([multilateration.anchors_from(ballot.points[rows]) for ballot, rows in pairs])
    radii_m = _filled([ballot.radii_m[:, rows] for ballot, rows in pairs])
    # Shells of a one-sided rule have their middle before the radius.
    radii_m[radii_m < UNUSABLE_RADIUS_M] += 0.5 * sum(rule.bounds_m(voxel_m))
    return _Thinned(anchors, np.maximum(radii_m, 0.0), [len(ballot.radii_m) for ballot in ballots])


def _seeds(thinned: _Thinned, voxel_m: float) -> FloatArray:
    """(P, n, 3, 3) m: for every keypoint the refined hypotheses of multilateration. They only bound the search."""
    starts = multilateration.linear_hypotheses(thinned.anchors, thinned.radii_m)
    schedule_m = [max(math.sqrt(3.0) * voxel_m, 0.3 * 0.5**k) for k in range(6)]
    refined = multilateration.refine_positions(
        starts.reshape(len(starts), -1, 3), thinned.anchors, np.repeat(thinned.radii_m, 3, axis=1), schedule_m
    )
    return refined.reshape(starts.shape)


def _with_rivals(
    shells: Shells,
    founds: Sequence[Found],
    thinned: _Thinned,
    seeds: FloatArray,
    rival_share: float,
) -> tuple[list[Found], list[Modes]]:
    """The maxima (J,) with their rivals behind them; where a search was cut short, a rival may be the new maximum."""
    best = iter([found.voxels[0] if len(found.voxels) else np.zeros(3) for found in founds])
    places = np.zeros((*thinned.radii_m.shape[:2], 3))
    for part, count in enumerate(thinned.counts):
        for row in range(count):
            places[part, row] = next(best) * shells.voxel_m
    eta_m = math.sqrt(3.0) * shells.voxel_m
    candidates = candidate_places(places, seeds, thinned.anchors, thinned.radii_m, eta_m)
    rivals = rival_voxels(shells, founds, thinned.of_keypoints(candidates), rival_share)
    best, modes = [], []
    for found, (voxels, votes) in zip(founds, rivals, strict=True):
        most = max(found.votes, int(votes.max(initial=0)))
        if most > found.votes:
            found = replace(found, voxels=np.unique(voxels[votes == most], axis=0), votes=most)
            voxels, votes = voxels[votes < most], votes[votes < most]
        best.append(found)
        counts = np.concatenate((np.full(len(found.voxels), found.votes), votes))
        modes.append(Modes(np.concatenate((found.voxels, voxels)), counts))
    return best, modes


def _filled(radii_m: Sequence[FloatArray]) -> FloatArray:
    """(P, rows, m): each (rows, m), which may differ, with UNUSABLE_RADIUS_M for inf and for what is missing."""
    shape = np.max([each.shape for each in radii_m], axis=0)
    result = np.full((len(radii_m), *shape), UNUSABLE_RADIUS_M)
    for row, each in zip(result, radii_m, strict=True):
        row[: len(each), : each.shape[1]] = np.minimum(each, UNUSABLE_RADIUS_M)
    return result
