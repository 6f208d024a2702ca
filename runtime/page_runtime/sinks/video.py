"""The overlay as a video, at the pace of the camera: MPEG-4 in Matroska or MP4, by OpenCV.

A killed process leaves a Matroska file that plays up to its last 256 kB; an MP4 without its end plays nowhere. H.264 is
not in OpenCV's wheels, so browsers do not play these files; VLC, mpv and ffmpeg do.
"""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.live.result import LiveResult
from page_runtime.sinks.picture import picture_of

SUFFIXES = (".mkv", ".mp4")
FPS = 30.0
# A camera that was away for a minute is not a minute of a frozen picture.
LONGEST_STILL = 30
MIN_FREE_BYTES = 4 << 20


class VideoSink:
    """Into the new file `path`, FPS pictures a second: each result is shown until the time of the next one.

    A source without times gives every result one picture. OpenCV tells nobody when a write fails: so the room on the
    disk is asked for before each picture, and what the file holds is counted at its end.
    """

    def __init__(self, path: Path) -> None:
        """FileExistsError when the file is there already; ValueError for a suffix that is not of SUFFIXES."""
        if path.suffix.lower() not in SUFFIXES:
            raise ValueError(f"{path}: expected a video called {' or '.join('NAME' + s for s in SUFFIXES)}")
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        self._path, self._name = path, f"video {path}"
        self._writer: cv2.VideoWriter | None = None
        self._size = (0, 0)
        self._written = 0
        self._begin_s = self._last_s = 0.0
        self._last: NDArray[np.uint8] | None = None

    @property
    def name(self) -> str:
        return self._name

    def write(self, result: LiveResult) -> None:
        """Append the picture, the one before repeated until then; OSError when the disk is full."""
        picture = np.ascontiguousarray(picture_of(result)[..., ::-1])
        if self._writer is None:
            self._open(picture.shape[1], picture.shape[0])
        if (picture.shape[1], picture.shape[0]) != self._size:
            raise ValueError(f"{self._path}: expected pictures of {self._size}, got {picture.shape[1::-1]}")
        if self._last is not None and self._fill_until(result.frame.timestamp_s):
            self._append(picture)
        elif self._last is None:
            self._begin_s = result.frame.timestamp_s
            self._append(picture)
        self._last, self._last_s = picture, result.frame.timestamp_s

    def _fill_until(self, time_s: float) -> bool:
        """Repeat the last picture until `time_s`; whether one of that time is due, which it is not where results come
        more often than pictures."""
        assert self._last is not None
        due = round((time_s - self._begin_s) * FPS)
        goes_on = time_s > self._last_s
        if goes_on and due < self._written:
            return False
        stills = min(due - self._written, LONGEST_STILL) if goes_on else 0
        for _ in range(stills):
            self._append(self._last)
        if self._written != due:
            # After what was cut short, and where the clock stands or goes back, it counts from here.
            self._begin_s = time_s - self._written / FPS
        return True

    def _open(self, width: int, height: int) -> None:
        codec = cv2.VideoWriter.fourcc(*"mp4v")
        self._writer = cv2.VideoWriter(str(self._path), cv2.CAP_FFMPEG, codec, FPS, (width, height))
        if not self._writer.isOpened():
            self._writer = None
            raise OSError(f"{self._path}: OpenCV cannot write a video of {width}x{height} here")
        self._size = width, height

    def _append(self, picture: NDArray[np.uint8]) -> None:
        free = shutil.disk_usage(self._path.parent).free
        if free < MIN_FREE_BYTES:
            raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)} ({free / 1e6:.1f} MB are free)", str(self._path))
        assert self._writer is not None
        self._writer.write(picture)
        self._written += 1

    def close(self) -> None:
        """Finish the file; OSError when it does not hold what was written."""
        if self._writer is None:
            self._path.unlink(missing_ok=True)
            return
        self._writer.release()
        video = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        held = max(0, round(video.get(cv2.CAP_PROP_FRAME_COUNT))) if video.isOpened() else 0
        video.release()
        if held < self._written:
            raise OSError(f"{self._path}: {held} of {self._written} pictures can be played; was the disk full?")
