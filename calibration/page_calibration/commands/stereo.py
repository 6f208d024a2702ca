"""page-calibrate stereo: where two cameras are to each other."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError, Provenance, baseline_m
from page_calibration.commands.inputs import board_of, chosen_camera, require_places, write_calibration, write_text
from page_calibration.commands.words import camera_lines
from page_calibration.pictures import find_views
from page_calibration.report import bars, judged_page
from page_calibration.stereo import StereoCalibration, calibrate_stereo
from page_runtime.report.page import note, table

# Corners are found to a tenth of a pixel; a pixel off their epipolar lines is another rig, or a board that moved.
MAX_EPIPOLAR_PX = 1.0


def stereo(
    first: Path, second: Path, *, cameras: tuple[Path, Path], out: Path, report: Path | None, **options: Any
) -> None:
    """Calibrate, write both cameras into one camera.json, placed in the first one's frame."""
    board = board_of(options)
    require_places(out, report)
    pair = []
    for path, pictures in zip(cameras, (first, second), strict=True):
        calibrated, found = chosen_camera(path, None), find_views(str(pictures), board)
        size = calibrated.camera.width, calibrated.camera.height
        if size != found.size:
            raise CalibrationError(
                f"{path} is for {size[0]}x{size[1]}, the pictures in {pictures} are {found.size[0]}x{found.size[1]}; "
                "give the calibration of this size (page-calibrate convert --delivered)"
            )
        pair.append((calibrated, found.views))
    (a, views_a), (b, views_b) = pair
    if a.frame == b.frame:
        raise CalibrationError(f"both cameras are called {a.frame!r}; calibrate them with different --name")
    result = calibrate_stereo(a.raw, b.raw, views_a, views_b)
    placed = (_placed(a, np.eye(4), a.frame), _placed(b, result.T_b_a, a.frame, result))
    figures = f"{len(result.pairs)} pairs, {result.epipolar_px:.3f} px off epipolar lines"
    calibration = Calibration(placed, Provenance("page-calibrate stereo", f"{first}, {second}", (f"{board}", figures)))
    write_calibration(out, calibration)
    write_text(report, report_of(calibration, result))
    sys.stdout.write("\n".join([*camera_lines(placed[1]), f"  fit      {figures}", verdict(result)]) + "\n")


def _placed(
    camera: CalibratedCamera, T_camera_world: np.ndarray, world: str, result: StereoCalibration | None = None
) -> CalibratedCamera:
    raw = replace(camera.raw, camera=replace(camera.camera, T_camera_world=T_camera_world))
    deviations = camera.deviations
    if result is not None:
        own = {} if deviations is None else {n: getattr(deviations, n) for n in ("intrinsics_px", "distortion")}
        deviations = replace(result.deviations, **own)
    return replace(camera, raw=raw, world_frame=world, deviations=deviations)


def verdict(result: StereoCalibration) -> str:
    shift = result.deviations.translation_m
    assert shift is not None
    text = f"The cameras are {baseline_m(result.T_b_a) * 1e3:.2f} mm apart, known to {shift.max() * 1e3:.2f} mm."
    if result.epipolar_px > MAX_EPIPOLAR_PX:
        text += (
            " Corners are far off their epipolar lines: calibrate each camera again, or take pairs at the same moment."
        )
    return text


def report_of(calibration: Calibration, result: StereoCalibration) -> str:
    """The one-page report."""
    shift, turn = result.deviations.translation_m, result.deviations.rotation_rad
    assert shift is not None
    assert turn is not None
    t = result.T_b_a[:3, 3] * 1e3
    rows = [
        (f"{axis}, mm", f"{t[i]:.3f}", f"{shift[i] * 1e3:.3f}", f"{np.degrees(turn[i]):.4f}")
        for i, axis in enumerate("xyz")
    ]
    b, a = calibration.frames[1], calibration.frames[0]
    place = table((f"{a} in {b}", "shift", "standard deviation", "of the turn, degrees"), rows)
    sections = [
        ("Place", place + note("Delete-one-pair jackknife.")),
        (
            "Fit",
            table((), [("off epipolar lines, rms", f"{result.epipolar_px:.3f} px"), ("pairs", str(len(result.pairs)))]),
        ),
        ("Each pair", bars(result.pairs, result.pair_rms_px, unit="px")),
    ]
    return judged_page(f"{b} to {a}", verdict(result), sections, is_good=result.epipolar_px <= MAX_EPIPOLAR_PX)
