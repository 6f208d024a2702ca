"""What several commands are given and write: boards, calibrations, files that appear whole."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from page_calibration.board import Board, View
from page_calibration.calibration import CalibratedCamera, Calibration
from page_calibration.camera_json import to_json
from page_calibration.formats.registry import read_calibration
from page_calibration.plausibility import require_plausible
from page_runtime.commands.outputs import require_file_place, text_output
from page_runtime.commands.usage import UsageError

BOARD_OPTIONS = ("board", "squares", "square_mm", "marker_mm", "dictionary", "legacy")


def board_of(options: dict[str, Any]) -> Board:
    """The board of the options in BOARD_OPTIONS, which are taken out of `options`."""
    given = {name: options.pop(name) for name in BOARD_OPTIONS}
    if given["squares"] is None or given["square_mm"] is None:
        raise UsageError("--squares and --square-mm: expected the board's, as it is printed")
    columns, rows = given["squares"]
    return Board(
        given["board"], columns, rows, given["square_mm"] * 1e-3, given["marker_mm"] * 1e-3, given["dictionary"],
        given["legacy"],
    )  # fmt: skip


def chosen_camera(path: Path, frame: str | None) -> CalibratedCamera:
    """One camera of a calibration file."""
    calibration = read_calibration(path)
    warn(calibration)
    if frame is None and len(calibration) > 1:
        raise UsageError(f"{path}: it has the cameras {', '.join(calibration.frames)}; choose one with --frame")
    return calibration[frame or calibration.frames[0]]


def warn(calibration: Calibration) -> None:
    """What looks wrong, on standard error."""
    for warning in calibration.provenance.warnings:
        sys.stderr.write(f"page-calibrate: warning: {warning}\n")


def require_places(out: Path | None, report: Path | None) -> None:
    """UsageError unless both files can be made; asked before anything is computed."""
    require_file_place(out, option="--out")
    require_file_place(report, option="--report")


def write_calibration(path: Path, calibration: Calibration) -> None:
    """camera.json, whole or not at all, and only if a camera can be like that."""
    with text_output(path) as file:
        file.write(to_json(require_plausible(calibration)))


def write_text(path: Path | None, text: str) -> None:
    if path is not None:
        with text_output(path) as file:
            file.write(text)


def tell(name: str, found: View | str) -> None:
    """A line on standard error for a picture looked at."""
    text = found if isinstance(found, str) else f"{len(found.ids)} corners"
    sys.stderr.write(f"{name}: {text}\n")
