"""page-calibrate hand-eye: a camera on a robot's hand, or before it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError, Deviations, Provenance
from page_calibration.commands.inputs import board_of, chosen_camera, require_places, write_calibration, write_text
from page_calibration.commands.words import camera_lines
from page_calibration.hand_eye import HandEye, Mount, solve_hand_eye
from page_calibration.pictures import find_views
from page_calibration.pose import board_pose
from page_calibration.report import bars, judged_page
from page_calibration.robot_poses import read_poses
from page_runtime.commands.usage import UsageError
from page_runtime.geometry import Array, invert
from page_runtime.report.page import note, table

# Industrial arms repeat to a tenth of a millimetre; what is above this is a pose that does not belong to its picture.
MAX_SCATTER_M = 0.005


def hand_eye(
    *, robot: Path, target: Path | None, pictures: Path | None, mount: Mount, camera: Path, frame: str | None, out:
    Path, report: Path | None, **options: Any,
) -> None:  # fmt: skip
    """Solve, and write the camera with its place on the hand (world frame "hand") or before the robot ("base")."""
    if (target is None) == (pictures is None):
        raise UsageError("--target, --pictures: expected one of them")
    require_places(out, report)
    calibrated = chosen_camera(camera, frame)
    T_base_hand = read_poses(robot, "T_base_hand")
    T_camera_target = read_poses(target, "T_camera_target") if target is not None else {}
    if pictures is not None:
        views = find_views(str(pictures), board_of(options)).views
        T_camera_target = {view.name: board_pose(calibrated.raw, view).T_camera_board for view in views}
    names = [name for name in T_base_hand if name in T_camera_target]
    if not names:
        raise CalibrationError(
            f"hand-eye: no pose of the robot has the name of a pose of the target ({_some(T_base_hand)} against "
            f"{_some(T_camera_target)})"
        )
    result = solve_hand_eye([T_base_hand[n] for n in names], [T_camera_target[n] for n in names], mount=mount)
    placed = placed_camera(calibrated, result)
    scatter = f"{len(names)} poses, the target scatters by {result.scatter_rms_m * 1e3:.2f} mm rms along each axis"
    write_calibration(
        out, Calibration((placed,), Provenance(f"page-calibrate hand-eye, {mount}", robot.name, (scatter,)))
    )
    write_text(report, report_of(placed, result, names))
    sys.stdout.write("\n".join([*camera_lines(placed), f"  fit      {scatter}", verdict(result)]) + "\n")


def placed_camera(calibrated: CalibratedCamera, result: HandEye) -> CalibratedCamera:
    """The camera with T_camera_world from what it is fixed to: "hand" or "base"."""
    raw = replace(calibrated.raw, camera=replace(calibrated.camera, T_camera_world=invert(result.X)))
    known = calibrated.deviations or Deviations()
    deviations = replace(known, rotation_rad=result.deviations[:3], translation_m=result.deviations[3:])
    world = "hand" if result.mount == "eye-in-hand" else "base"
    return replace(calibrated, raw=raw, world_frame=world, deviations=deviations)


def is_good(result: HandEye) -> bool:
    return result.scatter_rms_m <= MAX_SCATTER_M


def verdict(result: HandEye) -> str:
    worst = float(result.scatter_m.max() * 1e3)
    text = f"The farthest pose puts the target {worst:.1f} mm from the others' place."
    if not is_good(result):
        text += " That is more than an arm and a board err: check units, the order of rotations, and which poses pair."
    return text


def report_of(placed: CalibratedCamera, result: HandEye, names: list[str]) -> str:
    """The one-page report."""
    start = np.linalg.norm((invert(result.start) @ result.X)[:3, 3]) * 1e3
    rows = [
        ("scatter along each axis, rms", f"{result.scatter_rms_m * 1e3:.2f} mm"),
        ("scatter of the turn, rms", f"{np.degrees(np.sqrt((result.scatter_rad**2).mean())):.2f} degrees"),
        ("moved by the refinement", f"{start:.2f} mm"),
    ]
    sections = [
        ("Place", table((), [(line,) for line in camera_lines(placed)])),
        ("Fit", table((), rows) + note("Each pose says where the target is; the scatter is how far they disagree.")),
        ("Each pose", bars(names, result.scatter_m * 1e3, unit="mm")),
    ]
    return judged_page(f"{placed.frame} on {placed.world_frame}", verdict(result), sections, is_good=is_good(result))


def _some(poses: dict[str, Array]) -> str:
    return ", ".join(list(poses)[:3]) or "none"
