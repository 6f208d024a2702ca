"""Accumulators that visit every voxel, to compare `page_runtime.scoring` with.

Both peers count a slab of the grid, as their cost is the same for every voxel: `gemm_votes` here is numpy's best,
`compiled.py` has the paper's Algorithm 1 in numba. The float64 reference that decides equality is
`tests/dense_accumulator.py`.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_CHUNK_EVALUATIONS = 160_000
# 0 <= value <= 2 asked of the float's bits: negative numbers have larger bits than 2.0.
_BITS_OF_TWO = np.float32(2.0).view(np.uint32)


@dataclass(frozen=True, eq=False, slots=True)
class Grid:
    """Voxels with centres voxel_m * (first + index), index below `shape` on each of three axes."""

    first: IntArray
    shape: tuple[int, int, int]
    voxel_m: float

    @property
    def voxels(self) -> int:
        return math.prod(self.shape)

    @property
    def tolerance_m(self) -> float:
        """eta of Eq. 16."""
        return math.sqrt(3.0) * self.voxel_m

    def centres_m(self) -> FloatArray:
        """(voxels, 3) m, C order."""
        indices = np.indices(self.shape, dtype=np.int64).reshape(3, -1).T + self.first
        return np.multiply(indices, self.voxel_m, dtype=np.float64)

    def slabs(self, voxels: int) -> Iterator["Grid"]:
        """The grid in pieces of whole planes, or where a plane is larger of whole rows, of about so many voxels."""
        nx, ny, nz = self.shape
        planes = max(1, voxels // (ny * nz))
        rows = ny if planes > 1 or voxels >= ny * nz else max(1, voxels // nz)
        for x in range(0, nx, planes):
            for y in range(0, ny, rows):
                shape = (min(planes, nx - x), min(rows, ny - y), nz)
                yield Grid(self.first + np.array([x, y, 0]), shape, self.voxel_m)

    def middle_slab(self, voxels: int) -> "Grid":
        """One such piece from the middle."""
        nx, ny, nz = self.shape
        planes = min(nx, max(1, voxels // (ny * nz)))
        rows = ny if voxels >= ny * nz else max(1, voxels // nz)
        start = np.array([(nx - planes) // 2, (ny - rows) // 2, 0])
        return Grid(self.first + start, (planes, rows, nz), self.voxel_m)


def grid_around(points: NDArray[np.floating], radii_m: NDArray[np.floating], voxel_m: float) -> Grid:
    """The box of the points padded by the largest radius and eta: outside of it no point votes."""
    points = points.astype(np.float64)
    padding_m = float(radii_m.max()) + math.sqrt(3.0) * voxel_m
    first = np.floor((points.min(axis=0) - padding_m) / voxel_m).astype(np.int64)
    last = np.ceil((points.max(axis=0) + padding_m) / voxel_m).astype(np.int64)
    nx, ny, nz = (int(size) for size in last - first + 1)
    return Grid(first, (nx, ny, nz), voxel_m)


def gemm_votes(points: NDArray[np.floating], radii_m: NDArray[np.floating], grid: Grid) -> NDArray[np.int32]:
    """Votes of Eq. 16 (two-sided) of every voxel, shape grid.shape, in float32.

    |d - r| <= eta is |d^2 - m| <= t with m, t the mean and half difference of (r -+ eta)^2, and d^2 a product of
    (1, -2p, |p|^2) and (|g|^2, g, 1): one matrix product, one comparison and one sum for each chunk that fits the
    second-level cache. Votes differ from float64's where a voxel lies within 1e-6 m of the edge of a shell.
    """
    points, radii = points.astype(np.float64), radii_m.astype(np.float64)
    origin = points.mean(axis=0)
    relative = points - origin
    count = len(points)
    groups = -(-count // 255)
    padded = groups * -(-count // groups)
    high = (radii + grid.tolerance_m) ** 2
    low = np.maximum(radii - grid.tolerance_m, 0.0) ** 2
    inverse = 2.0 / (high - low)
    shells = np.zeros((padded, 5), np.float32)
    shells[:, 4] = -1.0
    shells[:count, 0] = inverse
    shells[:count, 1:4] = -2.0 * relative * inverse[:, None]
    shells[:count, 4] = (np.einsum("nk,nk->n", relative, relative) - 0.5 * (high + low)) * inverse + 1.0
    width = max(16, _CHUNK_EVALUATIONS // padded)
    values, inside = np.empty((padded, width), np.float32), np.empty((padded, width), np.bool_)
    votes = np.empty(grid.voxels, np.int32)
    centres = grid.centres_m() - origin
    lifted = np.empty((5, len(centres)), np.float32)
    lifted[0] = np.einsum("mk,mk->m", centres, centres)
    lifted[1:4] = centres.T
    lifted[4] = 1.0
    for begin in range(0, len(votes), width):
        part = lifted[:, begin : begin + width]
        size = part.shape[1]
        np.matmul(shells, part, out=values[:, :size])
        np.less_equal(values.view(np.uint32), _BITS_OF_TWO, out=inside)
        grouped = inside[:, :size].view(np.uint8).reshape(groups, -1, size)
        np.add.reduce(np.add.reduce(grouped, axis=1, dtype=np.uint8), axis=0, out=votes[begin : begin + size])
    return votes.reshape(grid.shape)


def maximum(votes_of: Callable[[Grid], NDArray[np.int32]], grid: Grid, slab_voxels: int) -> tuple[int, FloatArray]:
    """Most votes of the whole grid and the centre (3,) m of the first voxel that has them (C order)."""
    best, at = -1, grid.first
    for slab in grid.slabs(slab_voxels):
        votes = votes_of(slab)
        if votes.max() > best:
            best = int(votes.max())
            at = slab.first + np.unravel_index(int(votes.argmax()), slab.shape)
    return best, np.multiply(at, grid.voxel_m, dtype=np.float64)
