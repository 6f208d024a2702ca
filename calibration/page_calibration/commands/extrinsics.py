"""page-calibrate extrinsics: where a camera stands, from a board."""

from __future__ import annotations

import sys
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

from page_calibration.calibration import Calibration, CalibrationError, Provenance
from page_calibration.camera_json import matrix, rigid
from page_calibration.commands.inputs import board_of, chosen_camera, require_places, write_calibration, write_text
from page_calibration.commands.words import camera_lines
from page_calibration.extrinsics import deviations_of, locate_camera
from page_calibration.pictures import find_views
from page_calibration.report import coverage, judged_page
from page_runtime.capture.documents import field, read_object
from page_runtime.geometry import apply
from page_runtime.report.page import note, table


def extrinsics(
    pictures: Path, *, camera: Path, frame: str | None, board_pose: Path | None, world: str, out: Path, report: Path |
    None, **options: Any,
) -> None:  # fmt: skip
    """Locate the camera and write it, placed in the world, to camera.json."""
    board = board_of(options)
    require_places(out, report)
    calibrated, found = chosen_camera(camera, frame), find_views(str(pictures), board)
    raw = calibrated.raw
    if (raw.camera.width, raw.camera.height) != found.size:
        raise CalibrationError(
            f"{camera} is for {raw.camera.width}x{raw.camera.height}, the pictures are "
            f"{found.size[0]}x{found.size[1]}; give the calibration of this size (page-calibrate convert --delivered)"
        )
    T_world_board = None
    if board_pose is not None:
        where = f"{board_pose}, T_world_board"
        value = field(read_object(board_pose), "T_world_board", where=str(board_pose))
        T_world_board = rigid(matrix(value, 4, 4, where=where), where=where)
    T_camera_world, pose = locate_camera(raw, found.views, T_world_board=T_world_board)
    deviations = deviations_of(pose)
    if calibrated.deviations is not None:
        known = calibrated.deviations
        deviations = replace(deviations, intrinsics_px=known.intrinsics_px, distortion=known.distortion)
    placed = replace(
        calibrated,
        raw=replace(raw, camera=replace(raw.camera, T_camera_world=T_camera_world)),
        world_frame=world,
        deviations=deviations,
    )
    rival = f"the mirrored tilt {pose.rival_rms_px:.2f} px" if isfinite(pose.rival_rms_px) else "no other tilt fits"
    figures = f"{len(found.views)} pictures, rms {pose.rms_px:.3f} px, {rival}"
    provenance = Provenance("page-calibrate extrinsics", str(pictures), (f"{board}", figures))
    write_calibration(out, Calibration((placed,), provenance))
    residuals = [view.pixels - raw.project(apply(pose.T_camera_board, view.points_board)) for view in found.views]
    shift_mm = pose.deviations[3:].max() * 1e3
    verdict = f"The camera is known to {shift_mm:.2f} mm in {world!r}, as far as its own K is right."
    sections = [
        ("Place", table((), [(line,) for line in camera_lines(placed)])),
        ("Fit", table((), [("fit", figures), ("board", f"{board}")])),
        ("Corners", coverage(found.size, [view.pixels for view in found.views], residuals, magnified=100.0)),
        ("Frames", note(f"T_camera_world maps from {world!r}: the board's frame unless --board-pose was given.")),
    ]
    write_text(report, judged_page(f"{placed.frame} in {world}", verdict, sections, is_good=True))
    sys.stdout.write("\n".join([*camera_lines(placed), f"  fit      {figures}", verdict]) + "\n")
