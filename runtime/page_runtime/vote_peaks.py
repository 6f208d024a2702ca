"""The modes of a keypoint's votes, from the voxels that have the most."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime import multilateration
from page_runtime.branch_and_bound import Found
from page_runtime.multilateration import UNUSABLE_RADIUS_M, FloatArray

MAX_PEAKS = 4

_MAX_PICKS = 12
# Among so many rivals a sample shows the modes as well.
_MAX_RANKED = 4096


@dataclass(frozen=True, eq=False, slots=True)
class Peak:
    """One mode of the votes. position_camera: (3,) m, refined below the voxel on the inlier radii, or the voxel's where
    that strays 10 eta from it or the time was spent; voxel_camera: (3,) m, the centre of the mode's best voxel; votes
    of that voxel; share = votes / N (Eq. 17)."""

    position_camera: FloatArray
    voxel_camera: FloatArray
    votes: int
    share: float


def peaks_of(
    founds: Sequence[Found], points: FloatArray, radii_m: FloatArray, num_points: int, voxel_m: float, *, refine: bool
) -> list[tuple[Peak, ...]]:
    """Of each of a part's n keypoints: its voxels separated, refined and merged, at most MAX_PEAKS, best first.

    points: (N, 3) m camera; radii_m: (n, N) m, inf where a point does not vote; num_points: of which votes are shares.
    """
    eta_m = math.sqrt(3.0) * voxel_m
    picks = [_picked(found, voxel_m, 3.0 * eta_m) for found in founds]
    indices = np.concatenate([found.voxels[pick] for found, pick in zip(founds, picks, strict=True)])
    voxels = np.multiply(indices, voxel_m, dtype=np.float64)
    places = voxels
    if refine and len(voxels):
        rows = np.repeat(np.arange(len(founds)), [len(pick) for pick in picks])
        counted = np.minimum(radii_m, UNUSABLE_RADIUS_M)[rows]
        anchors = multilateration.anchors_from(points)
        places = multilateration.settle_positions(voxels, anchors, counted, 6.0 * eta_m, 0.01 * eta_m)
        # Voters too few or too alike leave directions in which the refinement is not held.
        strayed = np.linalg.norm(places - voxels, axis=1) > 10.0 * eta_m
        places[strayed] = voxels[strayed]
    results, remaining = [], zip(voxels, places.tolist(), strict=True)
    for found, pick in zip(founds, picks, strict=True):
        modes: list[Peak] = []
        for at in pick:
            voxel, place = next(remaining)
            if all(math.dist(place, mode.position_camera) > 2.0 * eta_m for mode in modes):
                votes = int(found.votes[at])
                modes.append(Peak(np.array(place), voxel, votes, votes / num_points))
        results.append(tuple(modes[:MAX_PEAKS]))
    return results


def _picked(found: Found, voxel_m: float, separation_m: float) -> list[int]:
    """Rows of the voxels that represent their surroundings, best first."""
    rows = multilateration.thinned(len(found.votes), _MAX_RANKED)
    return rows[_spread_rows(np.multiply(found.voxels[rows], voxel_m, dtype=np.float64), separation_m)].tolist()


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
