"""The neighbour search of the point branch: one implementation, used in training and on the device alike.

Levels are prefixes of the progressive point order (sampling.py), each a quarter of the one before. N, the first one's
size, is the bundle's: 2,048 in those that are shipped.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

GROUP_SIZE = 16
INTERPOLATION_SIZE = 3
# The third level's neighbourhoods take that many of the second one's points.
MIN_POINTS = 16 * GROUP_SIZE
# Distances in work at a time: half a megabyte, of which a core's second cache holds all that is made of it. Twice as
# many took an eighth longer.
_BLOCK = 1 << 17
# So few of so many points are found faster by as many minima than by a partition.
_FEW, _MANY = 4, 256


def levels_of(num_points: int) -> tuple[int, int, int, int]:
    """The sizes of the four levels; ValueError where N points cannot be divided so."""
    if num_points < MIN_POINTS or num_points % 64:
        raise ValueError(f"num_points: expected a multiple of 64 from {MIN_POINTS} on, got {num_points}")
    return num_points, num_points // 4, num_points // 16, num_points // 64


def answered_of(num_points: int) -> int:
    """Points the network answers for, the first ones: a pose from the radii of 1,024 is as good as from those of all
    2,048, and the layers that look at single points cost half."""
    return num_points // 2


LEVELS = levels_of(2048)
ANSWERED = answered_of(LEVELS[0])


@dataclass(frozen=True, eq=False, slots=True)
class Neighbours:
    """Indices into the finer (group) or the coarser (up) level, int32. Of N = 2048 points:

    group1 (512,16) into 2048, group2 (128,16) into 512, group3 (32,16) into 128;
    up1 (A,3) into 512 of the first A points, up2 (512,3) into 128, up3 (128,3) into 32.
    """

    group1: NDArray[np.int32]
    group2: NDArray[np.int32]
    group3: NDArray[np.int32]
    up1: NDArray[np.int32]
    up2: NDArray[np.int32]
    up3: NDArray[np.int32]


def nearest(queries: NDArray[np.float32], points: NDArray[np.float32], count: int) -> NDArray[np.int32]:
    """Indices (Q, count) int32 of the `count` points (P,3) nearest to each query (Q,3), in no particular order.

    Squared distances are floats, whose bit patterns order like integers: the index goes into their low bits and one
    integer partition does what an argpartition takes twice as long for. Distances equal to within 2^-12 of their value
    count as ties, which go to the lower index; what is left of a distance of 0 may be negative, and comes first.
    """
    search = _Search.of(_as_queries(queries), _as_points(points), count)
    _work_off(deque(search.blocks()))
    return search.found


def _as_points(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """(5,P): x, y, z, 1 and x^2 + y^2 + z^2."""
    lifted = np.empty((5, len(points)), np.float32)
    lifted[:3] = points.T
    lifted[3] = 1.0
    np.einsum("ij,ij->j", lifted[:3], lifted[:3], out=lifted[4])
    return lifted


def _as_queries(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """(P,5), whose product with `_as_points` of others is the squared distances: -2ab + |a|^2 + |b|^2."""
    lifted = _as_points(points)[[0, 1, 2, 4, 3]]
    lifted[:3] *= np.float32(-2.0)
    return lifted.T


@dataclass(frozen=True, eq=False, slots=True)
class _Search:
    """One table in the making: of lifted queries (Q,5) in lifted points (5,P)."""

    queries: NDArray[np.float32]
    points: NDArray[np.float32]
    index: NDArray[np.int32]
    found: NDArray[np.int32]

    @staticmethod
    def of(queries: NDArray[np.float32], points: NDArray[np.float32], count: int) -> _Search:
        index = np.arange(points.shape[1], dtype=np.int32)
        return _Search(queries, points, index, np.empty((len(queries), count), np.int32))

    def blocks(self) -> Iterator[_Block]:
        """The queries in pieces, each to be done once, in any order, by any thread."""
        size = max(_BLOCK // len(self.index), 1)
        return ((self, slice(begin, begin + size)) for begin in range(0, len(self.queries), size))

    def do(self, rows: slice, room: NDArray[np.float32]) -> None:
        """Fill some rows of `found`; room: for all their distances."""
        queries, count = self.queries[rows], self.found.shape[1]
        distances = room[: len(queries) * len(self.index)].reshape(len(queries), len(self.index))
        np.matmul(queries, self.points, out=distances)
        mask = np.int32((1 << max(len(self.index) - 1, 1).bit_length()) - 1)
        keys = distances.view(np.int32)
        keys &= ~mask
        keys |= self.index
        smallest = _least if count <= _FEW and len(self.index) > _MANY else _partitioned
        np.bitwise_and(smallest(keys, count, mask), mask, out=self.found[rows])


_Block = tuple[_Search, slice]


def _work_off(blocks: deque[_Block]) -> None:
    """Do all blocks that nobody has taken yet."""
    room = np.empty(_BLOCK, np.float32)
    while True:
        try:
            search, rows = blocks.popleft()
        except IndexError:
            return
        if room.size < len(search.index):
            room = np.empty(len(search.index), np.float32)
        search.do(rows, room)


def _partitioned(keys: NDArray[np.int32], count: int, _: np.int32) -> NDArray[np.int32]:
    keys.partition(count - 1, axis=1)
    return keys[:, :count]


def _least(keys: NDArray[np.int32], count: int, mask: np.int32) -> NDArray[np.int32]:
    """The same, smallest first: one minimum after the other, each taken out before the next."""
    found = np.empty((len(keys), count), np.int32)
    rows = np.arange(len(keys))
    for nth in range(count):
        found[:, nth] = keys.min(axis=1)
        keys[rows, found[:, nth] & mask] = np.iinfo(np.int32).max
    return found


def find_neighbours(
    points: NDArray[np.float32], *, answered: int | None = None, beside: Executor | None = None
) -> Neighbours:
    """Neighbour tables of points (N,3) in progressive order; centre the points first for precision.

    answered: points at the start that get a row of up1, None for `answered_of` N. beside: a thread that takes a share
    of the work, as much as it gets done; where it comes late it delays nothing.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points: expected (N, 3), got {points.shape}")
    levels = levels_of(len(points))
    answered = answered_of(len(points)) if answered is None else answered
    asked, known = _as_queries(points), _as_points(points)
    groups = [_Search.of(asked[:coarse], known[:, :fine], GROUP_SIZE) for fine, coarse in pairwise(levels)]
    ups = [
        _Search.of(asked[:fine], known[:, :coarse], INTERPOLATION_SIZE)
        for fine, coarse in zip((answered, *levels[1:-1]), levels[1:], strict=True)
    ]
    blocks = deque(block for search in (*groups, *ups) for block in search.blocks())
    helping = None if beside is None else beside.submit(_work_off, blocks)
    _work_off(blocks)
    if helping is not None and not helping.cancel():
        helping.result()
    return Neighbours(*(search.found for search in (*groups, *ups)))
