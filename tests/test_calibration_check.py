"""`page-calibrate check` tells a right calibration from the usual wrong ones, and says which it is."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from page_calibration.calibration import CalibratedCamera, Calibration, Provenance
from page_calibration.camera_json import to_json
from page_calibration.check import check_pair
from page_calibration.cli import main
from page_calibration.epipolar_check import check_stereo
from page_calibration.registered_check import check_frames
from page_runtime import RgbdFrame, open_source
from page_runtime.camera import Camera
from page_runtime.geometry import Array, invert, rotation_about, transform_from
from page_runtime.image_files import write_color, write_depth
from page_runtime.lens import RawCamera, sampled
from rendered_rooms import T_COLOR_DEPTH, look, random_room, rig

DEPTH, COLOR = rig()


@cache
def pictures() -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Two frames of the rig: colour as the colour camera sees it, depth as the depth camera does."""
    rng = np.random.default_rng(5)
    rooms = [random_room(rng) for _ in range(2)]
    return tuple((look(room, COLOR, rng)[0], look(room, DEPTH, rng)[1]) for room in rooms)


def moved(T_color_depth: Array) -> RawCamera:
    return replace(COLOR, camera=replace(COLOR.camera, T_camera_world=T_color_depth))


def with_unit(factor: float) -> Array:
    T = T_COLOR_DEPTH.copy()
    T[:3, 3] *= factor
    return T


def with_K(raw: RawCamera, *, size: float = 1.0, focal: float = 1.0) -> RawCamera:
    K = raw.camera.K.copy()
    K[:2, 2] = (K[:2, 2] + 0.5) * size - 0.5
    K[[0, 1], [0, 1]] *= size * focal
    return replace(raw, camera=Camera(K, raw.camera.width, raw.camera.height, raw.camera.T_camera_world))


CASES = {
    "right": (DEPTH, COLOR, "none", "the calibration fits"),
    "inverted": (DEPTH, moved(invert(T_COLOR_DEPTH)), "extrinsics", "inverted"),
    "millimetres": (DEPTH, moved(with_unit(1e3)), "unit", "millimetres taken for metres"),
    "thousandth": (DEPTH, moved(with_unit(1e-3)), "unit", "metres taken for millimetres"),
    "centimetres": (DEPTH, moved(with_unit(100)), "unit", "centimetres taken for metres"),
    "colour K of twice the size": (DEPTH, with_K(COLOR, size=2.0), "resolution", "colour camera's K is of another"),
    "colour K of half the size": (DEPTH, with_K(COLOR, size=0.5), "resolution", "0.5 times the picture's"),
    "depth K of 1.5 times the size": (with_K(DEPTH, size=1.5), COLOR, "resolution", "depth camera's K"),
    "colour focal 2 % long": (DEPTH, with_K(COLOR, focal=1.02), "focal", "2.0 % too long"),
    "colour focal 2 % short": (DEPTH, with_K(COLOR, focal=0.98), "focal", "2.0 % too short"),
    "depth focal 2 % long": (with_K(DEPTH, focal=1.02), COLOR, "focal", "or the depth camera's as much the other way"),
}


@pytest.mark.parametrize("name", CASES)
def test_the_mistake_in_a_rigs_calibration_is_named(name: str) -> None:
    depth, color, fault, words = CASES[name]
    finding = check_pair(depth, color, pictures()[:1])
    assert finding.fault == fault, finding.words
    assert words in finding.words


def test_depth_in_another_unit_is_named_before_anything_else() -> None:
    color, depth_m = pictures()[0]
    finding = check_pair(DEPTH, COLOR, [(color, depth_m * np.float32(1e3))])
    assert finding.fault == "unit"
    assert "0.001 times" in finding.words


def test_pictures_of_different_scenes_and_empty_scenes_are_not_judged() -> None:
    (color, _), (_, depth_m) = pictures()
    assert check_pair(DEPTH, COLOR, [(color, depth_m)]).fault is None
    finding = check_pair(DEPTH, COLOR, [(color, np.full_like(depth_m, 1.5))])
    assert finding.fault is None
    assert "0 points where depth jumps" in finding.words


@cache
def walk() -> tuple[RgbdFrame, ...]:
    """Registered frames of one room from three places."""
    rng = np.random.default_rng(3)
    T_world_room = transform_from(np.eye(3), np.array([-0.3, -0.1, -0.4]))
    room = [(T_world_room @ T, half, sides) for T, half, sides in random_room(rng)]
    frames = []
    for angle in (-0.12, 0.0, 0.13):
        T = transform_from(rotation_about(np.array([0.3, 1.0, 0.1]), angle), rng.uniform(-0.15, 0.15, 3)) @ invert(
            T_world_room
        )
        camera = Camera(COLOR.camera.K, 640, 400, T)
        frames.append(RgbdFrame(*look(room, RawCamera(camera), rng), camera))
    return tuple(frames)


def replaced(frame: RgbdFrame, T_camera_world: Array) -> RgbdFrame:
    return replace(frame, camera=replace(frame.camera, T_camera_world=T_camera_world))


