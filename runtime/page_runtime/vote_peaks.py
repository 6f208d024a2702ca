"""The modes of a keypoint's votes, from the voxels that have the most."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime import multilateration
from page_runtime.multilateration import UNUSABLE_RADIUS_M, FloatArray
from page_runtime.vote_shells import IntArray

MAX_PEAKS = 4

_MAX_PICKS = 12
# Among so many ties a sample shows the modes as well.
_MAX_RANKED = 4096
_GATE_ETAS = 6.0


@dataclass(frozen=True, eq=False, slots=True)
class Modes:
    """Of a keypoint: voxels (T, 3), lattice indices, and their votes (T,), most first; the maximum with all its ties,
    and rivals."""

    voxels: IntArray
    votes: IntArray


@dataclass(frozen=True, eq=False, slots=True)
class Peak:
    """One mode of the votes. position_camera: (3,) m, refined below the voxel on the inlier radii, 8 eta at most,
    or the voxel's where that leads to another mode's place or the time was spent; voxel_camera: (3,) m, the centre of
    the mode's best voxel; votes of that voxel; share = votes / N (Eq. 17)."""

    position_camera: FloatArray
    voxel_camera: FloatArray
    votes: int
    share: float


def peaks_of(
    modes_of: Sequence[Modes],
    parts: Sequence[tuple[FloatArray, FloatArray, int]],
    voxel_m: float,
    *,
    refine: bool,
) -> list[tuple[Peak, ...]]:
    """Of each of J keypoints: its voxels separated, refined and merged, at most MAX_PEAKS, best first.

    parts: in the order of their keypoints, points (N, 3) m camera; radii_m (n, N) m, inf where a point does not vote;
    the number of points that votes are shares of.
    """
    eta_m = math.sqrt(3.0) * voxel_m
    picks = [_picked(one, voxel_m, 3.0 * eta_m) for one in modes_of]
    voxels = [
        np.multiply(one.voxels[pick], voxel_m, dtype=np.float64) for one, pick in zip(modes_of, picks, strict=True)
    ]
    places = _settled(voxels, parts, eta_m) if refine and any(map(len, voxels)) else voxels
    shared = [num_points for _, radii_m, num_points in parts for _ in radii_m]
    return [
        _distinct(own, refined, one.votes[pick], 2.0 * eta_m, num_points)
        for one, pick, own, refined, num_points in zip(modes_of, picks, voxels, places, shared, strict=True)
    ]


def _settled(
    voxels: Sequence[FloatArray], parts: Sequence[tuple[FloatArray, FloatArray, int]], eta_m: float
) -> list[FloatArray]:
    """The voxels (M, 3) m of each keypoint refined on its radii, those of all parts together."""
    owner = np.repeat(np.arange(len(parts)), [len(radii_m) for _, radii_m, _ in parts])
    rows_of = np.bincount(owner, weights=[len(own) for own in voxels], minlength=len(parts)).astype(np.intp)
    anchors = multilateration.stacked([multilateration.anchors_from(points) for points, _, _ in parts])
    starts = np.repeat(anchors.origin, rows_of.max(), axis=1)
    radii_m = np.full((len(parts), rows_of.max(), anchors.relative.shape[1]), UNUSABLE_RADIUS_M)
    where, filled = [], np.zeros(len(parts), np.intp)
    within = np.concatenate([np.arange(len(own)) for _, own, _ in parts])
    for own, part, row in zip(voxels, owner.tolist(), within.tolist(), strict=True):
        rows = slice(filled[part], filled[part] + len(own))
        given_m = parts[part][1][row]
        starts[part, rows] = own
        radii_m[part, rows, : len(given_m)] = np.minimum(given_m, UNUSABLE_RADIUS_M)
        where.append((part, rows))
        filled[part] = rows.stop
    settled = multilateration.settle_positions(starts, anchors, radii_m, _GATE_ETAS * eta_m, 0.01 * eta_m)
    return [settled[at] for at in where]


def _distinct(
    voxels: FloatArray, places: FloatArray, votes: IntArray, separation_m: float, num_points: int
) -> tuple[Peak, ...]:
    """Peaks farther than the separation apart: where the refined places (M, 3) m are, then where only the voxels are,
    since the refinement may lead from one mode to another where the votes hardly hold a direction."""
    taken: dict[int, FloatArray] = {}
    for positions in (places, voxels):
        for at, position in enumerate(positions):
            if at in taken or len(taken) == MAX_PEAKS:
                continue
            if all(math.dist(position, other) > separation_m for other in taken.values()):
                taken[at] = position
    return tuple(Peak(taken[at], voxels[at], int(votes[at]), float(votes[at]) / num_points) for at in sorted(taken))


def _picked(modes: Modes, voxel_m: float, separation_m: float) -> list[int]:
    """Rows of the voxels that represent their surroundings, best first."""
    num_ties = int(np.count_nonzero(modes.votes == modes.votes.max(initial=0)))
    ties = multilateration.thinned(num_ties, _MAX_RANKED)
    rows = np.concatenate((ties, np.arange(num_ties, len(modes.votes))))
    return rows[_spread_rows(np.multiply(modes.voxels[rows], voxel_m, dtype=np.float64), separation_m)].tolist()


def _spread_rows(centres_m: FloatArray, separation_m: float) -> list[int]:
    """Rows of (T, 3), in order, each farther than the separation from those before; together they cover all.

    A flat maximum needs a wider separation to be covered by _MAX_PICKS. Linking neighbours instead would lose a mirror
    image: a ridge of rivals often leads to it.
    """
    picks: list[int] = []
    rows, remaining = np.arange(len(centres_m)), centres_m
    while len(rows):
        if len(picks) == _MAX_PICKS:
            return _spread_rows(centres_m, 2.0 * separation_m)
        picks.append(int(rows[0]))
        away = remaining - remaining[0]
        free = np.einsum("tk,tk->t", away, away) > separation_m * separation_m
        rows, remaining = rows[free], remaining[free]
    return picks
