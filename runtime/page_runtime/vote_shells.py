"""The vote itself: which voxels a point votes for, counted in bulk with bounds that float32 cannot break.

A point p with radius r votes for a voxel with centre g when |p - g| - r lies between the two bounds of a `VoteRule`: g
is in a spherical shell. Thickened by w, the shell holds every cell centre within w of such a voxel. Membership is asked
without a root, as one small matrix product and one comparison of bits, in chunks that stay in the second-level cache.

Shapes: J keypoints, of one part or of many; C columns, one for each (keypoint, point), those of a keypoint in B blocks
of at most 255, whose votes fit a byte. Lengths in metres; positions are counted from the voxel `origin` of the
keypoint's part, since float32 cannot resolve a voxel far from zero.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]

# More and smaller blocks drop a cell sooner, but cost calls: of 1024, 512 and 292 voters, 6, 4 and 3 blocks took least
# time; 6 of 512 take a tenth fewer evaluations in the same time.
_MAX_BLOCKS = 6
_BLOCK_VOTERS = 100
_CHUNK_EVALUATIONS = 100_000
# |d^2 - m| <= t is asked as 0 <= (d^2 - m) / t + 1 <= 2, and that of the float's bits by one unsigned comparison:
# negative numbers and NaN have larger bits than 2.0.
_BITS_OF_TWO = np.float32(2.0).view(np.uint32)


@dataclass(frozen=True, slots=True)
class VoteRule:
    """A vote is cast where |p - g| - r is between lowest_etas and highest_etas, in eta = sqrt(3) voxels; `closed`
    counts the bounds themselves.
    """

    lowest_etas: float
    highest_etas: float
    closed: bool

    def __post_init__(self) -> None:
        if not -100.0 <= self.lowest_etas < self.highest_etas <= 100.0:
            raise ValueError(
                "VoteRule: expected lowest_etas < highest_etas, both within 100 of zero, got "
                f"{self.lowest_etas} and {self.highest_etas}; TWO_SIDED and ONE_SIDED are the paper's"
            )

    def bounds_m(self, voxel_m: float) -> tuple[float, float]:
        """Closed bounds of |p - g| - r in metres for voxels of voxel_m."""
        eta_m = math.sqrt(3.0) * voxel_m
        lowest, highest = self.lowest_etas * eta_m, self.highest_etas * eta_m
        if self.closed:
            return lowest, highest
        return _next_number(lowest, math.inf), _next_number(highest, -math.inf)


def _next_number(value: float, towards: float) -> float:
    # No difference of float64 lengths is closer to zero, and denormals may be flushed to it.
    return math.copysign(float(np.finfo(np.float64).tiny), towards) if value == 0.0 else math.nextafter(value, towards)


TWO_SIDED = VoteRule(-1.0, 1.0, closed=True)
"""Eq. 16: | |p - g| - r | <= eta."""

ONE_SIDED = VoteRule(-1.0, 0.0, closed=False)
"""Algorithm 1, line 8: 0 < r - |p - g| < eta."""


@dataclass(frozen=True, eq=False, slots=True)
class Shells:
    """The shells of J keypoints, keypoint after keypoint.

    starts: J + 1 first columns. keypoints: 0 to J. runs: bounds of the runs of keypoints of one width. widths: (J,)
    columns of a block; num_voters: (J,) points of the part, without the columns that fill the last block. owner: (C,)
    keypoint of a column. points: (3, C) m camera. radii_m: (C,), inf where a point does not vote. origin: (3, J) voxel
    near the points. lift: (4, C), (1, -2 p); norm2: (C,) m^2 and norm: (C,) m of p, counted from the origin. values,
    inside: scratch of the kernel, allocated once as fresh pages cost more than the arithmetic done in them.
    """

    rule: VoteRule
    voxel_m: float
    num_blocks: int
    starts: list[int]
    keypoints: NDArray[np.intp]
    runs: list[int]
    widths: IntArray
    num_voters: IntArray
    owner: NDArray[np.intp]
    points: FloatArray
    radii_m: FloatArray
    origin: IntArray
    lift: FloatArray
    norm2: FloatArray
    norm: FloatArray
    values: Float32Array
    inside: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.widths)

    @property
    def half_diagonal_m(self) -> float:
        return 0.5 * math.sqrt(3.0) * self.voxel_m

    def columns(self, keypoint: int) -> slice:
        return slice(self.starts[keypoint], self.starts[keypoint + 1])


def shells_from(parts: Sequence[tuple[FloatArray, FloatArray]], voxel_m: float, rule: VoteRule) -> Shells:
    """Lay out parts, each of points (N, 3) m, finite, N >= 1, and radii (n, N) m, inf where a point does not vote."""
    most = max(len(points) for points, _ in parts)
    num_blocks = max(-(-most // 255), min(_MAX_BLOCKS, -(-most // _BLOCK_VOTERS)))
    widths, num_voters, points_of, relative_of, radii_of, origin_of = [], [], [], [], [], []
    for points, radii_m in parts:
        width = -(-len(points) // num_blocks)
        origin = np.rint(points.mean(axis=0) / voxel_m).astype(np.int64)
        relative = points - origin * voxel_m
        # Points far out see a displaced cell from the most different directions, so they drop it soonest.
        order = np.argsort(-np.einsum("nk,nk->n", relative, relative), kind="stable")
        filled = np.concatenate((order, np.repeat(order[:1], width * num_blocks - len(order))))
        radii_m = radii_m[:, filled]
        radii_m[:, len(order) :] = np.inf
        copies = len(radii_m)
        widths += [width] * copies
        num_voters += [len(points)] * copies
        points_of.append(np.tile(points[filled].T, copies))
        relative_of.append(np.tile(relative[filled].T, copies))
        radii_of.append(radii_m.ravel())
        origin_of += [origin] * copies
    relative = np.concatenate(relative_of, axis=1)
    norm2 = np.einsum("kc,kc->c", relative, relative)
    sizes = np.array(widths) * num_blocks
    values = np.empty(max(_CHUNK_EVALUATIONS, 16 * max(widths)), np.float32)
    return Shells(
        rule,
        voxel_m,
        num_blocks,
        [0, *np.cumsum(sizes).tolist()],
        np.arange(len(widths) + 1),
        [0, *(np.flatnonzero(np.diff(widths)) + 1).tolist(), len(widths)],
        np.array(widths),
        np.array(num_voters),
        np.repeat(np.arange(len(sizes)), sizes),
        np.concatenate(points_of, axis=1),
        np.concatenate(radii_of),
        np.array(origin_of).T,
        np.concatenate((np.ones((1, len(norm2))), -2.0 * relative)),
        norm2,
        np.sqrt(norm2),
        values,
        np.empty(len(values), np.bool_),
    )


def bands(shells: Shells, thickness_m: float, reach_m: FloatArray, *, at_least: bool) -> Float32Array:
    """(5, C): column times (|g|^2, g, 1) is in [0, 2] if g is within the thickness of the column's shell.

    With lo = max(r + lowest - w, 0)^2, hi = (r + highest + w)^2, m and t their mean and half difference:
    |d^2 - m| <= t, no root. at_least thickens the bands by the float32 rounding error of positions up to reach_m (J,)
    from the origin, so that no vote is missed; otherwise they are thinned so that none is invented. The error of the
    five products and their sum is below 8 x 2^-24 of the sum of their magnitudes; 12 leave a margin, also for float64
    in the formula.
    """
    lowest_m, highest_m = shells.rule.bounds_m(shells.voxel_m)
    votes = np.isfinite(shells.radii_m)
    radii_m = np.where(votes, shells.radii_m, 0.0)
    outer = np.maximum(radii_m + (highest_m + thickness_m), 0.0)
    inner = np.maximum(radii_m + (lowest_m - thickness_m), 0.0)
    outer *= outer
    inner *= inner
    # |g|^2 + 2 |g||p| + |p|^2 + m + t, where m + t = hi.
    slack = 12.0 * 2.0**-24 * ((reach_m[shells.owner] + shells.norm) ** 2 + outer) + 1e-15
    half = 0.5 * (outer - inner) + (slack if at_least else -slack)
    votes &= half > 0.0
    inverse = votes / np.where(votes, half, 1.0)
    bands = np.empty((5, len(radii_m)), np.float32)
    np.multiply(shells.lift, inverse, out=bands[:4], casting="same_kind")
    bands[4] = (shells.norm2 - 0.5 * (outer + inner)) * inverse + (2.0 * votes - 1.0)
    return bands


def lifted(shells: Shells, corners: IntArray, level: int) -> Float32Array:
    """(5, M), (|g|^2, g, 1): g the centres of cells of 2^level voxels a side, from their first voxels (3, M)."""
    centres_m = (corners + 0.5 * (2**level - 1)) * shells.voxel_m
    result = np.empty((5, corners.shape[1]), np.float32)
    result[0] = np.einsum("km,km->m", centres_m, centres_m)
    result[1:4] = centres_m
    result[4] = 1.0
    return result


def count_blocks(
    shells: Shells, bands: Float32Array, blocks: range, centres: Float32Array, edges: Sequence[int]
) -> ByteArray:
    """(M,) shells of some blocks, together at most 255 voters, that each of the `lifted` centres (5, M) lies in; edges:
    J + 1 bounds of the keypoints' own centres.
    """
    counts = np.empty(centres.shape[1], np.uint8)
    for first, last in pairwise(shells.runs):
        width = int(shells.widths[first])
        voters = width * len(blocks)
        step = len(shells.values) // voters
        for at in range(edges[first], edges[last], step):
            end = min(at + step, edges[last])
            used, shape = voters * (end - at), (voters, end - at)
            values, inside = shells.values[:used].reshape(shape), shells.inside[:used].reshape(shape)
            # A product for each keypoint, but one comparison and one sum for all of a chunk.
            for keypoint in range(bisect_right(edges, at) - 1, bisect_left(edges, end)):
                begin, stop = max(edges[keypoint], at), min(edges[keypoint + 1], end)
                if begin < stop:
                    column = shells.starts[keypoint] + blocks.start * width
                    columns = bands[:, column : column + voters].T
                    np.matmul(columns, centres[:, begin:stop], out=values[:, begin - at : stop - at])
            np.less_equal(values.view(np.uint32), _BITS_OF_TWO, out=inside)
            np.add.reduce(inside.view(np.uint8), axis=0, dtype=np.uint8, out=counts[at:end])
    return counts


def count(shells: Shells, bands: Float32Array, centres: Float32Array, owner: NDArray[np.intp]) -> IntArray:
    """(M,) shells that each of the `lifted` centres (5, M) of the keypoints `owner` (M,), ascending, lies in."""
    edges = keypoint_edges(shells, owner).tolist()
    counts = np.zeros(centres.shape[1], np.int64)
    step = 255 // int(shells.widths.max())
    for first in range(0, shells.num_blocks, step):
        counts += count_blocks(shells, bands, range(first, min(first + step, shells.num_blocks)), centres, edges)
    return counts


def keypoint_edges(shells: Shells, owner: NDArray[np.intp]) -> NDArray[np.intp]:
    """(J + 1,) bounds of the runs of each keypoint in ascending `owner`."""
    return owner.searchsorted(shells.keypoints)


def exact_counts(shells: Shells, voxels: IntArray, owner: NDArray[np.intp]) -> Iterator[tuple[slice, NDArray[np.intp]]]:
    """Votes of voxels (3, M), counted from the origins of their keypoints `owner` (M,), ascending, by the defining
    formula in float64; in slices, that a caller may stop.
    """
    lowest_m, highest_m = shells.rule.bounds_m(shells.voxel_m)
    edges = keypoint_edges(shells, owner)
    for keypoint in np.flatnonzero(edges[1:] > edges[:-1]).tolist():
        columns = shells.columns(keypoint)
        points, radii_m = shells.points[:, columns], shells.radii_m[columns]
        centres = (voxels[:, edges[keypoint] : edges[keypoint + 1]] + shells.origin[:, keypoint, None]) * shells.voxel_m
        step = max(1, _CHUNK_EVALUATIONS // (4 * len(radii_m)))
        for begin in range(0, centres.shape[1], step):
            x, y, z = (centres[k, begin : begin + step, None] - points[k] for k in range(3))
            offset = np.sqrt(x * x + y * y + z * z) - radii_m
            votes = np.count_nonzero((offset >= lowest_m) & (offset <= highest_m), axis=1)
            first = int(edges[keypoint]) + begin
            yield slice(first, first + len(votes)), votes


def exact_count(shells: Shells, voxels: IntArray, owner: NDArray[np.intp]) -> IntArray:
    """(M,) votes, all of `exact_counts`."""
    counts = np.empty(voxels.shape[1], np.int64)
    for where, votes in exact_counts(shells, voxels, owner):
        counts[where] = votes
    return counts


def pigeonhole_box(shells: Shells, keypoint: int, votes: int) -> tuple[IntArray, IntArray]:
    """First and last voxel (3,), from the origin, of all with `votes`: so many shells span it on each axis."""
    columns = shells.columns(keypoint)
    voting = np.isfinite(shells.radii_m[columns])
    relative = -0.5 * shells.lift[1:, columns][:, voting]
    reach = shells.radii_m[columns][voting] + shells.rule.bounds_m(shells.voxel_m)[1]
    low = np.partition(relative - reach, votes - 1, axis=1)[:, votes - 1]
    high = np.partition(relative + reach, len(reach) - votes, axis=1)[:, len(reach) - votes]
    # A thousandth of a voxel covers the rounding of these sums.
    first = np.ceil(low / shells.voxel_m - 1e-3).astype(np.int64)
    return first, np.maximum(first, np.floor(high / shells.voxel_m + 1e-3).astype(np.int64))
