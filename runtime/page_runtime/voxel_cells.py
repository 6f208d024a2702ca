"""Cubes of voxels that `branch_and_bound` keeps, drops and splits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.vote_shells import ByteArray, IntArray, Shells

_START_CELLS = 400


@dataclass(frozen=True, eq=False, slots=True)
class Cells:
    """Cells of one level, keypoint after keypoint.

    corners: (3, M) first voxels from the origin; owner: (M,) keypoint, ascending; bounds: (M,) no voxel within has more
    votes; tallies: (B, M) its bound on the votes of each block of voters.
    """

    corners: IntArray
    owner: NDArray[np.intp]
    bounds: IntArray
    tallies: ByteArray

    def __len__(self) -> int:
        return len(self.owner)

    def __getitem__(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> "Cells":
        return Cells(self.corners[:, rows], self.owner[rows], self.bounds[rows], self.tallies[:, rows])


def cube(side: int) -> IntArray:
    """(3, side^3) lattice offsets of a cube, C order."""
    return np.indices((side, side, side), dtype=np.int64).reshape(3, -1)


_OCTANTS = cube(2)


def start_levels(extents: IntArray) -> IntArray:
    """(J,): the finest that covers a box of extents (3, J) voxels with _START_CELLS or fewer."""
    levels = np.zeros(extents.shape[1], np.int64)
    while True:
        # In float64, where a count of cells cannot wrap around.
        many = np.prod((-(-extents >> levels)).astype(np.float64), axis=0) > _START_CELLS
        if not many.any():
            return levels
        levels += many


def no_cells(shells: Shells) -> Cells:
    nothing = np.empty(0, np.int64)
    return Cells(np.empty((3, 0), np.int64), nothing, nothing, np.empty((shells.num_blocks, 0), np.uint8))


def joined(shells: Shells, pieces: Sequence[Cells]) -> Cells:
    """One, in the order of their keypoints."""
    if len(pieces) < 2:
        return pieces[0] if pieces else no_cells(shells)
    owner = np.concatenate([piece.owner for piece in pieces])
    joined = Cells(
        np.concatenate([piece.corners for piece in pieces], axis=1),
        owner,
        np.concatenate([piece.bounds for piece in pieces]),
        np.concatenate([piece.tallies for piece in pieces], axis=1),
    )
    return joined if (owner[1:] >= owner[:-1]).all() else joined[np.argsort(owner, kind="stable")]


def roots(shells: Shells, first: IntArray, last: IntArray, keypoints: IntArray, level: int) -> Cells:
    """The cells of `level` that cover, for each of these keypoints, its box from first to last (3, J)."""
    pieces = []
    for j in keypoints.tolist():
        corners = np.indices((-(-(last - first + 1)[:, j] >> level)).tolist(), dtype=np.int64).reshape(3, -1)
        voting = np.isfinite(shells.radii_m[shells.columns(j)]).reshape(shells.num_blocks, -1)
        tallies = np.repeat(np.count_nonzero(voting, axis=1).astype(np.uint8)[:, None], corners.shape[1], axis=1)
        owner = np.full(corners.shape[1], j)
        pieces.append(Cells((corners << level) + first[:, j, None], owner, np.full(len(owner), voting.sum()), tallies))
    return joined(shells, pieces)


def split(parents: Cells, level: int) -> Cells:
    """The eight cells of `level` within each, with their parent's bounds."""
    corners = (parents.corners[:, :, None] + (_OCTANTS << level)[:, None, :]).reshape(3, -1)
    return Cells(
        corners, np.repeat(parents.owner, 8), np.repeat(parents.bounds, 8), np.repeat(parents.tallies, 8, axis=1)
    )
