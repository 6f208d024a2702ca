"""K and lens of one camera from views of a board, and how well they are known.

OpenCV fits; this module says what the fit is worth. Corners of one view err together (blur, light, a bent board), so
standard deviations are not read off the residuals as if every corner were independent: they are the delete-one-view
jackknife, linearised at the optimum (Efron, The Jackknife, 1982). Views that leave K open are refused with what to add.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from page_calibration.board import View
from page_calibration.calibration import CalibrationError, Deviations
from page_calibration.pose import board_pose
from page_calibration.rotation_vectors import rotation_of
from page_calibration.views import require_enough_views, require_known
from page_runtime.camera import Camera
from page_runtime.geometry import Array, transform_from
from page_runtime.lens import Distortion, DistortionModel, RawCamera

LensKind = Literal["plumb-bob", "rational", "fisheye"]
LENSES: dict[LensKind, tuple[DistortionModel, int]] = {
    "plumb-bob": ("brown-conrady", 5),
    "rational": ("brown-conrady", 8),
    "fisheye": ("kannala-brandt", 4),
}
FOLDS = 5
# A corner farther off than this many robust standard deviations was found at something else; it is left out, and said.
OUTLIER_SIGMAS = 6.0
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
_STEP = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class IntrinsicCalibration:
    """raw: K, size, lens. views: used, with T_camera_board of each and residuals_px (n,2) of its corners, found minus
    projected. rms_px: of all residuals; view_rms_px: of each view. holdout_px: rms of views left out of the fit.
    outliers: corners left out."""

    raw: RawCamera
    deviations: Deviations
    views: tuple[View, ...]
    T_camera_board: tuple[Array, ...]
    residuals_px: tuple[Array, ...]
    holdout_px: float
    outliers: int

    @property
    def rms_px(self) -> float:
        return _rms(np.concatenate(self.residuals_px))

    @property
    def view_rms_px(self) -> Array:
        return np.array([_rms(residuals) for residuals in self.residuals_px])


def calibrate_intrinsics(
    views: Sequence[View], size: tuple[int, int], *, lens: LensKind = "plumb-bob"
) -> IntrinsicCalibration:
    """Calibrate from views of a board in pictures of `size` (width, height).

    CalibrationError when the views are too few or too alike to tell K, with what to add.
    """
    require_enough_views(views, size)
    raw, poses = _fitted(views, size, lens)
    kept = [_without_outliers(raw, view, T) for view, T in zip(views, poses, strict=True)]
    outliers = sum(len(a.ids) - len(b.ids) for a, b in zip(views, kept, strict=True))
    if outliers:
        raw, poses = _fitted(kept, size, lens)
    residuals = tuple(_residuals(raw, view, T) for view, T in zip(kept, poses, strict=True))
    deviations = jackknife(raw, kept, poses)
    require_known(raw, deviations, kept, poses)
    return IntrinsicCalibration(raw, deviations, tuple(kept), poses, residuals, _holdout(kept, size, lens), outliers)


def _fitted(views: Sequence[View], size: tuple[int, int], lens: LensKind) -> tuple[RawCamera, tuple[Array, ...]]:
    model, count = LENSES[lens]
    boards = [view.points_board.astype(np.float32)[None] for view in views]
    pixels = [view.pixels.astype(np.float32)[None] for view in views]
    K, D = np.eye(3), np.zeros((count, 1))
    try:
        if model == "kannala-brandt":
            flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
            _, K, D, rotations, translations = cv2.fisheye.calibrate(
                boards, pixels, size, K, D, flags=flags, criteria=_CRITERIA
            )
        else:
            _, K, D, rotations, translations = cv2.calibrateCamera(
                boards, pixels, size, K, D, flags=cv2.CALIB_RATIONAL_MODEL if count == 8 else 0, criteria=_CRITERIA
            )
    except cv2.error as error:
        raise CalibrationError(
            f"OpenCV finds no {lens} camera for these {len(views)} views ({error.err}); is the board's size right?"
        ) from error
    poses = tuple(
        transform_from(rotation_of(np.asarray(r, dtype=float)), np.asarray(t, dtype=float).ravel())
        for r, t in zip(rotations, translations, strict=True)
    )
    try:
        return RawCamera(
            Camera(np.asarray(K, dtype=float), *size), Distortion(model, np.asarray(D, dtype=float).ravel()[:count])
        ), poses
    except ValueError as error:
        raise CalibrationError(f"the views leave K open: the fit ended at {error}") from error


def _residuals(raw: RawCamera, view: View, T_camera_board: Array) -> Array:
    return view.pixels - raw.project(view.points_board @ T_camera_board[:3, :3].T + T_camera_board[:3, 3])


def _rms(residuals: Array) -> float:
    return float(np.sqrt((residuals**2).sum(axis=1).mean()))


def _without_outliers(raw: RawCamera, view: View, T_camera_board: Array) -> View:
    distance = np.linalg.norm(_residuals(raw, view, T_camera_board), axis=1)
    # The median of a Rayleigh distribution is 1.18 of its sigma.
    good = distance <= OUTLIER_SIGMAS * max(np.median(distance) / 1.18, 0.02)
    return replace(view, ids=view.ids[good], points_board=view.points_board[good], pixels=view.pixels[good])


def jackknife(raw: RawCamera, views: Sequence[View], poses: Sequence[Array]) -> Deviations:
    """Standard deviations of K and lens by leaving out one view after the other, each by one Gauss-Newton step.

    Each view's pose is eliminated from its normal equations (Schur complement), so a step is a system of K and lens.
    """
    reduced, gradients = [], []
    for view, T in zip(views, poses, strict=True):
        of_camera, of_pose = _jacobians(raw, view, T)
        residuals = _residuals(raw, view, T).ravel()
        gain = np.linalg.lstsq(of_pose.T @ of_pose, of_pose.T @ np.column_stack([of_camera, residuals]), rcond=None)[0]
        free = np.column_stack([of_camera, residuals]) - of_pose @ gain
        reduced.append(free[:, :-1].T @ free[:, :-1])
        gradients.append(free[:, :-1].T @ free[:, -1])
    total, count = np.sum(reduced, axis=0), len(views)
    steps = np.array([
        np.linalg.lstsq(total - one, gradient, rcond=None)[0]
        for one, gradient in zip(reduced, gradients, strict=True)
    ])  # fmt: skip
    deviations = np.sqrt((count - 1) / count * (steps**2).sum(axis=0))
    return Deviations(intrinsics_px=deviations[:4], distortion=deviations[4:])


def _jacobians(raw: RawCamera, view: View, T_camera_board: Array) -> tuple[Array, Array]:
    """d pixels / d (fx, fy, cx, cy, lens) (2n, 4+m) and d pixels / d pose (2n, 6), central differences."""

    def pixels(parameters: Array, twist: Array) -> Array:
        fx, fy, cx, cy = parameters[:4]
        camera = Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), raw.camera.width, raw.camera.height)
        T = transform_from(rotation_of(twist[:3]), twist[3:]) @ T_camera_board
        moved = RawCamera(camera, Distortion(raw.distortion.model, parameters[4:]))
        return moved.project(view.points_board @ T[:3, :3].T + T[:3, 3]).ravel()

    K = raw.camera.K
    at = np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], raw.distortion.coefficients])
    still = np.zeros(6)

    def difference(i: int, size: int, *, of_pose: bool) -> Array:
        step = np.zeros(size)
        step[i] = _STEP * (1.0 if of_pose or i >= 4 else K[0, 0])
        ends = [pixels(at, s) if of_pose else pixels(at + s, still) for s in (step, -step)]
        return (ends[0] - ends[1]) / (2.0 * step[i])

    of_camera = np.stack([difference(i, len(at), of_pose=False) for i in range(len(at))], axis=1)
    return of_camera, np.stack([difference(i, 6, of_pose=True) for i in range(6)], axis=1)


def _holdout(views: Sequence[View], size: tuple[int, int], lens: LensKind) -> float:
    """Rms of views by cameras fitted without them; their poses are fitted, K and lens are not."""
    folds = min(FOLDS, len(views))
    found = []
    for fold in range(folds):
        raw, _ = _fitted([view for i, view in enumerate(views) if i % folds != fold], size, lens)
        found += [_residuals(raw, view, board_pose(raw, view).T_camera_board) for view in views[fold::folds]]
    return _rms(np.concatenate(found))
