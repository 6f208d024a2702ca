"""Where two calibrated cameras are to each other, from pictures both took of one board at the same moments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from page_calibration.board import View
from page_calibration.calibration import CalibrationError, Deviations
from page_calibration.pose import board_pose
from page_calibration.rotation_vectors import vector_of
from page_runtime.geometry import Array, invert, transform_from
from page_runtime.lens import RawCamera

MIN_PAIRS = 6
MIN_COMMON = 8
# Of the distances between where each pair alone puts the second camera; above it a pair was moved between its pictures.
MAX_SCATTER_SHARE = 0.25
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)


@dataclass(frozen=True, eq=False, slots=True)
class StereoCalibration:
    """T_b_a (4,4), metres. deviations: rotation_rad and translation_m by leaving out one pair after the other.
    epipolar_px: rms distance of found points to their epipolar lines, in b's undistorted picture. pairs: names used.
    pair_rms_px: (n,) of each pair's corners, by T_b_a."""

    T_b_a: Array
    deviations: Deviations
    epipolar_px: float
    pairs: tuple[str, ...]
    pair_rms_px: Array


@dataclass(frozen=True, eq=False, slots=True)
class _Pair:
    name: str
    points_board: Array
    plane_a: Array
    plane_b: Array


def calibrate_stereo(a: RawCamera, b: RawCamera, views_a: Sequence[View], views_b: Sequence[View]) -> StereoCalibration:
    """T_b_a from views of the same names; K and lenses are kept as they are."""
    by_name = {view.name: view for view in views_b}
    pairs = [
        pair for view in views_a if view.name in by_name and (pair := _pair(a, b, view, by_name[view.name])) is not None
    ]
    if len(pairs) < MIN_PAIRS:
        raise CalibrationError(
            f"stereo: {len(pairs)} pairs show {MIN_COMMON} corners of the board in both pictures, {MIN_PAIRS} are the "
            "least; pictures of one moment must have one name in both folders"
        )
    start = _start(a, b, views_a, by_name, {pair.name for pair in pairs})
    T_b_a, rms = _fitted(pairs, b, start)
    left_out = [_fitted(pairs[:i] + pairs[i + 1 :], b, T_b_a)[0] for i in range(len(pairs))]
    turns = np.array([vector_of(T[:3, :3] @ T_b_a[:3, :3].T) for T in left_out])
    shifts = np.array([T[:3, 3] - T_b_a[:3, 3] for T in left_out])
    share = np.sqrt((len(pairs) - 1) / len(pairs))
    deviations = Deviations(
        rotation_rad=share * np.sqrt((turns**2).sum(axis=0)), translation_m=share * np.sqrt((shifts**2).sum(axis=0))
    )
    return StereoCalibration(T_b_a, deviations, epipolar_px(T_b_a, b, pairs), tuple(pair.name for pair in pairs), rms)


def _pair(a: RawCamera, b: RawCamera, view_a: View, view_b: View) -> _Pair | None:
    _, i, j = np.intersect1d(view_a.ids, view_b.ids, return_indices=True)
    plane_a, plane_b = a.rays(view_a.pixels[i])[:, :2], b.rays(view_b.pixels[j])[:, :2]
    good = ~(np.isnan(plane_a).any(axis=1) | np.isnan(plane_b).any(axis=1))
    if good.sum() < MIN_COMMON:
        return None
    return _Pair(view_a.name, view_a.points_board[i][good], plane_a[good], plane_b[good])


def _start(a: RawCamera, b: RawCamera, views_a: Sequence[View], views_b: dict[str, View], names: set[str]) -> Array:
    """The middle one of what each pair alone says; refused when they say different things."""
    alone = np.array([
        board_pose(b, views_b[view.name]).T_camera_board @ invert(board_pose(a, view).T_camera_board)
        for view in views_a
        if view.name in names
    ])  # fmt: skip
    middle = np.median(alone[:, :3, 3], axis=0)
    distances = np.linalg.norm(alone[:, :3, 3] - middle, axis=1)
    allowed = max(MAX_SCATTER_SHARE * np.linalg.norm(middle), 0.02)
    if np.median(distances) > allowed:
        raise CalibrationError(
            f"stereo: the pairs put the second camera {np.median(distances) * 1e3:.0f} mm apart from each other; were "
            "the pictures of a pair taken at the same moment, and do the names match?"
        )
    return alone[int(np.argmin(distances))]


def _fitted(pairs: Sequence[_Pair], b: RawCamera, start: Array) -> tuple[Array, Array]:
    """(T_b_a, rms px of each pair): OpenCV's, on undistorted pictures of b's focal length, so any lens will do."""
    f = b.camera.K[0, 0]
    K = np.diag([f, f, 1.0])
    boards = [pair.points_board.astype(np.float32) for pair in pairs]
    pixels_a = [(pair.plane_a * f).astype(np.float32) for pair in pairs]
    pixels_b = [(pair.plane_b * f).astype(np.float32) for pair in pairs]
    flags = cv2.CALIB_FIX_INTRINSIC | cv2.CALIB_USE_EXTRINSIC_GUESS
    result = cv2.stereoCalibrateExtended(
        boards, pixels_a, pixels_b, K, np.zeros(5), K, np.zeros(5), (b.camera.width, b.camera.height),
        start[:3, :3].copy(), start[:3, 3:].copy(), flags=flags, criteria=_CRITERIA,
    )  # fmt: skip
    R, t, errors = (np.asarray(result[i], dtype=float) for i in (5, 6, 11))
    return transform_from(R, t.ravel()), np.sqrt((errors**2).mean(axis=1))


def epipolar_px(T_b_a: Array, b: RawCamera, pairs: Sequence[_Pair]) -> float:
    """Rms distance, px of b's undistorted picture, of each point of b to the line its partner in a allows."""
    plane_a = np.concatenate([pair.plane_a for pair in pairs])
    plane_b = np.concatenate([pair.plane_b for pair in pairs])
    return float(np.sqrt((epipolar_distances(T_b_a, plane_a, plane_b) ** 2).mean()) * b.camera.K[0, 0])


def epipolar_distances(T_b_a: Array, plane_a: Array, plane_b: Array) -> Array:
    """Signed distances (n,) of points (n,2) of b's plane z = 1 to the epipolar lines of points (n,2) of a's."""
    x, y, z = T_b_a[:3, 3]
    E = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ T_b_a[:3, :3]
    lines = np.column_stack([plane_a, np.ones(len(plane_a))]) @ E.T
    points = np.column_stack([plane_b, np.ones(len(plane_b))])
    return (lines * points).sum(axis=1) / np.linalg.norm(lines[:, :2], axis=1)
