"""Points of a noisy sensor, moved along the rays of their own pixels to where their neighbours have the surface.

The inverse depth of a plane is affine in the pixels that see it. Planes are fitted, robustly, to the inverse depths
around some of the points, and every point takes its depth from those near it that explain its own reading. What such
planes leave over tells how noisy a sensor is; the points of a quiet one stay as they were read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.neighbours import nearest
from page_runtime.sampling import RegionSample

Floats = NDArray[np.float32]

# Standard deviation above which points are smoothed. Below it that gains nothing and takes time; a twentieth to a
# quarter of laptops as simulated sensors record them are above it, and a third of drawers.
NOISY_M = 0.005
# What a plane is to leave of the noise, as far as MOST neighbours can: fewer keep edges sharper.
LEFT_M = 0.004
FEWEST, MOST = 12, 96
# Planes for the points of a region, and how many of them a point is weighed between.
PLANES, WEIGHED = 512, 3
# The noise is measured at so many points, evenly over the region, each with so many neighbours.
_MEASURED_AT, _MEASURED_FROM = 128, 9
# Beyond so many standard deviations from a plane a reading is of another surface.
_CUT = np.float32(2.25)
_FITS = 3
# 1/m: of readings that are exactly on a plane something must be left to divide by.
_LEAST_SPREAD = np.float32(1e-6)
# From the median distance of two normal numbers, and from that to the mean, to their standard deviation.
_OF_TWO = np.float32(1.0 / 0.9539)
_OF_ONE = 1.4826


def denoised(sample: RegionSample) -> RegionSample:
    """The sample as it is where its depth is as quiet as networks learn from, else with its points smoothed."""
    noise_m = depth_noise_m(sample)
    return sample if noise_m < NOISY_M else smoothed(sample, noise_m)


def depth_noise_m(sample: RegionSample) -> float:
    """The standard deviation of the points about the planes of their nearest neighbours, m; the median of many."""
    flat, inverse = _seen(sample)
    planes = _Planes.of(flat, inverse, _MEASURED_AT, _MEASURED_FROM, None)
    away = planes.values[:, 0] - inverse[: len(planes.values)]
    # The plane is as uncertain as a mean of the others is.
    of_both = np.sqrt(1.0 + 1.0 / (_MEASURED_FROM - 1))
    return float(_OF_ONE / of_both * np.median(np.abs(away) / np.square(inverse[: len(away)])))


def smoothed(sample: RegionSample, noise_m: float) -> RegionSample:
    """The sample with every point at its own pixel and at the depth its neighbours give it. noise_m: the standard
    deviation of its depth."""
    flat, inverse = _seen(sample)
    spread = np.float32(noise_m * float(np.median(inverse)) ** 2)
    neighbours = int(np.clip((noise_m / LEFT_M) ** 2, FEWEST, MOST))
    planes = _Planes.of(flat, inverse, PLANES, neighbours, spread)
    # No farther than twice as far: a plane that is seen from its edge has any depth.
    depth = 1.0 / np.maximum(planes.at(flat, inverse, spread), np.float32(0.5) * inverse)
    K = sample.camera.K
    y = (flat[:, 1] - K[1, 2]) / K[1, 1]
    x = (flat[:, 0] - K[0, 2] - K[0, 1] * y) / K[0, 0]
    distinct = (np.stack([x, y, np.ones_like(x)], axis=1) * depth[:, None]).astype(np.float32)
    points = np.resize(distinct, sample.points_camera.shape)
    return replace(sample, points_camera=points, center_camera=distinct.mean(axis=0))


def _seen(sample: RegionSample) -> tuple[Floats, Floats]:
    """Of the points that are there once: (n,3) their pixels in the plane z = 0, (n,) their inverse depth, 1/m."""
    count = sample.num_distinct
    flat = np.zeros((count, 3), np.float32)
    flat[:, :2] = sample.pixels[:count]
    return flat, np.float32(1.0) / sample.points_camera[:count, 2]


@dataclass(frozen=True, eq=False, slots=True)
class _Planes:
    """Inverse depth about points of the image. middles: (M,3) px, z = 0. values: (M,3) there, 1/m, and its slope along
    x and y, 1/m for every px."""

    middles: Floats
    values: Floats

    @staticmethod
    def of(flat: Floats, inverse: Floats, most: int, count: int, spread: np.float32 | None) -> _Planes:
        """About the first `most` points, each from its `count` nearest in the image.

        Iteratively reweighted least squares with Tukey's weights, begun from the distances in inverse depth. spread:
        the standard deviation of inverse depth; None to take it from those distances, and to leave the point itself
        out of its plane.
        """
        middles, own = flat[:most], inverse[:most]
        near = nearest(middles, flat, min(count, len(flat)))
        terms = np.empty((3, *near.shape), np.float32)
        terms[0] = 1.0
        np.subtract(flat[near, 0], middles[:, :1], out=terms[1])
        np.subtract(flat[near, 1], middles[:, 1:2], out=terms[2])
        unit = np.float32(1.0) / np.sqrt(np.mean(np.square(terms[1:])) + np.float32(1e-12))
        terms[1:] *= unit
        rise = inverse[near] - own[:, None]
        others, scatter = np.ones_like(rise), spread
        if scatter is None:
            others = (near != np.arange(len(own))[:, None]).astype(np.float32)
            scatter = np.float32(np.median(np.median(np.abs(rise), axis=1))) * _OF_TWO
        scale = _per_cut(scatter)
        weights: Floats = others * _cauchy(scale * rise)
        plane = np.zeros((len(own), 3), np.float32)
        for fit in range(_FITS):
            if fit:
                left = rise - np.einsum("tmk,mt->mk", terms, plane)
                weights = others * _tukey(scale * left)
            plane = _least_squares(terms, rise, weights)
        plane[:, 0] += own
        plane[:, 1:] *= unit
        return _Planes(middles, plane)

    def at(self, flat: Floats, inverse: Floats, spread: np.float32) -> Floats:
        """(n,) the inverse depth of points (n,3) by the nearest planes, those counting most that explain `inverse`."""
        near = nearest(flat, self.middles, min(WEIGHED, len(self.middles)))
        away = flat[:, None, :2] - self.middles[near, :2]
        planes = self.values[near]
        found = planes[..., 0] + planes[..., 1] * away[..., 0] + planes[..., 2] * away[..., 1]
        left = np.asarray((found - inverse[:, None]) * _per_cut(spread), np.float32)
        weights = _cauchy(left) / (np.square(away).sum(axis=2) + np.float32(1.0))
        return (weights * found).sum(axis=1) / weights.sum(axis=1)


def _per_cut(spread: np.float32) -> np.float32:
    """What turns distances in inverse depth into shares of where readings of another surface begin."""
    return np.float32(1.0 / (_CUT * max(spread, _LEAST_SPREAD)))


def _cauchy(residuals: Floats) -> Floats:
    """Weights that never are 0: the least unlikely plane counts where none explains a reading."""
    return np.asarray(np.float32(1.0) / np.square(np.float32(1.0) + np.square(residuals)), np.float32)


def _tukey(residuals: Floats) -> Floats:
    """Tukey's biweight, 0 from a residual of 1 on."""
    return np.asarray(np.square(np.maximum(np.float32(1.0) - np.square(residuals), np.float32(0.0))), np.float32)


def _least_squares(terms: Floats, rise: Floats, weights: Floats) -> Floats:
    """(M,3) the plane through weighted rises (M,k) over terms (3,M,k)."""
    normal = np.empty((rise.shape[0], 3, 3), np.float32)
    right = np.empty((rise.shape[0], 3), np.float32)
    for row in range(3):
        weighted = weights * terms[row]
        right[:, row] = np.einsum("mk,mk->m", weighted, rise)
        for column in range(row, 3):
            normal[:, row, column] = normal[:, column, row] = np.einsum("mk,mk->m", weighted, terms[column])
    # A slope that the neighbours say nothing of is none.
    normal += np.diag(np.array([1e-3, 1e-3, 1e-3], np.float32))
    return np.linalg.solve(normal, right[..., None])[..., 0]
