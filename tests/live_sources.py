"""Sources for child processes: frames whose pixels say their number, and every way to stop."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from page_runtime.camera import Camera
from page_runtime.capture.frame_service import DeviceUnavailable, LiveFrame
from page_runtime.image_files import SourceError

WIDTH, HEIGHT = 64, 48
PERIOD_S = 1 / 60
CAMERA = Camera(np.array([[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]]), WIDTH, HEIGHT)


def numbered(number: int, *, timestamp_s: float | None = None) -> LiveFrame:
    """Colour of number modulo 251, depth of 1000 + number mm."""
    color = np.full((HEIGHT, WIDTH, 3), number % 251, np.uint8)
    depth = np.full((HEIGHT, WIDTH), 1000 + number, np.uint16)
    return LiveFrame(color, depth, 1e-3, CAMERA, number * PERIOD_S if timestamp_s is None else timestamp_s)


def count_up(
    stopping: threading.Event, *, frames: int | None = None, period_s: float = PERIOD_S
) -> Iterator[LiveFrame]:
    """So many frames, or on and on."""
    number = 0
    while not stopping.is_set() and (frames is None or number < frames):
        yield numbered(number)
        number += 1
        time.sleep(period_s)


def kill_itself(stopping: threading.Event, *, folder: str, signals: tuple[int, ...], after: int) -> Iterator[LiveFrame]:
    """Each start ends after so many frames by the next of the signals; then on and on. The folder counts the starts."""
    start = len(list(Path(folder).iterdir()))
    (Path(folder) / str(start)).touch()
    for number, frame in enumerate(count_up(stopping)):
        if number == after and start < len(signals):
            os.kill(os.getpid(), signals[start])
        yield frame


def read_null_pointer(stopping: threading.Event) -> Iterator[LiveFrame]:
    """A real segmentation fault after three frames, at every start."""
    import ctypes

    yield from count_up(stopping, frames=3)
    ctypes.string_at(0)


def stall(stopping: threading.Event, *, folder: str, frames: int) -> Iterator[LiveFrame]:
    """The first start goes silent after so many frames, deaf to being stopped; later ones run on."""
    first = not any(Path(folder).iterdir())
    (Path(folder) / str(os.getpid())).touch()
    yield from count_up(stopping, frames=frames if first else None)
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
    time.sleep(3600)


def fail(stopping: threading.Event, *, kind: str) -> Iterator[LiveFrame]:
    """Raises before the first frame, or (lost) when there were some."""
    del stopping
    if kind == "absent":
        raise DeviceUnavailable("no camera: plug one in")
    if kind == "wrong":
        raise SourceError("colour and depth are never in sync")
    if kind == "crash":
        os.write(2, b"the library's last words\n")
        raise RuntimeError("X_LINK_ERROR")
    yield numbered(0)
    time.sleep(0.2)
    raise SourceError("the camera was unplugged")


def grow(stopping: threading.Event) -> Iterator[LiveFrame]:
    """The second frame is larger than the first."""
    yield numbered(0)
    time.sleep(0.05)
    camera = CAMERA.resized(2 * WIDTH, 2 * HEIGHT)
    color = np.zeros((camera.height, camera.width, 3), np.uint8)
    while not stopping.is_set():
        yield LiveFrame(color, np.zeros(color.shape[:2], np.uint16), 1e-3, camera, 1.0)
