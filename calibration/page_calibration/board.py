"""Calibration boards and where they are in a picture.

A board's frame: origin at its first corner, x along a row of squares, y along a column, z into the board; metres. What
is found is a `View`: pixels of known points of the board.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from page_calibration.calibration import CalibrationError
from page_runtime.geometry import Array

# Fewer points, or points of one row, leave a view's pose open.
MIN_POINTS = 8
MIN_ROWS = 2
# A corner is refined in a window that ends before the markers begin, whose own corners would draw it to them: on
# rendered views of 25 px squares 0.05 px of error, with twice the window 0.2.
GAP_USED = 0.75
_SUBPIXEL = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)


@dataclass(frozen=True, slots=True)
class Board:
    """kind: charuco (squares with markers, may be partly seen) or chessboard (must be seen whole). columns, rows:
    squares. square_m, marker_m: sides; marker_m and dictionary are the markers' of a charuco board. legacy: markers
    begin as boards generated before OpenCV 4.6 have them."""

    kind: Literal["charuco", "chessboard"]
    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = "5X5_100"
    legacy: bool = False

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3:
            raise CalibrationError(f"Board: expected at least 3x3 squares, got {self.columns}x{self.rows}")
        if not 0.0 < self.square_m < 2.0:
            raise CalibrationError(f"Board.square_m: expected metres, got {self.square_m:g}")
        if self.kind == "charuco":
            if not 0.0 < self.marker_m < self.square_m:
                raise CalibrationError(
                    f"Board.marker_m: expected more than 0 and less than a square of {self.square_m:g} m, got "
                    f"{self.marker_m:g}"
                )
            if not hasattr(cv2.aruco, f"DICT_{self.dictionary}"):
                raise CalibrationError(f"Board.dictionary: no {self.dictionary!r} in OpenCV; 5X5_100 is one")

    def __str__(self) -> str:
        size = f"{self.columns}x{self.rows} squares of {self.square_m * 1e3:g} mm"
        if self.kind == "chessboard":
            return f"chessboard of {size}"
        return f"charuco board of {size}, markers {self.marker_m * 1e3:g} mm of {self.dictionary}"

    @property
    def points_board(self) -> Array:
        """Inner corners (n,3), metres, row by row."""
        columns, rows = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        points = np.stack([columns, rows, np.zeros_like(columns)], axis=-1).reshape(-1, 3)
        return points * self.square_m

    def picture(self, pixels_per_square: int) -> NDArray[np.uint8]:
        """(rows * s, columns * s) uint8 gray, the squares alone."""
        if self.kind == "charuco":
            size = (self.columns * pixels_per_square, self.rows * pixels_per_square)
            return np.asarray(_charuco(self).generateImage(size), dtype=np.uint8)
        squares = (np.add.outer(np.arange(self.rows), np.arange(self.columns)) % 2).astype(np.uint8) * 255
        return np.kron(squares, np.ones((pixels_per_square, pixels_per_square), np.uint8))


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """A board in one picture. name: of the picture. ids: (n,) rows of points_board. pixels: (n,2)."""

    name: str
    ids: NDArray[np.intp]
    points_board: Array
    pixels: Array


def _charuco(board: Board) -> cv2.aruco.CharucoBoard:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
    made = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, board.marker_m, dictionary)
    made.setLegacyPattern(board.legacy)
    return made


def find_board(board: Board, gray: NDArray[np.uint8], *, name: str) -> View | str:
    """The board in a picture (H,W) uint8, or in words why it is not used."""
    ids, pixels = _charuco_corners(board, gray) if board.kind == "charuco" else _chessboard_corners(board, gray)
    if not len(ids):
        return "no board found"
    columns, rows = ids % (board.columns - 1), ids // (board.columns - 1)
    if len(ids) < MIN_POINTS or min(len(set(columns)), len(set(rows))) < MIN_ROWS:
        return f"only {len(ids)} corners of the board found, in too few rows"
    return View(name, ids, board.points_board[ids], pixels)


def _charuco_corners(board: Board, gray: NDArray[np.uint8]) -> tuple[NDArray[np.intp], Array]:
    detector = cv2.aruco.CharucoDetector(_charuco(board))
    corners, ids, _, _ = detector.detectBoard(gray)
    if ids is None or corners is None:
        return np.zeros(0, np.intp), np.zeros((0, 2))
    ids, pixels = np.asarray(ids).ravel().astype(np.intp), np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    gap = (board.square_m - board.marker_m) / (2.0 * board.square_m)
    side = _smallest_square(ids, pixels.reshape(-1, 2), board.columns - 1)
    return ids, _refined(gray, pixels, int(np.clip(round(GAP_USED * gap * side), 2, 9)))


def _chessboard_corners(board: Board, gray: NDArray[np.uint8]) -> tuple[NDArray[np.intp], Array]:
    found, corners = cv2.findChessboardCornersSB(gray, (board.columns - 1, board.rows - 1), flags=cv2.CALIB_CB_ACCURACY)
    if not found:
        return np.zeros(0, np.intp), np.zeros((0, 2))
    pixels = np.asarray(corners, dtype=float).reshape(-1, 2)
    return np.arange(len(pixels)), pixels


def _smallest_square(ids: NDArray[np.intp], pixels: Array, columns: int) -> float:
    """The shortest side of a square seen, pixels."""
    place = {int(i): pixel for i, pixel in zip(ids, pixels, strict=True)}
    sides = [
        float(np.linalg.norm(place[i] - place[i + step]))
        for i in place
        for step in (1, columns)
        if i + step in place and (step != 1 or (i + 1) % columns)
    ]
    return min(sides, default=20.0)


def _refined(gray: NDArray[np.uint8], pixels: NDArray[np.float32], window: int) -> Array:
    refined = cv2.cornerSubPix(gray, pixels.copy(), (window, window), (-1, -1), _SUBPIXEL)
    moved = np.linalg.norm(refined - pixels, axis=-1) > window
    return np.where(moved[..., None], pixels, refined).astype(float).reshape(-1, 2)