def test_places_of_a_moving_camera_that_are_inverted_or_in_another_unit_are_named() -> None:
    assert check_frames(walk()).fault == "none"
    inverted = check_frames([replaced(f, invert(f.camera.T_camera_world)) for f in walk()])
    assert (inverted.fault, "places are inverted" in inverted.words) == ("extrinsics", True)
    scaled = []
    for frame in walk():
        T = frame.camera.T_camera_world.copy()
        T[:3, 3] *= 1e3
        scaled.append(replaced(frame, T))
    wrong_unit = check_frames(scaled)
    assert (wrong_unit.fault, "millimetres taken for metres" in wrong_unit.words) == ("unit", True)


def test_depth_that_is_not_registered_is_told_with_how_far_it_is_off() -> None:
    finding = check_frames([replace(f, depth_m=np.roll(f.depth_m, 7, axis=1)) for f in walk()])
    assert finding.fault == "extrinsics"
    assert "moved by (-7, 0) px" in finding.words


def test_a_camera_that_stands_still_says_that_its_K_was_not_judged() -> None:
    finding = check_frames([replaced(walk()[0], np.eye(4))])
    assert finding.fault == "none"
    assert "K and places cannot be judged" in finding.words


@cache
def stereo_pictures() -> tuple[RawCamera, RawCamera, np.ndarray, np.ndarray]:
    """Two cameras with lenses and unequal K before a slanted wall of blobs."""
    rng = np.random.default_rng(0)
    wall = cv2.GaussianBlur(rng.uniform(0, 255, (900, 1200)).astype(np.float32), (0, 0), 5.0)
    wall = (wall - wall.min()) * (255.0 / np.ptp(wall))
    T_wall_a = transform_from(rotation_about(np.array([0.2, 1.0, 0.0]), 0.5), np.array([0.6, 0.45, -1.1]))
    seen = []
    left = RawCamera(DEPTH.camera, DEPTH.distortion)
    for raw in (left, COLOR):
        rows, columns = np.mgrid[: raw.camera.height, : raw.camera.width]
        T = T_wall_a @ invert(raw.camera.T_camera_world)
        directions = raw.rays(np.stack([columns, rows], axis=-1).astype(float)) @ T[:3, :3].T
        hit = T[:3, 3] - directions * (T[2, 3] / directions[..., 2])[..., None]
        seen.append(sampled(wall, hit[..., :2] * 1000).astype(np.uint8))
    return left, COLOR, seen[0], seen[1]


def test_a_stereo_pair_is_judged_by_its_epipolar_lines() -> None:
    a, b, gray_a, gray_b = stereo_pictures()
    right = check_stereo(a, b, [(gray_a, gray_b)])
    assert (right.fault, "the calibration fits" in right.words) == ("none", True), right.words
    inverted = check_stereo(a, moved(invert(T_COLOR_DEPTH)), [(gray_a, gray_b)])
    assert (inverted.fault, "inverted" in inverted.words) == ("extrinsics", True), inverted.words
    resized = check_stereo(a, with_K(b, size=2.0), [(gray_a, gray_b)])
    assert resized.fault == "resolution", resized.words
    assert check_stereo(a, b, [(gray_a, np.full_like(gray_b, 90))]).fault is None


def write_raw(folder: Path, frames: tuple[tuple[np.ndarray, np.ndarray], ...]) -> Path:
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    for i, (color, depth_m) in enumerate(frames):
        write_color(folder / "color" / f"{i:03d}.png", color)
        write_depth(folder / "depth" / f"{i:03d}.png", depth_m, metres_per_unit=1e-3)
    return folder


def rig_file(path: Path, color: RawCamera) -> Path:
    cameras = (CalibratedCamera("depth", "depth", DEPTH, 1e-3), CalibratedCamera("color", "depth", color))
    path.write_text(to_json(Calibration(cameras, Provenance("test", "rig"))))
    return path


def test_the_command_judges_reports_and_says_it_by_its_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = write_raw(tmp_path / "raw", pictures())
    right, report = rig_file(tmp_path / "right.json", COLOR), tmp_path / "report.html"
    assert main(["check", str(raw), "--camera", str(right), "--report", str(report)]) == 0
    assert "raw: fits: outlines" in capsys.readouterr().out
    assert report.read_text().count("<img") == 1
    wrong = rig_file(tmp_path / "wrong.json", moved(invert(T_COLOR_DEPTH)))
    assert main(["check", str(raw), "--camera", str(wrong), "--report", str(report)]) == 1
    assert "does not fit: the extrinsics are inverted" in capsys.readouterr().out
    assert report.read_text().count("<img") == 2
    small = json.loads(right.read_text())
    small["cameras"][1]["size_px"] = [320, 200]
    (tmp_path / "small.json").write_text(json.dumps(small))
    assert main(["check", str(raw), "--camera", str(tmp_path / "small.json")]) == 2
    assert "does not match the image size" in capsys.readouterr().err


def test_register_makes_a_folder_that_is_played_and_fits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw = write_raw(tmp_path / "raw", pictures()[:1])
    camera = rig_file(tmp_path / "camera.json", COLOR)
    out = tmp_path / "registered"
    assert main(["register", str(raw), "--camera", str(camera), "-o", str(out)]) == 0
    frame = open_source(out).entries[0].read().frame
    np.testing.assert_allclose(frame.camera.K, COLOR.camera.K)
    assert (frame.depth_m > 0).mean() > 0.7
    assert main(["check", str(out)]) == 0
    assert "depth is registered to colour" in capsys.readouterr().out
    assert main(["register", str(raw), "--camera", str(camera), "-o", str(out)]) == 2
    assert "not empty" in capsys.readouterr().err
