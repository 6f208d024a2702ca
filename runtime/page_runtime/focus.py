"""Objects that fill little of their region, looked at twice: the second time all points are taken where they were seen.

Of a pair of eyeglasses in its box two points in a hundred are on a temple, too few to vote; which points those are the
network tells well. A category says itself whether its objects are so (`Category.focused`), and its network learns from
samples of both kinds.
"""

from __future__ import annotations

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
    """Where an object was seen. pixels: (n,2) columns and rows of the frame. reach_px: how far around them to look."""

    pixels: NDArray[np.float32]
    reach_px: float

    def covers(self, square: tuple[int, int, int, int], grid: int) -> NDArray[np.bool_]:
        """(grid,grid) which cells of the square (x, y, side, side) px lie within reach."""
        x, y, side, _ = square
        cells = np.floor((self.pixels - np.array([x, y], np.float32)) * np.float32(grid / side)).astype(np.intp)
        cells = cells[((cells >= 0) & (cells < grid)).all(axis=1)]
        if not len(cells):
            return np.zeros((grid, grid), np.bool_)
        free = np.ones((grid, grid), np.uint8)
        free[cells[:, 1], cells[:, 0]] = 0
        return np.asarray(
            cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) <= self.reach_px * grid / side
        )


def focus_on(pixels: NDArray[np.float32], side_px: int) -> Focus | None:
    """On points that were seen at these pixels (n,2) of the frame, in a square region of this side; None where they
    are too few."""
    return Focus(pixels, REACH * side_px) if len(pixels) >= FEWEST else None
