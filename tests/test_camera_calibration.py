"""K, lens and places from rendered boards: as right as they are said to be, and refused when they cannot be."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from board_views import BOARD, LENS, SIZE, TRUE, calibrated, drawn_views, intrinsics_error, pictures, views
from figures_shown import report
from page_calibration.board import Board, View, find_board
from page_calibration.calibration import CalibrationError
from page_calibration.extrinsics import locate_camera
from page_calibration.intrinsics import calibrate_intrinsics
from page_calibration.pose import board_pose
from page_calibration.stereo import calibrate_stereo
from page_runtime.camera import Camera
from page_runtime.geometry import apply, invert, rotation_about, rotation_angle, transform_from
from page_runtime.lens import Distortion, RawCamera
from rendered_boards import board_places, render_board


def test_corners_are_found_to_a_tenth_of_a_pixel_in_blurred_uneven_partial_views() -> None:
    partial = [view for view in views() if len(view.ids) < len(BOARD.points_board)]
    assert len(views()) >= 14
    assert len(partial) >= 5
    errors = np.concatenate([
        view.pixels - TRUE.project(apply(pictures()[int(view.name)][0], view.points_board)) for view in views()
    ])  # fmt: skip
    assert np.sqrt((errors**2).mean()) < 0.1
    assert np.abs(errors.mean(axis=0)).max() < 0.02


def test_rendered_views_give_K_as_right_as_asked_and_as_said() -> None:
    error, known = intrinsics_error(calibrated()), calibrated().deviations.intrinsics_px
    assert known is not None
    report(f"\nK off by {error.round(3)} px, said to be known to {known.round(3)}; rms {calibrated().rms_px:.3f} px")
    assert np.abs(error[:2] / [620.0, 618.0]).max() < 0.003
    assert np.abs(error[2:]).max() < 1.5
    assert (np.abs(error) < 4.0 * known + 0.05).all()
    assert calibrated().holdout_px < 1.3 * calibrated().rms_px
    u, v = np.meshgrid(np.linspace(30, 610, 8), np.linspace(30, 450, 6))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    assert np.abs(calibrated().raw.pixels(TRUE.rays(pixels)[:, :2]) - pixels).max() < 0.6


def test_standard_deviations_cover_errors_that_corners_of_a_view_share() -> None:
    """The jackknife's do; those that take corners for independent, as OpenCV's, are too small."""
    normalised, opencv = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        result = calibrate_intrinsics(drawn_views(rng, board_places(BOARD, TRUE, rng, 16)), SIZE)
        assert result.deviations.intrinsics_px is not None
        error = intrinsics_error(result)
        normalised.append(error / result.deviations.intrinsics_px)
        boards = [view.points_board.astype(np.float32) for view in result.views]
        pixels = [view.pixels.astype(np.float32) for view in result.views]
        theirs = cv2.calibrateCameraExtended(boards, pixels, SIZE, np.eye(3), np.zeros(5))[5].ravel()[:4]
        opencv.append(error / theirs)
    ours = np.sqrt((np.array(normalised) ** 2).mean())
    theirs = np.sqrt((np.array(opencv) ** 2).mean())
    report(f"errors over standard deviations, rms: {ours:.2f}; OpenCV's {theirs:.2f}")
    assert 0.6 < ours < 1.4
    assert (np.abs(normalised) < 3.0).mean() > 0.93
    assert theirs > 1.3 * ours


@pytest.mark.parametrize(("lens", "true"), [
    ("rational", LENS), ("fisheye", Distortion("kannala-brandt", np.array([0.05, -0.02, 0.01, -0.002]))),
])  # fmt: skip
def test_other_lenses_are_calibrated_too(lens, true: Distortion) -> None:
    raw, rng = replace(TRUE, distortion=true), np.random.default_rng(2)
    result = calibrate_intrinsics(drawn_views(rng, board_places(BOARD, raw, rng, 18), raw, shared=0.0), SIZE, lens=lens)
    assert np.abs(intrinsics_error(result)[:2]).max() < 0.003 * 618
    assert result.rms_px < 0.15
    assert result.deviations.distortion is not None
    assert len(result.deviations.distortion) == len(result.raw.distortion.coefficients)


def test_corners_found_at_the_wrong_place_are_left_out_and_counted() -> None:
    rng = np.random.default_rng(1)
    found = drawn_views(rng, board_places(BOARD, TRUE, rng, 14), shared=0.0)
    found[3].pixels[4] += [9.0, -6.0]
    found[7].pixels[2] += [-5.0, 5.0]
    result = calibrate_intrinsics(found, SIZE)
    assert result.outliers == 2
    assert np.abs(intrinsics_error(result)).max() < 2.0


def test_views_too_alike_are_refused_with_what_to_add() -> None:
    rng = np.random.default_rng(4)
    with pytest.raises(CalibrationError, match=r"add 5 more views .*3 different ones"):
        calibrate_intrinsics(drawn_views(rng, board_places(BOARD, TRUE, rng, 3)), SIZE)
    one = board_places(BOARD, TRUE, rng, 1)
    with pytest.raises(CalibrationError, match="11 of the 12 repeat another"):
        calibrate_intrinsics(drawn_views(rng, one * 12), SIZE)
    flat = board_places(BOARD, TRUE, rng, 14, tilt_deg=1.0)
    with pytest.raises(CalibrationError, match=r"too alike; add boards tilted by 20 to 40 degrees"):
        calibrate_intrinsics(drawn_views(rng, flat), SIZE)
    corner = [transform_from(T[:3, :3], np.array([-0.17, -0.14, 0.75]) + 0.01 * rng.normal(size=3)) for T in
              board_places(BOARD, TRUE, rng, 14)]  # fmt: skip
    with pytest.raises(CalibrationError, match=r"views with the board in the .*lower right of the picture"):
        calibrate_intrinsics(drawn_views(rng, corner), SIZE)
    hinged = [transform_from(rotation_about(np.array([1.0, 0.0, 0.0]), a), T[:3, 3] * [1, 1, 1.2]) for a, T in
              zip(np.linspace(-0.6, 0.6, 14), board_places(BOARD, TRUE, rng, 14, tilt_deg=0), strict=True)]  # fmt: skip
    with pytest.raises(CalibrationError, match="tilt"):
        calibrate_intrinsics(drawn_views(rng, hinged), SIZE)


def test_a_chessboard_is_found_whole_or_not_at_all() -> None:
    board, rng = Board("chessboard", 9, 6, 0.03), np.random.default_rng(0)
    T = transform_from(rotation_about(np.array([1.0, 0.4, 0.1]), 0.4), np.array([-0.13, -0.08, 0.6]))
    found = find_board(board, render_board(board, TRUE, T, rng), name="whole")
    assert isinstance(found, View)
    expected = TRUE.project(apply(T, found.points_board))
    errors = np.linalg.norm(np.stack([found.pixels - expected, found.pixels[::-1] - expected]), axis=2)
    assert errors.max(axis=1).min() < 0.35  # a chessboard of even rows looks the same turned round
    aside = T.copy()
    aside[0, 3] += 0.3
    assert find_board(board, render_board(board, TRUE, aside, rng), name="half") == "no board found"


# --- places --------------------------------------------------------------------------------------------------------


T_B_A = transform_from(rotation_about(np.array([0.1, 1.0, 0.2]), 0.15), np.array([-0.11, 0.006, 0.012]))
SECOND = RawCamera(
    Camera(np.array([[540.0, 0, 316.0], [0, 541.0, 243.0], [0, 0, 1]]), *SIZE),
    Distortion("kannala-brandt", np.array([0.03, -0.01, 0.004, -0.001])),
)


def stereo_views(seed: int, *, shift: float = 0.0) -> tuple[list[View], list[View]]:
    rng = np.random.default_rng(seed)
    places = board_places(BOARD, TRUE, rng, 14, aside=0.4)
    moved = [T_B_A @ transform_from(np.eye(3), shift * rng.normal(size=3)) @ T for T in places]
    return drawn_views(rng, places, shared=0.0), drawn_views(rng, moved, SECOND, shared=0.0)


def test_two_cameras_of_different_lenses_are_placed_as_right_as_said() -> None:
    a, b = stereo_views(0)
    result = calibrate_stereo(TRUE, SECOND, a, b)
    turn, shift = result.deviations.rotation_rad, result.deviations.translation_m
    assert turn is not None
    assert shift is not None
    assert np.linalg.norm(result.T_b_a[:3, 3] - T_B_A[:3, 3]) < 4 * np.linalg.norm(shift) < 0.002
    assert float(rotation_angle(result.T_b_a[:3, :3], T_B_A[:3, :3])) < 4 * np.linalg.norm(turn) < 0.004
    assert result.epipolar_px < 0.2


def test_pairs_that_are_no_pairs_are_refused() -> None:
    a, b = stereo_views(1, shift=0.2)
    with pytest.raises(CalibrationError, match="taken at the same moment"):
        calibrate_stereo(TRUE, SECOND, a, b)
    with pytest.raises(CalibrationError, match="must have one name in both folders"):
        calibrate_stereo(TRUE, SECOND, a, [replace(view, name="x" + view.name) for view in b])


def test_a_camera_is_located_in_the_world_its_board_was_measured_in() -> None:
    rng = np.random.default_rng(0)
    T_world_board = transform_from(rotation_about(np.array([0.0, 0.0, 1.0]), 0.7), np.array([0.4, -0.2, 0.05]))
    T_camera_board = transform_from(rotation_about(np.array([1.0, 0.3, 0.0]), 0.7), np.array([-0.1, -0.05, 0.55]))
    seen = [drawn_views(rng, [T_camera_board], shared=0.0)[0] for _ in range(3)]
    T, pose = locate_camera(TRUE, seen, T_world_board=T_world_board)
    expected = T_camera_board @ invert(T_world_board)
    assert np.linalg.norm(T[:3, 3] - expected[:3, 3]) < 1e-3
    assert float(rotation_angle(T[:3, :3], expected[:3, :3])) < 2e-3
    assert (pose.deviations[3:] < 1e-3).all()
    moved = drawn_views(rng, [transform_from(np.eye(3), np.array([0.01, 0, 0])) @ T_camera_board])
    with pytest.raises(CalibrationError, match="must stand still"):
        locate_camera(TRUE, [*seen, *moved])


def test_a_small_board_from_the_front_is_refused_as_its_mirrored_tilt_fits_alike() -> None:
    rng = np.random.default_rng(0)
    far = transform_from(rotation_about(np.array([1.0, 0.3, 0.0]), 0.06), np.array([-0.1, -0.05, 3.5]))
    with pytest.raises(CalibrationError, match="mirror image fit alike"):
        locate_camera(TRUE, drawn_views(rng, [far], noise=0.15, shared=0.0))


def test_a_board_from_near_has_one_tilt() -> None:
    """From there the mirrored start ends in the true pose, which must not pass for a second one that fits."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        T = board_places(BOARD, TRUE, rng, 1, tilt_deg=35.0, aside=0.3)[0]
        found, pose = locate_camera(TRUE, drawn_views(rng, [T]))
        assert rotation_angle(found[:3, :3], T[:3, :3]) < np.radians(0.2)
        assert pose.rival_rms_px > 3.0 * pose.rms_px


def test_the_boards_pose_is_found_through_any_lens() -> None:
    rng, T = np.random.default_rng(3), board_places(BOARD, TRUE, np.random.default_rng(3), 1, aside=0.2)[0]
    for raw in (TRUE, SECOND):
        found = board_pose(raw, drawn_views(rng, [T], raw, noise=0.0, shared=0.0)[0])
        np.testing.assert_allclose(found.T_camera_board, T, atol=1e-6)
