"""Where a camera that stands still is, in the frame of a board or of the world the board was measured in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from page_calibration.board import View
from page_calibration.calibration import CalibrationError, Deviations
from page_calibration.pose import BoardPose, board_pose, joined
from page_runtime.geometry import Array, invert
from page_runtime.lens import RawCamera

# A plane seen from the front or from afar has two poses that fit; the wrong one must fit this much worse.
MIN_RIVAL = 1.5
# Pixels a corner may be away from its middle over all pictures; beyond it something moved.
MAX_MOTION_PX = 2.0


def locate_camera(
    raw: RawCamera, views: Sequence[View], *, T_world_board: Array | None = None
) -> tuple[Array, BoardPose]:
    """(T_camera_world, the board's pose) of a camera that saw a board that did not move, in one or more pictures.

    T_world_board: (4,4) where the board is in the world; without it the board's frame is the world. CalibrationError
    when something moved, or when the tilt of the board cannot be told from its mirror image.
    """
    if not views:
        raise CalibrationError("extrinsics: the board was found in no picture")
    _require_still(views)
    pose = board_pose(raw, joined(views))
    if pose.rival_rms_px < MIN_RIVAL * pose.rms_px:
        raise CalibrationError(
            f"extrinsics: the board's tilt and its mirror image fit alike ({pose.rms_px:.2f} and "
            f"{pose.rival_rms_px:.2f} px); bring the board nearer, or look at it from more aside (30 to 60 degrees)"
        )
    T_board_world = np.eye(4) if T_world_board is None else invert(T_world_board)
    return pose.T_camera_board @ T_board_world, pose


def deviations_of(pose: BoardPose) -> Deviations:
    """As a camera's deviations carry them."""
    return Deviations(rotation_rad=pose.deviations[:3], translation_m=pose.deviations[3:])


def _require_still(views: Sequence[View]) -> None:
    together = joined(views)
    for corner in np.unique(together.ids):
        pixels = together.pixels[together.ids == corner]
        moved = np.linalg.norm(pixels - np.median(pixels, axis=0), axis=1).max()
        if moved > MAX_MOTION_PX:
            raise CalibrationError(
                f"extrinsics: corner {corner} of the board moved by {moved:.1f} px between the pictures; camera and "
                "board must stand still"
            )
