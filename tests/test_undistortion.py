"""Recorded pictures of a camera with a lens, against OpenCV's own undistortion."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from page_runtime.camera import Camera
from page_runtime.capture.undistortion import lens_of, undistorted
from page_runtime.image_files import SourceError
from page_runtime.lens import NO_DISTORTION

CAMERA = Camera(np.array([[210.0, 0, 155], [0, 205.0, 123], [0, 0, 1]]), 320, 240)
BROWN = (0.12, -0.2, 0.002, -0.003, 0.05)
RATIONAL = (*BROWN, 0.03, -0.01, 0.004)
FISHEYE = (0.05, -0.02, 0.01, -0.002)


def pictures() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(rng.uniform(0, 255, (240, 320, 3)).astype(np.float32), (0, 0), 5)
    depth_m = np.where(np.arange(320) < 160, np.float32(0.8), np.float32(1.4)) * np.ones((240, 1), np.float32)
    return cv2.normalize(smooth, smooth, 0, 255, cv2.NORM_MINMAX).astype(np.uint8), depth_m


def opencv_maps(model: str, coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    K, given, size = CAMERA.K, np.array(coefficients), (CAMERA.width, CAMERA.height)
    if model == "equidistant":
        return cv2.fisheye.initUndistortRectifyMap(K, given, np.eye(3), K, size, cv2.CV_32FC1)
    return cv2.initUndistortRectifyMap(K, given, np.eye(3), K, size, cv2.CV_32FC1)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("plumb_bob", BROWN), ("rational_polynomial", RATIONAL), ("equidistant", FISHEYE), ("equidistant", (0.0,) * 4)],
)
def test_pictures_are_straightened_as_opencv_does_it(model: str, coefficients: tuple[float, ...]) -> None:
    color, depth_m = pictures()
    straight, registered = undistorted(color, depth_m, CAMERA, lens_of(model, coefficients, where="test"))
    columns, rows = opencv_maps(model, coefficients)
    expected = cv2.remap(color, columns, rows, cv2.INTER_LINEAR)
    # Places are rounded to a 32nd of a pixel; beyond the border is black.
    within = (columns >= 0) & (columns <= CAMERA.width - 1) & (rows >= 0) & (rows <= CAMERA.height - 1)
    steepest = max(np.abs(np.diff(color.astype(int), axis=axis)).max() for axis in (0, 1))
    assert np.abs(straight.astype(int) - expected)[within].max() <= 1 + steepest / 16
    assert not np.array_equal(straight, color)
    nearest = cv2.remap(depth_m, columns, rows, cv2.INTER_NEAREST)
    # A pixel on the edge between two readings may round either way.
    assert (registered == nearest).mean() > 0.999
    assert set(np.unique(registered)) <= {0.0, *np.unique(depth_m)}


def test_pictures_without_a_lens_are_the_same_pictures() -> None:
    color, depth_m = pictures()
    for lens in (NO_DISTORTION, lens_of("plumb_bob", (0.0,) * 5, where="test")):
        straight, registered = undistorted(color, depth_m, CAMERA, lens)
        assert straight is color
        assert registered is depth_m


def test_a_lens_nobody_knows_is_named() -> None:
    with pytest.raises(SourceError, match=r"bag: .*'thin_prism'; understood are plumb_bob"):
        lens_of("thin_prism", BROWN, where="bag")
    with pytest.raises(SourceError, match=r"bag: .*finite numbers"):
        lens_of("equidistant", BROWN, where="bag")
