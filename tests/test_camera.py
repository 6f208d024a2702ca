"""M = K [R | t] and how it follows crops and resizes."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.camera import Camera
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import invert, rotation_about, transform_from


def camera(**changes) -> Camera:
    K = np.array([[500.0, 0.0, 318.5], [0.0, 510.0, 242.0], [0.0, 0.0, 1.0]])
    return Camera(**{"K": K, "width": 640, "height": 480, **changes})


def test_projection_equals_opencv() -> None:
    rng = np.random.default_rng(0)
    T = transform_from(rotation_about(rng.normal(size=3), 0.4), np.array([0.1, -0.2, 0.3]))
    points_world = rng.uniform(-0.5, 0.5, (50, 3)) + np.array([0, 0, 2])
    oracle, _ = cv2.projectPoints(points_world, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], camera().K, np.zeros(5))
    np.testing.assert_allclose(camera(T_camera_world=T).project(points_world), oracle[:, 0], atol=1e-9)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_backprojection_inverts_projection_through_any_crop_and_resize(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = (int(v) for v in rng.integers(-100, 400, 2))
    seen = camera().cropped(x, y, 200, 160).resized(int(rng.integers(50, 500)), int(rng.integers(50, 500)))
    points = rng.uniform(-0.5, 0.5, (20, 3)) + np.array([0, 0, 1.5])
    pixels = seen.project(points)
    np.testing.assert_allclose(seen.backproject(pixels, points[:, 2]), points, atol=1e-9)
    world = transform_from(rotation_about(rng.normal(size=3), 1.0), rng.normal(size=3))
    moved = Camera(seen.K, seen.width, seen.height, T_camera_world=invert(world))
    np.testing.assert_allclose(moved.project(points @ world[:3, :3].T + world[:3, 3]), pixels, atol=1e-6)


def test_a_resized_picture_shows_a_point_where_the_resized_camera_projects_it() -> None:
    picture = np.zeros((480, 640), np.float32)
    point = np.array([0.2, -0.1, 1.0])
    u, v = camera().project(point)
    cv2.circle(picture, (round(u * 16), round(v * 16)), 16 * 24, 1.0, -1, shift=4)
    small = cv2.resize(picture[40:440, 100:600], (200, 160), interpolation=cv2.INTER_AREA)
    rows, columns = np.mgrid[:160, :200]
    center = np.array([(columns * small).sum(), (rows * small).sum()]) / small.sum()
    np.testing.assert_allclose(camera().cropped(100, 40, 500, 400).resized(200, 160).project(point), center, atol=0.05)


def test_points_behind_the_camera_have_no_pixel() -> None:
    assert np.isnan(camera().project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]))).all()


@pytest.mark.parametrize(
    ("K", "word"),
    [
        (np.eye(4), "3x3"),
        (np.array([[500.0, 0, 320], [0, -500, 240], [0, 0, 1]]), "positive focal"),
        (np.array([[500.0, 0, 0], [0, 500, 0], [320, 240, 1]]), "transposed"),
        (np.full((3, 3), np.nan), "finite"),
    ],
)
def test_a_wrong_K_is_refused_with_the_reason(K: np.ndarray, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        camera(K=K)


@pytest.mark.parametrize(
    ("color", "depth", "word"),
    [
        (np.zeros((480, 640, 3), np.float32), np.zeros((480, 640), np.float32), "8-bit RGB"),
        (np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), np.uint16), "depth scale"),
        (np.zeros((480, 640, 3), np.uint8), np.zeros((240, 320), np.float32), "register"),
        (np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320), np.float32), "K is for 640x480"),
    ],
)
def test_a_frame_whose_pieces_do_not_fit_is_refused_with_the_way_out(color, depth, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        RgbdFrame(color, depth, camera())
