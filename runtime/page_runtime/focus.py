"""Objects that fill little of their region, looked at twice: the second time all points are taken where they were seen.

Of a pair of eyeglasses in its box two points in a hundred are on a temple, too few to vote; which points those are the
network tells well. A category says itself whether its objects are so (`Category.focused`), and its network learns from
samples of both kinds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

# How far around a point that was seen points are taken again, in sides of the region: one and a half times as far as
# the points that the network answers for are apart, so that nothing falls between them and some of what is around the
# object stays.
REACH = 1.5 / 32
# Fewer points of an object are none.
FEWEST = 6


@dataclass(frozen=True, eq=False, slots=True)
class Focus:
    """Where an object was seen. pixels: (n,2) columns and rows of the frame. parts: (n,) which part each is of.
    reach_px: how far around them to look."""

    pixels: NDArray[np.float32]
    parts: NDArray[np.intp]
    reach_px: float

    def in_order(self, cells: NDArray[np.intp], square: tuple[int, int, int, int], grid: int) -> NDArray[np.intp]:
        """Cells of a grid x grid lattice over the square (x, y, side, side) px, flat indices in the order of points:
        those within reach first, then the others, each kind in the order given.

        The first are dealt out among the parts, each in its own order, by the square root of what there is of them, so
        that a knuckle gets more points than its share and an arm's tube still most.
        """
        away_px, part = self._nearest(square, grid)
        within = away_px[cells] <= self.reach_px
        near, others = cells[within], cells[~within]
        turn, part = np.empty(len(near)), part[near]
        for k in range(int(self.parts.max(initial=-1)) + 1):
            own = np.flatnonzero(part == k)
            turn[own] = (np.arange(len(own)) + 0.5) / np.sqrt(len(own))
        return np.concatenate([near[np.argsort(turn, kind="stable")], others])

    def _nearest(self, square: tuple[int, int, int, int], grid: int) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        """For each cell how far the nearest point that was seen is, px, and which part that is of."""
        x, y, side, _ = square
        cells = np.floor((self.pixels + 0.5 - np.array([x, y])) * (grid / side)).astype(np.intp)
        inside = ((cells >= 0) & (cells < grid)).all(axis=1)
        if not inside.any():
            return np.full(grid * grid, np.inf, np.float32), np.zeros(grid * grid, np.intp)
        columns, rows = cells[inside].T
        free = np.ones((grid, grid), np.uint8)
        free[rows, columns] = 0
        away, name = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL)
        name = np.asarray(name, np.intp)
        part_of = np.zeros(int(name.max()) + 1, np.intp)
        part_of[name[rows, columns]] = self.parts[inside]
        return np.asarray(away.ravel() * (side / grid), np.float32), part_of[name.ravel()]


def focus_on(pixels: Sequence[NDArray[np.float32]], side_px: int) -> Focus | None:
    """On the points of each part that were seen, at these pixels (n,2) of the frame, in a square region of this side;
    None where they are too few."""
    parts = np.repeat(np.arange(len(pixels)), [len(own) for own in pixels])
    return Focus(np.concatenate(pixels), parts, REACH * side_px) if len(parts) >= FEWEST else None
