"""Where a board is, seen by a calibrated camera: T_camera_board, its other solution, and how well it is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from page_calibration.board import View
from page_calibration.calibration import CalibrationError
from page_calibration.rotation_vectors import rotation_of
from page_runtime.geometry import Array, rotation_angle, transform_from
from page_runtime.lens import RawCamera

# Refined solutions nearer than this are one.
SAME_RAD = 0.005


@dataclass(frozen=True, eq=False, slots=True)
class BoardPose:
    """T_camera_board (4,4), metres. rms_px: of its corners. rival_rms_px: of the plane's other solution, the tilt
    mirrored; near rms_px the pose is a guess; infinite where there is no other. deviations: (6,) rad and metres, of a
    small turn and shift in camera axes."""

    T_camera_board: Array
    rms_px: float
    rival_rms_px: float
    deviations: Array


def board_pose(raw: RawCamera, view: View) -> BoardPose:
    """The pose of the board in one view. CalibrationError when its corners have no ray in this camera."""
    plane = raw.rays(view.pixels)[:, :2]
    has_ray = ~np.isnan(plane).any(axis=1)
    if has_ray.sum() < 4:
        raise CalibrationError(
            f"{view.name}: its corners lie where the lens model has no rays; calibrate the lens again"
        )
    points, plane = view.points_board[has_ray], plane[has_ray]
    _, rotations, translations, _ = cv2.solvePnPGeneric(points, plane, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    solutions = []
    for rotation, translation in zip(rotations, translations, strict=True):
        refined = cv2.solvePnPRefineLM(points, plane, np.eye(3), None, rotation.copy(), translation.copy())
        T = transform_from(
            rotation_of(np.asarray(refined[0], dtype=float)), np.asarray(refined[1], dtype=float).ravel()
        )
        residuals = view.pixels[has_ray] - raw.project(points @ T[:3, :3].T + T[:3, 3])
        solutions.append((float(np.sqrt((residuals**2).sum(axis=1).mean())), T))
    solutions.sort(key=lambda solution: solution[0] if np.isfinite(solution[0]) else np.inf)
    rms, T = solutions[0]
    # Seen from near, the mirrored start ends in the same pose: no second one fits even locally.
    rivals = [own for own, R in ((r, S[:3, :3]) for r, S in solutions[1:]) if rotation_angle(T[:3, :3], R) > SAME_RAD]
    rival = rivals[0] if rivals else np.inf
    return BoardPose(T, rms, rival, _deviations(raw, points, T, rms))


def _deviations(raw: RawCamera, points_board: Array, T_camera_board: Array, rms_px: float) -> Array:
    step = 1e-6
    columns = []
    for i in range(6):
        ends = []
        for sign in (1.0, -1.0):
            twist = np.zeros(6)
            twist[i] = sign * step
            T = T_camera_board.copy()
            T[:3, :3] = rotation_of(twist[:3]) @ T[:3, :3]
            T[:3, 3] += twist[3:]
            ends.append(raw.project(points_board @ T[:3, :3].T + T[:3, 3]).ravel())
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    J = np.stack(columns, axis=1)
    variance = rms_px**2 / 2.0 * J.shape[0] / max(J.shape[0] - 6, 1)
    return np.sqrt(np.diag(np.linalg.pinv(J.T @ J)) * variance)


def joined(views: Sequence[View]) -> View:
    """Views of a camera and a board that both stood still, as one."""
    return View(
        f"{len(views)} views" if len(views) > 1 else views[0].name,
        np.concatenate([view.ids for view in views]),
        np.concatenate([view.points_board for view in views]),
        np.concatenate([view.pixels for view in views]),
    )
