"""Are these views different enough to calibrate from? Refusals say what to add.

Focal length and distance trade against each other unless boards are tilted; the principal point and tilt trade unless
they are tilted in several directions; the lens is known only where corners were.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from page_calibration.board import View
from page_calibration.calibration import CalibrationError, Deviations
from page_runtime.geometry import Array, rotation_angle
from page_runtime.lens import RawCamera

MIN_VIEWS = 8
# Two views are the same when every corner they share moved by less than this share of the picture's width.
SAME_VIEW = 0.04
# Spread (standard deviation) of the board's tilt along the picture axis where it is least.
MIN_TILT_DEG = 6.0
GRID = (4, 3)
MIN_COVERED = 0.6
MAX_FOCAL_DEVIATION = 0.005
MAX_CENTRE_DEVIATION = 0.01
_COLUMNS, _ROWS = ("left", "middle left", "middle right", "right"), ("upper", "middle", "lower")


def distinct_views(views: Sequence[View], width: int) -> int:
    """How many of the views are not a repetition of one before."""
    kept: list[View] = []
    for view in views:
        if not any(_moved(view, other) < SAME_VIEW * width for other in kept):
            kept.append(view)
    return len(kept)


def _moved(a: View, b: View) -> float:
    _, i, j = np.intersect1d(a.ids, b.ids, return_indices=True)
    return float(np.linalg.norm(a.pixels[i] - b.pixels[j], axis=1).max()) if len(i) else np.inf


def covered_cells(views: Sequence[View], size: tuple[int, int]) -> NDArray[np.bool_]:
    """(3,4) bool, upper left first: whether any corner was seen in that part of the picture."""
    pixels = np.concatenate([view.pixels for view in views])
    columns = np.clip((pixels[:, 0] + 0.5) / size[0] * GRID[0], 0, GRID[0] - 1).astype(int)
    rows = np.clip((pixels[:, 1] + 0.5) / size[1] * GRID[1], 0, GRID[1] - 1).astype(int)
    cells = np.zeros(GRID[::-1], bool)
    cells[rows, columns] = True
    return cells


def require_enough_views(views: Sequence[View], size: tuple[int, int]) -> None:
    """CalibrationError, with what to add, for views too few, too much the same or in one part of the picture."""
    wants = []
    distinct = distinct_views(views, size[0]) if views else 0
    if distinct < MIN_VIEWS:
        repeated = f", {len(views) - distinct} of the {len(views)} repeat another" if distinct < len(views) else ""
        wants.append(
            f"{MIN_VIEWS - distinct} more views (a board was found in {distinct} different ones, {MIN_VIEWS} are the "
            f"least and 15 to 25 are good{repeated})"
        )
    if views:
        cells = covered_cells(views, size)
        if cells.mean() < MIN_COVERED:
            empty = [f"{_ROWS[r]} {_COLUMNS[c]}" for r, c in zip(*np.nonzero(~cells), strict=True)]
            wants.append(f"views with the board in the {', '.join(empty)} of the picture, partly outside it if need be")
    if wants:
        raise CalibrationError(f"too little to calibrate from; add {' and '.join(wants)}")


def tilt_spread_deg(poses: Sequence[Array]) -> float:
    """Standard deviation of the direction of the boards' normals along the axis where it is least, degrees."""
    normals = np.array([T[:3, 2] for T in poses])
    tilts = normals[:, :2] * np.sign(normals[:, 2:])
    return float(np.degrees(np.sqrt(max(np.linalg.eigvalsh(np.cov(tilts.T))[0], 0.0))))


def require_known(raw: RawCamera, deviations: Deviations, views: Sequence[View], poses: Sequence[Array]) -> None:
    """CalibrationError, with what to add, when the views leave focal length or principal point open."""
    assert deviations.intrinsics_px is not None
    K = raw.camera.K
    fx, fy, cx, cy = deviations.intrinsics_px
    wants = []
    spread = tilt_spread_deg(poses)
    if spread < MIN_TILT_DEG:
        most = max(np.degrees(float(rotation_angle(a[:3, :3], b[:3, :3]))) for a in poses for b in poses)
        wants.append(
            "boards tilted by 20 to 40 degrees, some to the left, some to the right, some up, some down (these differ "
            f"by {spread:.1f} degrees in tilt along one axis, {most:.0f} in all)"
        )
    focal = max(fx / K[0, 0], fy / K[1, 1])
    if focal > MAX_FOCAL_DEVIATION:
        wants.append(
            f"boards tilted more and nearer to the camera (the focal length is known to {100 * focal:.1f} %, "
            f"{100 * MAX_FOCAL_DEVIATION:g} % is wanted)"
        )
    centre = max(cx / raw.camera.width, cy / raw.camera.height)
    if centre > MAX_CENTRE_DEVIATION:
        wants.append(
            f"tilts in all directions (the principal point is known to {max(cx, cy):.1f} px, "
            f"{MAX_CENTRE_DEVIATION * raw.camera.width:.1f} are wanted)"
        )
    if wants:
        raise CalibrationError(f"the {len(views)} views are too alike; add {', and '.join(wants)}")
