"""Raw recordings: color/ and depth/ as two cameras took them, not registered, lenses in; and their calibration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError
from page_runtime.capture.color_depth import paired_pictures
from page_runtime.image_files import read_color, read_depth, read_header, require_depth_header

MILLIMETRE = 1e-3


@dataclass(frozen=True, eq=False, slots=True)
class RawRecording:
    """pairs: name, colour picture and depth picture of each frame. depth_unit_m: metres of a unit of depth."""

    path: Path
    calibration: Calibration
    color: CalibratedCamera
    depth: CalibratedCamera
    depth_unit_m: float
    pairs: tuple[tuple[str, Path, Path], ...]

    def __len__(self) -> int:
        return len(self.pairs)

    def __iter__(self) -> Iterator[tuple[str, NDArray[np.uint8], NDArray[np.float32]]]:
        """Name, colour (H,W,3) uint8 RGB, depth (h,w) float32 metres of each frame."""
        for name, color, depth in self.pairs:
            yield name, read_color(color), read_depth(depth, metres_per_unit=self.depth_unit_m)


def open_raw(path: Path, calibration: Calibration, *, color: str, depth: str) -> RawRecording:
    """The recording in a folder, checked whole; depth is in millimetres unless its camera says otherwise."""
    cameras = calibration[color], calibration[depth]
    calibration.transform(color, depth)
    colors, depths = paired_pictures(path)
    for name, file in colors.items():
        headers = read_header(file), require_depth_header(depths[name])
        for camera, header, picture in zip(cameras, headers, (file, depths[name]), strict=True):
            size = camera.camera.width, camera.camera.height
            if (header.width, header.height) != size:
                raise CalibrationError(
                    f"{picture} is {header.width}x{header.height}, but {camera.frame!r} was calibrated at "
                    f"{size[0]}x{size[1]}; K belongs to one resolution (page-calibrate convert --delivered)"
                )
    unit = cameras[1].depth_unit_m or MILLIMETRE
    pairs = tuple((name, file, depths[name]) for name, file in colors.items())
    return RawRecording(path, calibration, *cameras, unit, pairs)
