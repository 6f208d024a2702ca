"""Pictures of boards as real cameras take them: lens, blur, uneven light, noise, boards half outside the picture."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from page_calibration.board import Board
from page_runtime.geometry import Array, invert, rotation_about, transform_from
from page_runtime.lens import RawCamera, sampled

PIXELS_PER_SQUARE = 64


@cache
def texture(board: Board) -> np.ndarray:
    return board.picture(PIXELS_PER_SQUARE)


def render_board(
    board: Board,
    raw: RawCamera,
    T_camera_board: Array,
    rng: np.random.Generator,
    *,
    blur_px: float = 0.7,
    noise: float = 3.0,
    light: float = 0.5,
) -> np.ndarray:
    """(H,W) uint8. light: how much of the brightness is missing at the darkest side."""
    camera, samples = raw.camera, 2
    fine = raw.resized(camera.width * samples, camera.height * samples)
    rows, columns = np.mgrid[: fine.camera.height, : fine.camera.width]
    rays = _rays(fine, columns, rows)
    T_board_camera = invert(T_camera_board)
    directions, origin = rays @ T_board_camera[:3, :3].T, T_board_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = -origin[2] / directions[..., 2]
        hit = origin[:2] + distance[..., None] * directions[..., :2]
    # A pixel's centre is at integers, a texel's too: the board's edge is half a texel before the first.
    texel = np.where((distance > 0)[..., None], hit / board.square_m * PIXELS_PER_SQUARE - 0.5, -1e4)
    picture = sampled(texture(board), texel, outside=210.0)
    inside = ((texel > -0.5) & (texel < [board.columns * PIXELS_PER_SQUARE, board.rows * PIXELS_PER_SQUARE])).all(
        axis=-1
    )
    margin = ((hit > -board.square_m) & (hit < board.square_m * (np.array([board.columns, board.rows]) + 1))).all(
        axis=-1
    )
    picture = np.where(inside, picture, np.where(margin, 235, 90)).astype(np.float32)
    picture = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    picture = cv2.GaussianBlur(picture, (0, 0), blur_px) if blur_px else picture
    angle = rng.uniform(0, 2 * np.pi)
    ramp = np.add.outer(
        np.linspace(-1, 1, camera.height) * np.sin(angle), np.linspace(-1, 1, camera.width) * np.cos(angle)
    )
    picture = 20 + picture * 0.8 * (1.0 - light * (ramp + np.sqrt(2)) / (2 * np.sqrt(2)))
    picture += rng.normal(0.0, noise, picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8)


_RAYS: dict[tuple[int, ...], Array] = {}


def _rays(raw: RawCamera, columns: Array, rows: Array) -> Array:
    key = (
        hash(raw.camera.K.tobytes()),
        hash(raw.distortion.coefficients.tobytes()),
        raw.camera.width,
        raw.camera.height,
    )
    if key not in _RAYS:
        _RAYS[key] = raw.rays(np.stack([columns, rows], axis=-1).astype(float))
    return _RAYS[key]


def board_places(
    board: Board, raw: RawCamera, rng: np.random.Generator, count: int, *, tilt_deg: float = 40.0, aside: float = 0.75
) -> list[Array]:
    """T_camera_board of `count` views: the board anywhere in the picture, turned and tilted, some of it outside."""
    camera = raw.camera
    size = np.array([board.columns, board.rows]) * board.square_m
    middle = transform_from(np.eye(3), np.array([-size[0] / 2, -size[1] / 2, 0.0]))
    places = []
    for i in range(count):
        tilt = np.radians(rng.uniform(0.35, 1.0) * tilt_deg)
        direction = 2 * np.pi * i / count + rng.uniform(-0.4, 0.4)
        R = rotation_about(np.array([np.cos(direction), np.sin(direction), 0.0]), tilt) if tilt_deg else np.eye(3)
        R = R @ rotation_about(np.array([0.0, 0.0, 1.0]), rng.uniform(-0.5, 0.5))
        z = camera.K[0, 0] * size[0] / camera.width * rng.uniform(0.9, 1.9)
        reach = (np.array([camera.width, camera.height]) / 2) * z / camera.K[0, 0]
        x, y = rng.uniform(-aside, aside, 2) * reach * 0.8
        places.append(transform_from(R, np.array([x, y, z])) @ middle)
    return places
