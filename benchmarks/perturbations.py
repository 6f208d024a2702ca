"""Noise on the points of a region, as section VI-E of the paper adds it to its point clouds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.sampling import RegionSample

Perturbation = Callable[[RegionSample, np.random.Generator], RegionSample]
OFFSET_M = (0.0015, 0.005)
SCALES = (0.95, 1.05)


def none(sample: RegionSample, rng: np.random.Generator) -> RegionSample:
    """The points as they are."""
    del rng
    return sample


def gaussian(sigma_m: float) -> Perturbation:
    """Independent zero-mean noise on every coordinate of every point; what is sampled twice moves once."""

    def perturbed(sample: RegionSample, rng: np.random.Generator) -> RegionSample:
        noise = rng.normal(0.0, sigma_m, (sample.num_distinct, 3))
        return _with(sample, sample.points_camera + np.resize(noise, sample.points_camera.shape))

    return perturbed


def scaling(sample: RegionSample, rng: np.random.Generator) -> RegionSample:
    """All points farther from their centre, or nearer to it, by one factor; the truth stays.

    About the centre: scaled about the camera, an object at a metre would truly stand 50 mm elsewhere.
    """
    away = sample.points_camera - sample.center_camera
    return _with(sample, sample.center_camera + rng.uniform(*SCALES) * away)


def offset(sample: RegionSample, rng: np.random.Generator) -> RegionSample:
    """All points moved by so much along every axis, either way; the truth stays."""
    return _with(sample, sample.points_camera + rng.uniform(*OFFSET_M, 3) * rng.choice([-1.0, 1.0], 3))


def jointly(*each: Perturbation) -> Perturbation:
    def perturbed(sample: RegionSample, rng: np.random.Generator) -> RegionSample:
        for one in each:
            sample = one(sample, rng)
        return sample

    return perturbed


def _with(sample: RegionSample, points_camera: NDArray[np.floating]) -> RegionSample:
    points = points_camera.astype(np.float32)
    return replace(sample, points_camera=points, center_camera=points.mean(axis=0))


SETTINGS: dict[str, Perturbation] = {
    "clean": none,
    "Gaussian 10 mm": gaussian(0.010),
    "Gaussian 20 mm": gaussian(0.020),
    "Gaussian 30 mm": gaussian(0.030),
    "scaling": scaling,
    "offset": offset,
    "all, Gaussian 10 mm": jointly(scaling, offset, gaussian(0.010)),
}
# Table IX, laptop, base and lid, rotation [deg]; its clean figures are those of Table I.
PAPER_DEG = {
    "clean": (4.0, 1.7),
    "Gaussian 10 mm": (4.3, 1.9),
    "Gaussian 20 mm": (4.3, 1.9),
    "Gaussian 30 mm": (4.3, 1.9),
    "scaling": (4.1, 1.7),
    "offset": (4.4, 1.8),
}
