"""The voxels with the most votes, by branch and bound with the dense float64 accumulator's answer.

A point p with radius r votes for a voxel with centre g when | |p - g| - r | <= eta: g lies in a shell. A cell of 2^l
voxels a side cannot hold a voxel with more votes than the number of shells, thickened by half the diagonal between
the cell's outermost voxel centres, that the cell's centre lies in. Cells bounded below the best votes known are
dropped, the others split. The bounds are computed in float32, thickened by the worst rounding possible; the votes
reported are the float64 count of the defining formula.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]

_START_CELLS = 400
_JUMP_CELLS = 768
_PROBED_AMONG = 256
_PROBED_CELLS = 8
_BLOCK_CELLS = 8192
# Bounds the memory where few points leave a wide plateau; over 70 points the default budget is tighter.
_MAX_CELLS = 2**18
_CHUNK_EVALUATIONS = 160_000
# |d^2 - m| <= t is asked as 0 <= (d^2 - m) / t + 1 <= 2, and that of the float's bits by one unsigned comparison:
# negative numbers and NaN have larger bits than 2.0.
_BITS_OF_TWO = np.float32(2.0).view(np.uint32)


@dataclass(frozen=True, eq=False, slots=True)
class Voters:
    """Points that vote, with what all their keypoints share.

    points: (N, 3) m camera. origin: (3,) voxel near their mean; relative: (N, 3) m from it; norm2: (N,) m^2 and norm:
    (N,) m of that; lift: (4, N), (1, -2 p). values, inside: scratch of the kernel, allocated once as fresh pages
    cost more than the arithmetic done in them.
    """

    points: FloatArray
    voxel_m: float
    origin: IntArray
    relative: FloatArray
    norm2: FloatArray
    norm: FloatArray
    lift: FloatArray
    values: Float32Array
    inside: NDArray[np.bool_]

    @property
    def tolerance_m(self) -> float:
        return math.sqrt(3.0) * self.voxel_m


@dataclass(frozen=True, eq=False, slots=True)
class Shells:
    """Voters of one keypoint and their radii_m (N,)."""

    voters: Voters
    radii_m: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Found:
    """Voxels (T, 3), lattice indices, and their votes (T,): maximum and rivals, best first, then C order.

    No voxel that was not searched has more votes than unsearched_bound, 0 if all were.
    """

    voxels: IntArray
    votes: IntArray
    evaluations: int
    unsearched_bound: int


def voters_from(points: FloatArray, voxel_m: float) -> Voters:
    """Precompute for (N, 3) finite points in metres and voxels of voxel_m."""
    origin = np.rint(points.mean(axis=0) / voxel_m).astype(np.int64)
    relative = points - origin * voxel_m
    lift = np.concatenate((np.ones((1, len(points))), -2.0 * relative.T))
    norm2 = np.einsum("nk,nk->n", relative, relative)
    values = np.empty(_padded(len(points)) * _columns(_padded(len(points))), np.float32)
    return Voters(
        points, voxel_m, origin, relative, norm2, np.sqrt(norm2), lift, values, np.empty(len(values), np.bool_)
    )


def rival_votes(votes: int, rival_share: float) -> int:
    """Fewest votes of a rival; the small term keeps 0.95 * 100 from rounding up to 96."""
    return max(1, math.ceil(rival_share * votes - 1e-9))


def _groups(count: int) -> int:
    """Groups of at most 255 voters, whose votes fit a byte."""
    return -(-count // 255)


def _padded(count: int) -> int:
    return _groups(count) * -(-count // _groups(count))


def _columns(padded: int) -> int:
    """Voxels per call of the kernel, so that its values stay in the second-level cache."""
    return max(16, _CHUNK_EVALUATIONS // padded // 16 * 16)


def _bands(shells: Shells, thickness_m: FloatArray, signs: FloatArray, reach_m: float) -> Float32Array:
    """(L, 5, padded N): column i times (|g|^2, g, 1) is in [0, 2] if g is within the thickness of shell i.

    With lo = max(r - w, 0)^2, hi = (r + w)^2, m and t their mean and half difference: |d^2 - m| <= t, no root.
    thickness_m: (L,) m, w. signs: (L,), +1 thickens the bands by the float32 rounding error of positions up to
    `reach_m` from the origin, so that no vote is missed; -1 thins them so that none is invented. The error of the
    five products and their sum is below 8 x 2^-24 of the sum of their magnitudes; 12 leave a margin, also for float64
    in the formula. Columns that fill the last group never vote.
    """
    voters, radii_m = shells.voters, shells.radii_m
    outer = radii_m + thickness_m[:, None]
    inner = np.maximum(radii_m - thickness_m[:, None], 0.0)
    outer *= outer
    inner *= inner
    # |g|^2 + 2 |g||p| + |p|^2 + m + t, where m + t = hi.
    slack = 12.0 * 2.0**-24 * ((reach_m + voters.norm) ** 2 + outer) + 1e-15
    half = 0.5 * (outer - inner) + signs[:, None] * slack
    voting = half > 0.0
    inverse = voting / np.where(voting, half, 1.0)
    count = len(radii_m)
    bands = np.zeros((len(signs), 5, _padded(count)), np.float32)
    bands[:, 4] = -1.0
    np.multiply(voters.lift, inverse[:, None], out=bands[:, :4, :count], casting="same_kind")
    bands[:, 4, :count] = (voters.norm2 - 0.5 * (outer + inner)) * inverse + (2.0 * voting - 1.0)
    return bands


def _count(voters: Voters, bands: Float32Array, centres_m: FloatArray) -> IntArray:
    """(M,) shells that each of the centres (3, M), in metres from the origin voxel, lies in."""
    padded = bands.shape[1]
    lifted = np.empty((5, centres_m.shape[1]), np.float32)
    lifted[0] = np.einsum("km,km->m", centres_m, centres_m)
    lifted[1:4] = centres_m
    lifted[4] = 1.0
    counts = np.empty(centres_m.shape[1], np.int64)
    width = _columns(padded)
    for begin in range(0, len(counts), width):
        part = lifted[:, begin : begin + width]
        used = padded * part.shape[1]
        values, inside = voters.values[:used], voters.inside[:used]
        np.matmul(bands.T, part, out=values.reshape(padded, -1))
        np.less_equal(values.view(np.uint32), _BITS_OF_TWO, out=inside)
        grouped = inside.view(np.uint8).reshape(_groups(padded), -1, part.shape[1])
        votes = np.add.reduce(grouped, axis=1, dtype=np.uint8)
        np.add.reduce(votes, axis=0, dtype=np.int64, out=counts[begin : begin + width])
    return counts


def _centres_m(voters: Voters, corners: IntArray, level: int) -> FloatArray:
    """(3, M) m from the origin voxel: centres of cells of 2^level voxels a side, from their first voxels."""
    return (corners + 0.5 * (2**level - 1)) * voters.voxel_m


def _exact_count(shells: Shells, voxels: IntArray) -> IntArray:
    """(M,) votes of voxels (3, M), counted from the origin, by the defining formula in float64."""
    voters = shells.voters
    centres = (voxels + voters.origin[:, None]) * voters.voxel_m
    counts = np.empty(voxels.shape[1], np.int64)
    width = max(1, _CHUNK_EVALUATIONS // (4 * len(voters.points)))
    for begin in range(0, len(counts), width):
        x, y, z = (centres[k, begin : begin + width, None] - voters.points[:, k] for k in range(3))
        inside = np.abs(np.sqrt(x * x + y * y + z * z) - shells.radii_m) <= voters.tolerance_m
        counts[begin : begin + width] = np.count_nonzero(inside, axis=1)
    return counts


def _pigeonhole_box(shells: Shells, votes: int) -> tuple[IntArray, IntArray]:
    """First and last voxel (3,), from the origin, of all with `votes`: so many shells span it on each axis."""
    voters = shells.voters
    reach = (shells.radii_m + voters.tolerance_m)[:, None]
    low = np.partition(voters.relative - reach, votes - 1, axis=0)[votes - 1]
    high = np.partition(voters.relative + reach, len(reach) - votes, axis=0)[len(reach) - votes]
    # A thousandth of a voxel covers the rounding of these sums.
    first = np.ceil(low / voters.voxel_m - 1e-3).astype(np.int64)
    return first, np.maximum(first, np.floor(high / voters.voxel_m + 1e-3).astype(np.int64))


def _cube(side: int) -> IntArray:
    """(3, side^3) lattice offsets of a cube, C order."""
    return np.indices((side, side, side), dtype=np.int64).reshape(3, -1)


_OCTANTS = _cube(2)
_WINDOW = _cube(5) - 2


def search(shells: Shells, seeds: FloatArray, rival_share: float, max_evaluations: int) -> Found:
    """The voxels of most votes and their rivals, searched level by level from seeds (S, 3) m.

    Seeds only bound the search; they and the 125 voxels around the best are not part of the budget.
    """
    voters = shells.voters
    count, voxel_m, tolerance_m = len(voters.points), voters.voxel_m, voters.tolerance_m
    # A seed may have diverged; 2^40 voxels is far from any, yet exact in int64 and float64.
    near = np.clip(seeds / voxel_m - voters.origin, -(2.0**40), 2.0**40)
    # At the first shell a voxel has its vote, so that the best known is never none.
    on_shell = (voters.relative[:1] + np.array([shells.radii_m[0], 0.0, 0.0])) / voxel_m
    starts = np.rint(np.concatenate((near, on_shell))).astype(np.int64).T
    votes = _exact_count(shells, starts)
    best, best_voxel = int(votes.max()), starts[:, votes.argmax()]
    first, last = _pigeonhole_box(shells, rival_votes(best, rival_share))
    extent = [int(size) for size in last - first + 1]
    level = 0
    while math.prod(-(-size >> level) for size in extent) > _START_CELLS:
        level += 1
    span = np.maximum(np.maximum(np.abs(first), np.abs(last)) + 2**level, np.abs(best_voxel) + 2)
    half_diagonals_m = tolerance_m * 0.5 * (2.0 ** np.arange(level + 1) - 1.0)
    signs = np.append(-1.0, np.ones(level + 1))
    thickness_m = np.append(0.0, half_diagonals_m) + tolerance_m
    certain, *possible = _bands(shells, thickness_m, signs, math.hypot(*span) * voxel_m)

    cells = _WINDOW + best_voxel[:, None]
    votes = _count(voters, certain, _centres_m(voters, cells, 0))
    if votes.max() > best:
        best, best_voxel = int(votes.max()), cells[:, votes.argmax()]
    cells_counted = starts.shape[1] + cells.shape[1]
    budget = cells_counted + max_evaluations // count

    parents = np.indices([-(-size >> level) for size in extent], dtype=np.int64).reshape(3, -1)
    parents = (parents << level) + first[:, None]
    bounds = np.full(parents.shape[1], count)
    unsearched_bound, step = 0, 0
    while True:
        # Half of what is left for each level, that a search cut short still ends at voxels and their recount.
        allowed = min((budget - cells_counted) // 2, _MAX_CELLS) // 8**step
        if allowed < len(bounds):
            order = np.argsort(-bounds, kind="stable")
            unsearched_bound = max(unsearched_bound, int(bounds[order[allowed]]))
            parents = parents[:, order[:allowed]]
        cells_counted += parents.shape[1] * 8**step
        parents, bounds = _split(voters, possible[level], parents, level, step, rival_votes(best, rival_share))
        if level == 0 or len(bounds) == 0:
            break
        if len(bounds) > _PROBED_AMONG:
            # A better voxel found now, in the likeliest cells, spares the levels below.
            likeliest = np.argpartition(-bounds, _PROBED_CELLS)[:_PROBED_CELLS]
            cells = parents[:, likeliest] + (1 << level >> 1)
            votes = _count(voters, certain, _centres_m(voters, cells, 0))
            cells_counted += _PROBED_CELLS
            if votes.max() > best:
                best, best_voxel = int(votes.max()), cells[:, votes.argmax()]
                survives = bounds >= rival_votes(best, rival_share)
                parents, bounds = parents[:, survives], bounds[survives]
        step = level if len(bounds) << (3 * level) <= _JUMP_CELLS else 1
        level -= step
    return _ranked(shells, certain, parents, bounds, best_voxel, rival_share, cells_counted, unsearched_bound)


def _split(
    voters: Voters, bands: Float32Array, parents: IntArray, level: int, step: int, required: int
) -> tuple[IntArray, IntArray]:
    """Cells (3, M) of `level` within parents (3, P) of level + step that can have `required` votes; bounds
    (M,).
    """
    offsets = (_OCTANTS if step == 1 else _cube(2**step)) << level
    cells_kept, bounds_kept = [parents[:, :0]], [np.empty(0, np.int64)]
    block = max(1, _BLOCK_CELLS // 8**step)
    for begin in range(0, parents.shape[1], block):
        cells = (parents[:, begin : begin + block, None] + offsets[:, None, :]).reshape(3, -1)
        counts = _count(voters, bands, _centres_m(voters, cells, level))
        survives = np.flatnonzero(counts >= required)
        cells_kept.append(cells[:, survives])
        bounds_kept.append(counts[survives])
    return np.concatenate(cells_kept, axis=1), np.concatenate(bounds_kept)


def _ranked(
    shells: Shells,
    certain: Float32Array,
    voxels: IntArray,
    bounds: IntArray,
    best_voxel: IntArray,
    rival_share: float,
    cells_counted: int,
    unsearched_bound: int,
) -> Found:
    """The surviving voxels (3, M) with their exact votes; where both float32 bounds agree, they are those."""
    votes = _count(shells.voters, certain, _centres_m(shells.voters, voxels, 0))
    unsure = np.flatnonzero(votes != bounds)
    votes[unsure] = _exact_count(shells, voxels[:, unsure])
    evaluations = (cells_counted + len(votes)) * len(shells.radii_m)
    if unsearched_bound:
        # The best voxel known may be in a cell that the budget left out.
        voxels = np.concatenate((voxels, best_voxel[:, None]), axis=1)
        votes = np.append(votes, _exact_count(shells, best_voxel[:, None]))
    rivals = votes >= rival_votes(int(votes.max()), rival_share)
    voxels, votes = voxels[:, rivals], votes[rivals]
    order = np.lexsort((*voxels[::-1], -votes))
    voxels, votes = voxels[:, order], votes[order]
    fresh = np.append(True, (voxels[:, 1:] != voxels[:, :-1]).any(axis=0))
    return Found(voxels[:, fresh].T + shells.voters.origin, votes[fresh], evaluations, unsearched_bound)
