"""Problems for the scorer that several tests share."""

from typing import Literal

import numpy as np
import pytest

from page_runtime.multilateration import principal_axes
from page_runtime.scoring import ONE_SIDED, TWO_SIDED, VoteRule
from synthetic_parts import (
    SyntheticPart,
    box_extents_m,
    keypoints_around,
    random_rotation,
    seen_part,
)

RuleName = Literal["two-sided", "one-sided"]

RULES: dict[RuleName, VoteRule] = {"two-sided": TWO_SIDED, "one-sided": ONE_SIDED}

EACH_RULE = pytest.mark.parametrize("rule", list(RULES))


def small_problem(seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Points (N, 3), radii (N,) and a voxel whose dense grid is small; a quarter each without outliers and
    with 15, 40 and 60 %, flat and solid clouds, noise from nothing to two voxels, half with a correlated
    error."""
    rng = np.random.default_rng(seed)
    num_points, voxel_m = int(rng.integers(4, 120)), float(rng.choice([0.005, 0.007, 0.02]))
    half_extents = rng.uniform(2.0, 7.0) * np.array([1.0, rng.uniform(0.2, 1.0), rng.choice([0.0, 0.3, 1.0])])
    points = voxel_m * rng.uniform(-half_extents, half_extents, (num_points, 3)) @ random_rotation(rng).T
    keypoint = rng.normal(size=3) * 5.0 * voxel_m
    radii = np.linalg.norm(points - keypoint, axis=1) + rng.choice([0.0, 0.2, 0.6, 2.0]) * voxel_m * rng.normal(
        size=num_points
    )
    radii += rng.choice([0.0, 1.0]) * voxel_m * np.sin(points @ rng.normal(size=3) / voxel_m / 3.0)
    outlier = rng.random(num_points) < rng.choice([0.0, 0.15, 0.4, 0.6])
    radii = np.where(outlier, rng.uniform(0.0, 12.0 * voxel_m, num_points), np.abs(radii))
    points += rng.uniform(-2.0, 2.0, 3)
    return points.astype(np.float32), radii.astype(np.float32), voxel_m


def solid_part(seed: int, **noise: float) -> SyntheticPart:
    """A box that shows more than one face: of a single one the mirror image of a keypoint is as good."""
    rng = np.random.default_rng(seed)
    while True:
        extents_m = box_extents_m(rng)
        part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), **noise)
        spread, _ = principal_axes(part.points_camera - part.points_camera.mean(axis=0, dtype=np.float64))
        if spread[2] > 0.3 * spread[1]:
            return part
