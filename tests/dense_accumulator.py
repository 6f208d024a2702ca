"""The accumulator `page_runtime.scoring` must equal: every voxel of the grid, every point, in float64."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False, slots=True)
class DenseVotes:
    """max_votes; ties_camera (T, 3) m, all voxels with them in C order, so that the first is np.argmax;
    votes, the accumulator; first, the lattice index (3,) of its first voxel."""

    max_votes: int
    ties_camera: NDArray[np.float64]
    votes: NDArray[np.int64]
    first: NDArray[np.int64]


def dense_votes(
    points_camera: NDArray[np.floating],
    radii_m: NDArray[np.floating],
    voxel_m: float,
    *,
    rule: Literal["two-sided", "one-sided"] = "two-sided",
) -> DenseVotes:
    """Votes of one keypoint: points_camera (N, 3) m, radii_m (N,) m, both taken as float32.

    "two-sided" is Eq. 16, | |p - g| - r | <= eta; "one-sided" is line 8 of Algorithm 1, 0 < r - |p - g| <
    eta, kept to show its bias. The grid is the bounding box of the points padded by the largest radius and
    eta.
    """
    points = np.asarray(points_camera, np.float32).astype(np.float64)
    radii = np.asarray(radii_m, np.float32).astype(np.float64)
    tolerance_m = np.sqrt(3.0) * voxel_m
    padding = radii.max() + tolerance_m
    first = np.floor((points.min(axis=0) - padding) / voxel_m).astype(np.int64)
    last = np.ceil((points.max(axis=0) + padding) / voxel_m).astype(np.int64)
    x, y, z = (np.arange(a, b + 1) * voxel_m for a, b in zip(first, last, strict=True))
    votes = np.zeros((len(x), len(y), len(z)), np.int64)
    for point, radius in zip(points, radii, strict=True):
        dx, dy, dz = x - point[0], y - point[1], z - point[2]
        distance = np.sqrt((dx * dx)[:, None, None] + (dy * dy)[None, :, None] + (dz * dz)[None, None, :])
        if rule == "two-sided":
            votes += np.abs(distance - radius) <= tolerance_m
        else:
            votes += (radius - distance > 0.0) & (radius - distance < tolerance_m)
    ties = np.argwhere(votes == votes.max()) + first
    return DenseVotes(int(votes.max()), ties * voxel_m, votes, first)
