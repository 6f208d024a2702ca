"""The accumulators that numba compiles, on one thread. The only module that imports it: a benchmark's dependency."""

import math

import numpy as np
from benchmarks.accumulators import Grid
from numba import njit  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray


def algorithm_1_votes(
    points: NDArray[np.floating], radii_m: NDArray[np.floating], grid: Grid, *, one_sided: bool = True
) -> NDArray[np.int32]:
    """Votes of every voxel by the paper's Algorithm 1 as it reads: for each voxel a float64 loop over the points.

    Line 8 of it, 0 < r - d < eta, or Eq. 16, |d - r| <= eta, where not one_sided.
    """
    x, y, z = (np.ascontiguousarray(points[:, k], np.float64) for k in range(3))
    return _algorithm_1(
        x, y, z, radii_m.astype(np.float64), grid.tolerance_m, grid.voxel_m, grid.first, grid.shape, one_sided
    )


def lifted_votes(points: NDArray[np.floating], radii_m: NDArray[np.floating], grid: Grid) -> NDArray[np.int32]:
    """Votes of Eq. 16 by the fastest exhaustive loop known to us: float32, no root, voxels of a row side by side."""
    radii, origin_m = radii_m.astype(np.float64), grid.first * grid.voxel_m
    relative = (points.astype(np.float64) - origin_m).astype(np.float32)
    low = np.where(radii > grid.tolerance_m, (radii - grid.tolerance_m) ** 2, -1.0).astype(np.float32)
    high = ((radii + grid.tolerance_m) ** 2).astype(np.float32)
    return _lifted(relative, low, high, np.float32(grid.voxel_m), grid.shape)


@njit(cache=True, nogil=True)
def _algorithm_1(x, y, z, radii, tolerance_m, voxel_m, first, shape, one_sided):
    votes = np.zeros(shape, np.int32)
    for i in range(shape[0]):
        for j in range(shape[1]):
            for k in range(shape[2]):
                gx, gy, gz = (first[0] + i) * voxel_m, (first[1] + j) * voxel_m, (first[2] + k) * voxel_m
                count = 0
                for n in range(len(radii)):
                    dx, dy, dz = gx - x[n], gy - y[n], gz - z[n]
                    difference = radii[n] - math.sqrt(dx * dx + dy * dy + dz * dz)
                    if one_sided:
                        count += (difference > 0.0) & (difference < tolerance_m)
                    else:
                        count += abs(difference) <= tolerance_m
                votes[i, j, k] = count
    return votes


@njit(cache=True, nogil=True)
def _lifted(relative, low, high, voxel_m, shape):
    votes = np.zeros(shape, np.int32)
    heights = np.arange(shape[2]).astype(np.float32) * voxel_m
    for i in range(shape[0]):
        for j in range(shape[1]):
            row = votes[i, j]
            for n in range(len(low)):
                dx = np.float32(i) * voxel_m - relative[n, 0]
                dy = np.float32(j) * voxel_m - relative[n, 1]
                across, z = dx * dx + dy * dy, relative[n, 2]
                below, above = low[n] - across, high[n] - across
                for k in range(len(row)):
                    dz = heights[k] - z
                    square = dz * dz
                    row[k] += (square >= below) & (square <= above)
    return votes
