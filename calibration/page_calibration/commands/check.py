"""page-calibrate check: does this calibration fit this recording?"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from page_calibration.calibration import Calibration, CalibrationError
from page_calibration.check import Finding, Picture, check_pair
from page_calibration.commands.inputs import warn, write_text
from page_calibration.edges import depth_outlines
from page_calibration.epipolar_check import check_stereo
from page_calibration.formats.registry import read_calibration
from page_calibration.raw_recording import RawRecording, open_raw
from page_calibration.registered_check import check_frames
from page_calibration.report import bars, judged_page
from page_calibration.suspects import Suspect
from page_runtime.capture.documents import pictures as pictures_in
from page_runtime.capture.playback import open_source
from page_runtime.commands.outputs import require_file_place
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import apply, invert
from page_runtime.image_files import read_color
from page_runtime.lens import RawCamera
from page_runtime.report.page import note, pictures, table

# Frames looked at, spread over the recording.
MAX_FRAMES = 5
# (H,W,3) RGB and its caption.
DrawnPicture = tuple[NDArray[np.uint8], str]


def check(path: Path, *, camera: Path | None, frames: tuple[str, str], report: Path | None) -> int:
    """Judge, write the report; the exit code: 0 it fits or cannot be told, 1 it does not."""
    require_file_place(report, option="--report")
    calibration = None if camera is None else read_calibration(camera)
    if calibration is not None:
        warn(calibration)
    drawn: list[DrawnPicture] = []
    is_stereo = all((path / frame).is_dir() for frame in frames) and frames[1] != "depth"
    if calibration is not None and is_stereo:
        finding = _stereo(path, calibration, frames)
    elif calibration is not None and set(frames) <= set(calibration.frames):
        recording = open_raw(path, calibration, color=frames[0], depth=frames[1])
        finding, drawn = _raw(recording)
    else:
        source = open_source(path)
        shown = [source.entries[i].read().frame for i in _spread(len(source))]
        if calibration is not None:
            given = calibration.cameras[0].camera
            shown = [replace(one, camera=replace(given, T_camera_world=one.camera.T_camera_world)) for one in shown]
        finding = check_frames(shown)
        drawn = [_drawn_frame(shown[0])]
    write_text(report, report_of(path, finding, drawn))
    mark = {None: "cannot tell", "none": "fits"}.get(finding.fault, "does not fit")
    sys.stdout.write(f"{path}: {mark}: {finding.words}\n")
    return 0 if finding.fault in (None, "none") else 1


def _spread(count: int) -> list[int]:
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, MAX_FRAMES))})


def _raw(recording: RawRecording) -> tuple[Finding, list[DrawnPicture]]:
    wanted = set(_spread(len(recording)))
    chosen = replace(recording, pairs=tuple(pair for i, pair in enumerate(recording.pairs) if i in wanted))
    pairs: list[Picture] = [(color, depth_m) for _, color, depth_m in chosen]
    finding = check_pair(recording.depth.raw, recording.color.raw, pairs)
    given = Suspect("none", "as given", recording.depth.raw, recording.color.raw)
    drawn = [_drawn(pairs[0], given, "Outlines in depth, by the calibration as given.")]
    if finding.best is not None and finding.fault not in (None, "none"):
        drawn.append(_drawn(pairs[0], finding.best, "Outlines in depth, with the mistake undone."))
    return finding, drawn


def _stereo(path: Path, calibration: Calibration, frames: tuple[str, str]) -> Finding:
    """Two folders of pictures, named like their cameras; pictures of one moment have one name."""
    calibration.transform(*frames)
    first, second = (pictures_in(path / frame) for frame in frames)
    names = [name for name in first if name in second]
    if not names:
        raise CalibrationError(f"{path}: no picture of {frames[0]}/ has a partner of its name in {frames[1]}/")
    grays = []
    for name in (names[i] for i in _spread(len(names))):
        pair = []
        for folder, frame in ((first, frames[0]), (second, frames[1])):
            gray = np.asarray(cv2.cvtColor(read_color(folder[name]), cv2.COLOR_RGB2GRAY), dtype=np.uint8)
            camera = calibration[frame].camera
            if gray.shape != (camera.height, camera.width):
                raise CalibrationError(
                    f"{folder[name]} is {gray.shape[1]}x{gray.shape[0]}, but {frame!r} was calibrated at "
                    f"{camera.width}x{camera.height}; K belongs to one resolution (page-calibrate convert --delivered)"
                )
            pair.append(gray)
        grays.append((pair[0], pair[1]))
    return check_stereo(calibration[frames[0]].raw, calibration[frames[1]].raw, grays)


def _drawn(picture: Picture, suspect: Suspect, caption: str) -> DrawnPicture:
    color, depth_m = picture
    points = apply(invert(suspect.depth.camera.T_camera_world), depth_outlines(depth_m).points(suspect.depth))
    return _dotted(color, suspect.color.project(points)), caption


def _drawn_frame(frame: RgbdFrame) -> DrawnPicture:
    raw = RawCamera(replace(frame.camera, T_camera_world=np.eye(4)))
    points = raw.project(depth_outlines(frame.depth_m).points(raw))
    return _dotted(frame.color, points), "Outlines in depth, on the colour picture."


def _dotted(color: NDArray[np.uint8], pixels: NDArray[np.floating]) -> NDArray[np.uint8]:
    drawn = np.ascontiguousarray(color // 2 + 60)
    for u, v in pixels[np.isfinite(pixels).all(axis=1) & (np.abs(pixels) < 1e4).all(axis=1)]:
        cv2.circle(drawn, (round(float(u)), round(float(v))), 1, (255, 60, 40), -1)
    return drawn


def report_of(path: Path, finding: Finding, drawn: list[DrawnPicture]) -> str:
    """The one-page report."""
    sections = [("Pictures", pictures(drawn))] if drawn else []
    if finding.scores:
        names, values = [name for name, _ in finding.scores], np.array([max(score, 0.0) for _, score in finding.scores])
        sections.append(("What if", table((), [(n, f"{v:.2f}") for n, v in zip(names, values, strict=True)])))
        sections.append(("", bars(["as given", "the best"], np.array([values[0], values.max()]), unit="of the best")))
    sections.append(("Figures", note(f"{finding.outlines} points.")))
    return judged_page(f"Calibration against {path.name}", finding.words, sections, is_good=finding.fault == "none")
