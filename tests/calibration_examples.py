"""Cameras with lenses and places, to be written in every format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, Provenance
from page_calibration.formats.registry import read_calibration, written
from page_runtime.camera import Camera
from page_runtime.geometry import rotation_about, transform_from
from page_runtime.lens import Distortion, RawCamera

K = np.array([[612.25, 0.0, 318.4], [0.0, 611.875, 241.7], [0.0, 0.0, 1.0]])
SMALL = ("none", ()), ("brown-conrady", (0.11, -0.23, 0.0007, -0.0004)), ("kannala-brandt", (0.01, 0.02, -0.01, 0.002))


def camera(
    frame: str = "color", world: str | None = None, T: np.ndarray | None = None, **changes: Any
) -> CalibratedCamera:
    lens = Distortion(*changes.pop("lens", SMALL[1]))
    raw = RawCamera(Camera(changes.pop("K", K), 640, 480, np.eye(4) if T is None else T), lens)
    return CalibratedCamera(frame, world or frame, raw, **changes)


def calibration(*cameras: CalibratedCamera) -> Calibration:
    return Calibration(cameras or (camera(),), Provenance("test", "nowhere"))


def placed(angle: float = 0.1, shift: float = 0.07) -> np.ndarray:
    return transform_from(rotation_about(np.array([0.3, 1.0, -0.2]), angle), np.array([shift, 0.004, -0.01]))


def write_as(tmp_path: Path, name: str, text: str) -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def again(tmp_path: Path, before: Calibration, name: str) -> Calibration:
    path = write_as(tmp_path, f"again-{name}", written(before, name).text)
    first = before.cameras[0].camera
    return read_calibration(path, size=(first.width, first.height))
