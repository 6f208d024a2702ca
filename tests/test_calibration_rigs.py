"""The commands that place cameras, from pictures of a board as a user takes them to the camera.json they write."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from page_calibration.board import Board
from page_calibration.calibration import CalibratedCamera, Calibration, Provenance
from page_calibration.camera_json import to_json
from page_calibration.cli import main
from page_calibration.formats.registry import read_calibration
from page_runtime.camera import Camera
from page_runtime.geometry import Array, invert, rotation_about, rotation_angle, transform_from
from page_runtime.lens import Distortion, RawCamera
from rendered_boards import board_places, render_board

BOARD = Board("charuco", 9, 6, 0.030, 0.022)
BOARD_ARGUMENTS = ["--squares", "9x6", "--square-mm", "30", "--marker-mm", "22"]
FIRST = RawCamera(
    Camera(np.array([[620.0, 0, 326.0], [0, 618.0, 238.0], [0, 0, 1]]), 640, 480),
    Distortion("brown-conrady", np.array([0.1, -0.22, 0.001, -0.0007, 0.05])),
)
SECOND = RawCamera(
    Camera(np.array([[540.0, 0, 318.0], [0, 541.0, 243.0], [0, 0, 1]]), 640, 480),
    Distortion("brown-conrady", np.array([-0.05, 0.03, 0.0, 0.001, 0.0])),
)
T_SECOND_FIRST = transform_from(rotation_about(np.array([0.1, 1.0, 0.05]), 0.12), np.array([-0.09, 0.004, 0.01]))


def camera_file(path: Path, name: str, raw: RawCamera) -> Path:
    path.write_text(to_json(Calibration((CalibratedCamera(name, name, raw),), Provenance("test", "test"))))
    return path


def take(folder: Path, raw: RawCamera, places: Sequence[Array], seed: int = 0) -> Path:
    """Pictures 00.png, 01.png, ... of the board at T_camera_board."""
    folder.mkdir()
    rng = np.random.default_rng(seed)
    for i, T_camera_board in enumerate(places):
        cv2.imwrite(str(folder / f"{i:02d}.png"), render_board(BOARD, raw, T_camera_board, rng))
    return folder


def board_before(count: int, seed: int) -> list[Array]:
    return board_places(BOARD, FIRST, np.random.default_rng(seed), count, tilt_deg=35.0, aside=0.35)


def off(T: Array, truth: Array) -> tuple[float, float]:
    """(mm, degrees)."""
    return (
        1e3 * float(np.linalg.norm(T[:3, 3] - truth[:3, 3])),
        float(np.degrees(rotation_angle(T[:3, :3], truth[:3, :3]))),
    )


def test_stereo_writes_both_cameras_placed_to_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    places = board_before(8, seed=3)
    first = take(tmp_path / "left", FIRST, places)
    second = take(tmp_path / "right", SECOND, [T_SECOND_FIRST @ T for T in places], seed=1)
    cameras = [camera_file(tmp_path / f"{n}.json", n, raw) for n, raw in (("left", FIRST), ("right", SECOND))]
    out, report = tmp_path / "rig.json", tmp_path / "rig.html"
    given = ["stereo", str(first), str(second), "--cameras", str(cameras[0]), str(cameras[1]), *BOARD_ARGUMENTS]
    assert main([*given, "-o", str(out), "--report", str(report)]) == 0
    mm, degrees = off(read_calibration(out).transform("right", "left"), T_SECOND_FIRST)
    assert mm < 0.5
    assert degrees < 0.1
    assert "Each pair" in report.read_text()
    assert "off epipolar lines" in capsys.readouterr().out
    # The partner's pictures under other names.
    for i in range(8):
        (second / f"{i:02d}.png").rename(second / f"x{i}.png")
    before = out.read_text()
    assert main([*given, "-o", str(out)]) == 2
    assert "pictures of one moment must have one name" in capsys.readouterr().err
    assert out.read_text() == before
    twice = camera_file(tmp_path / "twice.json", "left", SECOND)
    given[4:6] = [str(cameras[0]), str(twice)]
    assert main([*given, "-o", str(out)]) == 2
    assert "both cameras are called 'left'" in capsys.readouterr().err


def test_extrinsics_place_a_camera_where_its_board_was_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    T_camera_board = board_before(1, seed=5)[0]
    T_world_board = transform_from(rotation_about(np.array([1.0, 0.2, 0.0]), 0.7), np.array([0.5, -0.2, 0.03]))
    pictures = take(tmp_path / "still", FIRST, [T_camera_board] * 3)
    camera = camera_file(tmp_path / "camera.json", "color", FIRST)
    (tmp_path / "board.json").write_text(json.dumps({"T_world_board": T_world_board.tolist()}))
    out, report = tmp_path / "placed.json", tmp_path / "placed.html"
    given = ["extrinsics", str(pictures), "--camera", str(camera), *BOARD_ARGUMENTS, "-o", str(out)]
    board_pose = ["--board-pose", str(tmp_path / "board.json"), "--world", "cell"]
    assert main([*given, *board_pose, "--report", str(report)]) == 0
    placed = read_calibration(out)["color"]
    assert placed.world_frame == "cell"
    mm, degrees = off(invert(placed.camera.T_camera_world), T_world_board @ invert(T_camera_board))
    assert mm < 2.0
    assert degrees < 0.2
    assert "Corners" in report.read_text()
    capsys.readouterr()
    (tmp_path / "board.json").write_text(json.dumps({"T_world_board": (2 * T_world_board).tolist()}))
    assert main([*given, *board_pose]) == 2
    assert "T_world_board" in capsys.readouterr().err


@pytest.mark.parametrize("mount", ["eye-in-hand", "eye-to-hand"])
def test_hand_eye_from_pictures_finds_the_camera(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], mount: str
) -> None:
    rng = np.random.default_rng(7)
    X = transform_from(rotation_about(rng.normal(size=3), 0.8), np.array([0.03, -0.06, 0.05]))
    Z = transform_from(rotation_about(rng.normal(size=3), 1.1), np.array([0.5, 0.1, -0.2]))
    places = [
        transform_from(np.eye(3), np.array([0.0, 0.0, 0.02 * i])) @ T for i, T in enumerate(board_before(8, seed=9))
    ]
    pictures = take(tmp_path / "pictures", FIRST, places)
    # A X B = Z for every pose; of eye to hand A is T_hand_base.
    moving = [Z @ invert(X @ B) for B in places]
    hands = moving if mount == "eye-in-hand" else [invert(A) for A in moving]
    (tmp_path / "robot.json").write_text(
        json.dumps({"poses": [{"name": f"{i:02d}", "T_base_hand": T.tolist()} for i, T in enumerate(hands)]})
    )
    camera = camera_file(tmp_path / "camera.json", "color", replace(FIRST))
    out, report = tmp_path / "hand.json", tmp_path / "hand.html"
    given = ["hand-eye", "--robot", str(tmp_path / "robot.json"), "--pictures", str(pictures), "--mount", mount]
    given += ["--camera", str(camera), *BOARD_ARGUMENTS, "-o", str(out)]
    assert main([*given, "--report", str(report)]) == 0
    found = read_calibration(out)["color"]
    assert found.world_frame == ("hand" if mount == "eye-in-hand" else "base")
    mm, degrees = off(invert(found.camera.T_camera_world), X)
    assert mm < 2.0
    assert degrees < 0.2
    assert "Each pose" in report.read_text()
    capsys.readouterr()
    for picture in pictures.iterdir():
        picture.rename(pictures / f"late{picture.name}")
    assert main([*given, "-o", str(tmp_path / "other.json")]) == 2
    assert "no pose of the robot has the name" in capsys.readouterr().err
    assert not (tmp_path / "other.json").exists()
