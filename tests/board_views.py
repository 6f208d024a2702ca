"""Views of a rendered board by a known camera, made once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from page_calibration.board import Board, View, find_board
from page_calibration.intrinsics import IntrinsicCalibration, calibrate_intrinsics
from page_runtime.camera import Camera
from page_runtime.geometry import Array, apply
from page_runtime.lens import Distortion, RawCamera
from rendered_boards import board_places, render_board

BOARD = Board("charuco", 9, 6, 0.030, 0.022)
SIZE = (640, 480)
LENS = Distortion("brown-conrady", np.array([0.1, -0.22, 0.001, -0.0007, 0.05]))
TRUE = RawCamera(Camera(np.array([[620.0, 0, 326.0], [0, 618.0, 238.0], [0, 0, 1]]), *SIZE), LENS)


@cache
def pictures() -> tuple[tuple[Array, np.ndarray], ...]:
    """16 views, blurred, unevenly lit, noisy, some boards half outside; and where the board was."""
    rng = np.random.default_rng(0)
    return tuple((T, render_board(BOARD, TRUE, T, rng)) for T in board_places(BOARD, TRUE, rng, 16))


@cache
def views() -> tuple[View, ...]:
    found = [find_board(BOARD, picture, name=f"{i:02d}") for i, (_, picture) in enumerate(pictures())]
    return tuple(view for view in found if isinstance(view, View))


@cache
def calibrated() -> IntrinsicCalibration:
    return calibrate_intrinsics(views(), SIZE)


def drawn_views(
    rng: np.random.Generator,
    places: Sequence[Array],
    raw: RawCamera = TRUE,
    *,
    noise: float = 0.05,
    shared: float = 0.1,
) -> list[View]:
    """Corners as projected, with noise of each corner and errors that all corners of a view share."""
    found = []
    for i, T in enumerate(places):
        pixels = raw.project(apply(T, BOARD.points_board))
        u, v = (pixels / 300 - 1).T
        together = shared * rng.normal(size=(2, 5)) @ np.stack([u, v, u * u, u * v, v * v])
        pixels = pixels + rng.normal(0, noise, pixels.shape) + together.T
        inside = ((pixels > 2) & (pixels < np.array(SIZE) - 3)).all(axis=1)
        if inside.sum() >= 12:
            ids = np.flatnonzero(inside)
            found.append(View(f"{i:02d}", ids, BOARD.points_board[ids], pixels[ids]))
    return found


def intrinsics_error(result: IntrinsicCalibration) -> Array:
    return (result.raw.camera.K - TRUE.camera.K)[[0, 1, 0, 1], [0, 1, 2, 2]]


# --- intrinsics ----------------------------------------------------------------------------------------------------
