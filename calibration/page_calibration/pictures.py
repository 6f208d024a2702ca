"""Pictures to find a board in: a folder, a video, or a camera that is held before it now."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from page_calibration.board import Board, View, find_board
from page_calibration.calibration import CalibrationError
from page_calibration.views import distinct_views
from page_runtime.capture.documents import pictures
from page_runtime.image_files import read_color

# Frames a live camera or a video is looked at before giving up on new views.
MAX_FRAMES = 5000
Told = Callable[[str, View | str], None]


@dataclass(frozen=True, eq=False, slots=True)
class FoundViews:
    """Views of a board in pictures of one size (width, height); unused: name of a picture and why."""

    views: tuple[View, ...]
    size: tuple[int, int]
    unused: tuple[tuple[str, str], ...]


def find_views(source: str, board: Board, *, wanted: int = 25, told: Told | None = None) -> FoundViews:
    """Views of the board in `source`: a folder of pictures (all are used), a video file or the number of a camera
    (frames that show the board from somewhere new, until there are `wanted`). told: called for each picture."""
    is_folder = Path(source).is_dir()
    frames = _folder(Path(source)) if is_folder else _stream(source)
    views: list[View] = []
    unused: list[tuple[str, str]] = []
    size: tuple[int, int] | None = None
    for name, gray in frames:
        here = gray.shape[1], gray.shape[0]
        if size is not None and here != size:
            raise CalibrationError(
                f"{source}: {name} is {here[0]}x{here[1]}, those before are {size[0]}x{size[1]}; a calibration is for "
                "one size"
            )
        size = here
        found = find_board(board, gray, name=name)
        if isinstance(found, str):
            unused.append((name, found))
        elif not is_folder and distinct_views([*views, found], size[0]) == len(views):
            continue
        else:
            views.append(found)
        if told is not None:
            told(name, found)
        if not is_folder and len(views) == wanted:
            break
    if size is None:
        raise CalibrationError(f"{source}: no pictures; expected .png or .jpg")
    if not views:
        raise CalibrationError(
            f"{source}: the {board} is in none of {len(unused)} pictures; check squares (columns x rows), dictionary, "
            "and for boards printed before OpenCV 4.6 --legacy"
        )
    return FoundViews(tuple(views), size, tuple(unused) if is_folder else ())


def _folder(path: Path) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    for name, file in pictures(path).items():
        yield name, np.asarray(cv2.cvtColor(read_color(file), cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def _stream(source: str) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    if not source.isdigit() and not Path(source).is_file():
        raise CalibrationError(f"{source}: expected a folder of pictures, a video file or the number of a camera")
    capture = cv2.VideoCapture(int(source) if source.isdigit() else source)
    try:
        if not capture.isOpened():
            kind = "camera with this number answers" if source.isdigit() else "video in it that OpenCV can read"
            raise CalibrationError(f"{source}: there is no {kind}")
        for number in range(MAX_FRAMES):
            read, frame = capture.read()
            if not read:
                return
            yield f"{number:06d}", np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    finally:
        capture.release()
