"""page-calibrate convert: a calibration in another format, and what that cannot hold."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from page_calibration.calibration import Calibration, CalibrationError
from page_calibration.commands.inputs import require_places, warn
from page_calibration.formats.registry import read_calibration, written
from page_runtime.commands.outputs import text_output

Size = tuple[int, int]


def convert(
    path: Path, *, out: Path, to: str, frame: str | None, size: Size | None, delivered: Size | None, allow_loss: bool
) -> None:
    """Read any format, write `to`; CalibrationError when it cannot hold all of it and `allow_loss` is not given."""
    require_places(out, None)
    calibration = read_calibration(path, size=size)
    warn(calibration)
    if frame is not None:
        calibration = calibration.only(frame)
    if delivered is not None:
        calibration = _delivered(calibration, delivered)
    result = written(calibration, to)
    if result.lost and not allow_loss:
        raise CalibrationError(
            f"{to} cannot hold {', '.join(result.lost)}; nothing was written: choose another format, one camera with "
            "--frame, or --allow-loss"
        )
    with text_output(out) as file:
        file.write(result.text)
    for text in (*result.lost, *result.left_out):
        sys.stderr.write(f"page-calibrate: not in {out.name}: {text}\n")


def _delivered(calibration: Calibration, size: Size) -> Calibration:
    cameras = tuple(replace(camera, raw=camera.raw.covering(*size), deviations=None) for camera in calibration)
    return replace(calibration, cameras=cameras)
