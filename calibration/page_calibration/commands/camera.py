"""page-calibrate camera: K and lens of one camera."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, Provenance
from page_calibration.commands.inputs import board_of, require_places, tell, write_calibration, write_text
from page_calibration.commands.words import camera_lines
from page_calibration.intrinsics import IntrinsicCalibration, LensKind, calibrate_intrinsics
from page_calibration.pictures import FoundViews, find_views
from page_calibration.report import bars, coverage, judged_page
from page_calibration.views import tilt_spread_deg
from page_runtime.report.page import note, table

# A held-out error this much above the fit's own: the lens has more coefficients than the views can tell.
MAX_HOLDOUT_RATIO = 1.5


def camera(
    source: str, *, out: Path, report: Path | None, lens: LensKind, name: str, views: int, **options: Any
) -> None:
    """Calibrate, write camera.json and the report, say how well it is known."""
    board = board_of(options)
    require_places(out, report)
    found = find_views(source, board, wanted=views, told=tell)
    result = calibrate_intrinsics(found.views, found.size, lens=lens)
    calibrated = CalibratedCamera(name, name, result.raw, deviations=result.deviations)
    figures = f"{len(result.views)} views, rms {result.rms_px:.3f} px, held out {result.holdout_px:.3f} px"
    notes = (f"{board}", figures)
    write_calibration(out, Calibration((calibrated,), Provenance(f"page-calibrate camera, {lens}", source, notes)))
    write_text(report, report_of(calibrated, result, found, str(board)))
    lines = [*camera_lines(calibrated), f"  fit      {figures}", verdict(result)]
    sys.stdout.write("\n".join(lines) + "\n")


def verdict(result: IntrinsicCalibration) -> str:
    """What to make of it, in a sentence."""
    known = result.deviations.intrinsics_px
    assert known is not None
    focal = 100 * float(known[0] / result.raw.camera.K[0, 0])
    text = f"The focal length is known to {focal:.2f} %, the principal point to {max(known[2:]):.2f} px."
    if not is_good(result):
        text += " Views left out fit much worse than those used: take more views, or a lens with fewer coefficients."
    return text


def is_good(result: IntrinsicCalibration) -> bool:
    return result.holdout_px <= MAX_HOLDOUT_RATIO * result.rms_px


def report_of(calibrated: CalibratedCamera, result: IntrinsicCalibration, found: FoundViews, board: str) -> str:
    """The one-page report."""
    K, lens, known = result.raw.camera.K, result.raw.distortion, result.deviations
    assert known.intrinsics_px is not None
    assert known.distortion is not None
    names = ("fx, px", "fy, px", "cx, px", "cy, px", *(f"lens {i + 1}" for i in range(len(lens.coefficients))))
    values = np.concatenate([K[[0, 1, 0, 1], [0, 1, 2, 2]], lens.coefficients])
    deviations = np.concatenate([known.intrinsics_px, known.distortion])
    rows = [(n, f"{v:.6g}", f"{d:.2g}") for n, v, d in zip(names, values, deviations, strict=True)]
    fit = [
        ("board", board),
        ("picture", f"{found.size[0]}x{found.size[1]}"),
        ("lens model", lens.model),
        ("views used", f"{len(result.views)}, {sum(len(view.ids) for view in result.views)} corners"),
        ("corners left out", f"{result.outliers}"),
        ("rms of the fit", f"{result.rms_px:.3f} px"),
        ("rms of views held out", f"{result.holdout_px:.3f} px"),
        ("spread of tilts, least axis", f"{tilt_spread_deg(result.T_camera_board):.1f} degrees"),
    ]
    rms = max(result.rms_px, 1e-3)
    magnified = float(10 ** np.floor(np.log10(0.02 * found.size[0] / rms)))
    sections = [
        ("Camera", table(("", "value", "standard deviation"), rows) + note("Delete-one-view jackknife.")),
        ("Fit", table((), fit)),
        (
            "Where the corners were",
            coverage(found.size, [view.pixels for view in result.views], result.residuals_px, magnified=magnified),
        ),
        ("Each view", bars([view.name for view in result.views], result.view_rms_px, unit="px")),
    ]
    if found.unused:
        sections.append(("Pictures not used", table((), found.unused)))
    return judged_page(f"Calibration of {calibrated.frame}", verdict(result), sections, is_good=is_good(result))
