"""Smoothing of noisy depth: planes come back as they are, edges stay, quiet sensors are left alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.camera import Camera
from page_runtime.denoising import NOISY_M, denoised, depth_noise_m, smoothed
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array
from page_runtime.sampling import RegionSample, sample_region

SIDE = 224
CAMERA = Camera(np.array([[600.0, 1.5, 110.0], [0.0, 590.0, 115.0], [0.0, 0.0, 1.0]]), SIDE, SIDE)
WHOLE = (0, 0, SIDE, SIDE)


def seen(depth_of: Callable[[Array, Array], Array]) -> RegionSample:
    """2,048 points of a surface whose depth, m, is given for the slopes x / z and y / z of its rays."""
    rows, columns = np.indices((SIDE, SIDE)).astype(float)
    y = (rows - CAMERA.K[1, 2]) / CAMERA.K[1, 1]
    x = (columns - CAMERA.K[0, 2] - CAMERA.K[0, 1] * y) / CAMERA.K[0, 0]
    frame = RgbdFrame(np.zeros((SIDE, SIDE, 3), np.uint8), depth_of(x, y).astype(np.float32), CAMERA)
    sample = sample_region(frame, WHOLE, image_size=SIDE, num_points=2048, radius_m=5.0, margin=0.0)
    assert isinstance(sample, RegionSample)
    return sample


def noisy(sample: RegionSample, sigma_m: float, seed: int = 0) -> RegionSample:
    """Independent noise on every coordinate; what is sampled twice moves once."""
    noise = np.random.default_rng(seed).normal(0.0, sigma_m, (sample.num_distinct, 3))
    points = sample.points_camera + np.resize(noise, sample.points_camera.shape)
    return replace(sample, points_camera=points.astype(np.float32))


@given(
    distance=st.floats(0.3, 3.0),
    tilt=st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)),
    noise_m=st.floats(NOISY_M, 0.03),
)
@settings(max_examples=25, deadline=None)
def test_a_plane_is_left_as_it_is(distance: float, tilt: tuple[float, float], noise_m: float) -> None:
    """n . p = distance, at any slant: its inverse depth is affine in the image."""
    sample = seen(lambda x, y: distance / (1.0 + tilt[0] * x + tilt[1] * y))
    again = smoothed(sample, noise_m)
    np.testing.assert_allclose(again.points_camera, sample.points_camera, rtol=5e-4)
    assert depth_noise_m(sample) < 1e-4 * distance
    assert denoised(sample) is sample


@pytest.mark.parametrize("sigma_m", [0.008, 0.01, 0.03])
def test_the_noise_of_a_slanted_plane_is_measured_and_most_of_it_taken_away(sigma_m: float) -> None:
    clean = seen(lambda x, y: 0.9 / (1.0 + 0.8 * x - 0.5 * y))
    sample = noisy(clean, sigma_m)
    assert abs(depth_noise_m(sample) / sigma_m - 1.0) < 0.25
    left = np.linalg.norm(denoised(sample).points_camera - clean.points_camera, axis=1)
    assert np.sqrt(np.mean(left**2)) < 0.6 * sigma_m


def test_an_edge_stays_an_edge() -> None:
    """A step of 0.1 m in depth under noise of 10 mm: hardly a point comes to lie between."""
    clean = seen(lambda x, y: np.where(x + 0.3 * y > 0.0, 0.8, 0.9))
    left = np.abs(denoised(noisy(clean, 0.01)).points_camera[:, 2] - clean.points_camera[:, 2])
    assert np.mean(left < 0.01) > 0.93
    assert np.median(left) < 0.004


def test_every_point_stays_on_the_ray_of_its_pixel() -> None:
    clean = seen(lambda x, y: 0.7 + 0.4 * x**2 + 0.2 * np.sin(8 * y))
    again = denoised(noisy(clean, 0.02))
    np.testing.assert_allclose(CAMERA.project(again.points_camera.astype(float)), clean.pixels, atol=0.01)
    np.testing.assert_allclose(again.center_camera, again.points_camera[: again.num_distinct].mean(axis=0), atol=1e-5)


def test_few_points_that_are_repeated_move_together() -> None:
    sample = seen(lambda x, y: np.where((np.abs(x) < 0.02) & (np.abs(y) < 0.02), 0.8, 0.0))
    assert sample.num_distinct < 700
    again = denoised(noisy(sample, 0.01))
    np.testing.assert_array_equal(
        again.points_camera, np.resize(again.points_camera[: sample.num_distinct], again.points_camera.shape)
    )
    assert np.isfinite(again.points_camera).all()
    assert np.abs(again.points_camera - sample.points_camera).mean() < 0.004


def test_a_quiet_sensor_is_left_alone() -> None:
    sample = noisy(seen(lambda x, y: 0.9 / (1.0 + 0.3 * x + 0.1 * y)), 0.5 * NOISY_M)
    assert denoised(sample) is sample


def test_depth_in_steps_is_finite_after_it() -> None:
    """Most neighbours of a coarsely quantised surface are at the very same depth."""
    sample = seen(lambda x, y: np.round((1.5 + 0.5 * x + 0.01 * y) / 0.03) * 0.03)
    assert np.isfinite(smoothed(sample, 0.01).points_camera).all()
    assert np.isfinite(depth_noise_m(sample))
