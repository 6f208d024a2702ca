"""page-calibrate register: raw colour and depth pictures to a folder of registered frames."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

from page_calibration.calibration import Calibration
from page_calibration.commands.inputs import warn
from page_calibration.formats.registry import read_calibration, written
from page_calibration.raw_recording import RawRecording, open_raw
from page_runtime.capture.color_depth import INTRINSICS_FILE
from page_runtime.commands.outputs import require_folder_place
from page_runtime.commands.terminal import Progress
from page_runtime.commands.usage import UsageError
from page_runtime.depth_registration import registered_frame, registration_between
from page_runtime.image_files import write_color, write_depth
from page_runtime.lens import NO_DISTORTION, RawCamera


def register(path: Path, *, camera: Path, frames: tuple[str, str], out: Path) -> None:
    """Undistort, register, and write color/, depth/ and camera_intrinsic.json, all or nothing."""
    require_folder_place(out, option="--out")
    if out.exists() and any(out.iterdir()):
        raise UsageError(f"--out: {out} is not empty; registered pictures never overwrite")
    calibration = read_calibration(camera)
    warn(calibration)
    recording = open_raw(path, calibration, color=frames[0], depth=frames[1])
    partial = out.with_name(f".{out.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        _write(recording, partial)
        if out.exists():
            out.rmdir()
        partial.rename(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _write(recording: RawRecording, folder: Path) -> None:
    registration = registration_between(recording.depth.raw, recording.color.raw)
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    with Progress("register", len(recording), quiet=False) as progress:
        for i, (name, color, depth_m) in enumerate(recording):
            frame = registered_frame(registration, color, depth_m, index=i)
            target = name.replace("/", "_")
            write_color(folder / "color" / f"{target}.png", frame.color)
            write_depth(folder / "depth" / f"{target}.png", frame.depth_m, metres_per_unit=recording.depth_unit_m)
            progress.advance()
    text = written(_pinhole(recording), "open3d").text
    (folder / INTRINSICS_FILE).write_text(json.dumps(json.loads(text), indent=1) + "\n", encoding="utf-8")


def _pinhole(recording: RawRecording) -> Calibration:
    color = recording.color
    camera = replace(color, raw=RawCamera(color.camera, NO_DISTORTION), depth_unit_m=recording.depth_unit_m)
    return replace(recording.calibration, cameras=(camera,))
