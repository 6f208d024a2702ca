"""Lenses: the same distortion as OpenCV's, an inverse that is one, and K that follows the picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.camera import Camera
from page_runtime.geometry import rotation_about, transform_from
from page_runtime.lens import NO_DISTORTION, Distortion, RawCamera, sampled

K = np.array([[612.0, 0.0, 318.4], [0.0, 611.0, 241.7], [0.0, 0.0, 1.0]])
BROWN = Distortion("brown-conrady", np.array([-0.28, 0.11, 0.0012, -0.0008, -0.02]))
RATIONAL = Distortion("brown-conrady", np.array([2.08, -33.3, 7e-4, -5e-4, 172.8, 1.74, -31.0, 166.9, *[0.0] * 6]))
TILTED = Distortion(
    "brown-conrady", np.array([-0.2, 0.1, 1e-3, 2e-3, 0.01, 0.02, 0.01, 0, 1e-3, 2e-3, -1e-3, 3e-4, 0.05, -0.03])
)
FISHEYE = Distortion("kannala-brandt", np.array([0.012, 0.05, -0.05, 0.01]))


def raw(lens: Distortion = BROWN, T: np.ndarray | None = None) -> RawCamera:
    return RawCamera(Camera(K, 640, 480, np.eye(4) if T is None else T), lens)


@pytest.mark.parametrize("lens", [BROWN, RATIONAL, TILTED, FISHEYE, NO_DISTORTION])
def test_projection_through_a_lens_equals_opencv(lens: Distortion) -> None:
    rng = np.random.default_rng(0)
    T = transform_from(rotation_about(rng.normal(size=3), 0.3), np.array([0.1, -0.05, 0.2]))
    points = rng.uniform(-0.3, 0.3, (40, 3)) + np.array([0, 0, 1.0])
    rvec = cv2.Rodrigues(T[:3, :3])[0]
    if lens is FISHEYE:
        expected, _ = cv2.fisheye.projectPoints(points[:, None], rvec, T[:3, 3], K, lens.coefficients)
    else:
        coefficients = lens.coefficients if len(lens.coefficients) else np.zeros(5)
        expected, _ = cv2.projectPoints(points, rvec, T[:3, 3], K, coefficients)
    np.testing.assert_allclose(raw(lens, T).project(points), expected.reshape(-1, 2), atol=1e-9)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_every_pixel_has_the_ray_that_is_seen_at_it_or_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    if rng.random() < 0.4:
        lens = Distortion("kannala-brandt", rng.uniform(-0.06, 0.06, 4))
    else:
        lens = Distortion("brown-conrady", rng.uniform(-0.3, 0.3, 5) * [1, 1, 0.01, 0.01, 0.3])
    pixels = rng.uniform(0, 1, (200, 2)) * [640, 480]
    rays = raw(lens).rays(pixels)
    has = np.isfinite(rays).all(axis=-1)
    assert np.isfinite(rays[np.linalg.norm(pixels - K[:2, 2], axis=1) < 200]).all()
    np.testing.assert_allclose(raw(lens).pixels(rays[has, :2]), pixels[has], atol=1e-4)


def test_pixels_beyond_the_fold_of_a_lens_have_no_ray() -> None:
    # r (1 - 2 r^2) is largest at r = 1/sqrt(6), where it is 2/3 of r.
    lens = Distortion("brown-conrady", np.array([-2.0, 0.0, 0.0, 0.0]))
    largest = 2 / 3 / np.sqrt(6)
    assert np.isnan(lens.undistorted(np.array([[1.01 * largest, 0.0]]))).all()
    inside = np.array([[0.99 * largest, 0.0]])
    found = lens.undistorted(inside)
    np.testing.assert_allclose(lens.distorted(found), inside, atol=1e-12)
    assert found[0, 0] < 1 / np.sqrt(6)


def test_a_fisheye_sees_no_point_of_the_plane_beyond_90_degrees() -> None:
    lens = Distortion("kannala-brandt", np.zeros(4))
    assert np.isnan(lens.undistorted(np.array([[np.pi / 2 + 0.01, 0.0]]))).all()
    np.testing.assert_allclose(lens.undistorted(np.array([[np.radians(80), 0.0]])), [[np.tan(np.radians(80)), 0.0]])


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_raw_pixels_follow_every_crop_resize_and_delivery(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.2, 0.2, (20, 3)) + np.array([0, 0, 1.0])
    x, y = (int(v) for v in rng.integers(0, 100, 2))
    width, height = (int(v) for v in rng.integers(50, 900, 2))
    before = raw().project(points)
    cropped = raw().cropped(x, y, 300, 200)
    np.testing.assert_allclose(cropped.project(points), before - [x, y], atol=1e-9)
    after = cropped.resized(width, height).project(points)
    expected = (before - [x, y] + 0.5) * [width / 300, height / 200] - 0.5
    np.testing.assert_allclose(after, expected, atol=1e-9)
    for delivered, choose in ((raw().covering(width, height), max), (raw().letterboxed(width, height), min)):
        scale = choose(width / 640, height / 480)
        middle = np.array([width, height]) / 2 - 0.5
        np.testing.assert_allclose(delivered.project(points), (before - [319.5, 239.5]) * scale + middle, atol=1e-8)
        assert (delivered.camera.width, delivered.camera.height) == (width, height)


@pytest.mark.parametrize("lens", [BROWN, FISHEYE])
def test_an_undistorted_picture_shows_points_where_the_pinhole_projects_them(lens: Distortion) -> None:
    point = np.array([0.31, -0.22, 1.0])
    rows, columns = np.mgrid[:480, :640]
    u, v = raw(lens).project(point)
    picture = np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 18.0).astype(np.float32)
    flat = sampled(picture, raw(lens).pixel_map(raw(lens).camera))
    weight = flat**4
    center = np.array([(columns * weight).sum(), (rows * weight).sum()]) / weight.sum()
    np.testing.assert_allclose(center, raw(lens).camera.project(point), atol=0.15)


@pytest.mark.parametrize(
    ("model", "coefficients", "reason"),
    [
        ("brown-conrady", [0.1, 0.2, 0.3], "4 or 5 or 8 or 12 or 14"),
        ("kannala-brandt", [0.1] * 5, "kannala-brandt has 4"),
        ("none", [0.1], "none has 0"),
        ("brown-conrady", [0.1, np.nan, 0, 0], "finite"),
        ("fov", [0.9], "expected none, brown-conrady, kannala-brandt"),
    ],
)
def test_coefficients_that_are_none_of_the_models_are_refused(model, coefficients, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Distortion(model, np.array(coefficients))
