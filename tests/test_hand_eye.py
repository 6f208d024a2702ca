"""Hand-eye: real ViSP poses, simulated noise, and too little motion."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from figures_shown import report
from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError, Provenance
from page_calibration.camera_json import to_json
from page_calibration.cli import main
from page_calibration.formats.registry import read_calibration
from page_calibration.hand_eye import park_martin, solve_hand_eye
from page_calibration.robot_poses import read_visp_pose
from page_runtime.camera import Camera
from page_runtime.geometry import Array, invert, rotation_about, rotation_angle, transform_from
from page_runtime.lens import RawCamera


def random_pose(rng: np.random.Generator, angle: float, reach: float) -> Array:
    return transform_from(rotation_about(rng.normal(size=3), rng.uniform(0, angle)), rng.uniform(-reach, reach, 3))


def session(
    seed: int, poses: int = 12, *, turn: float = 0.0, shift: float = 0.0
) -> tuple[list[Array], list[Array], Array]:
    """(T_base_hand, T_camera_target with noise, T_hand_camera) of a camera on a hand."""
    rng = np.random.default_rng(seed)
    T_hand_camera, T_base_target = random_pose(rng, 3.0, 0.1), random_pose(rng, 3.0, 0.6)
    hands = [random_pose(rng, 0.9, 0.4) for _ in range(poses)]
    targets: list[Array] = [
        transform_from(rotation_about(rng.normal(size=3), turn * rng.normal()), shift * rng.normal(size=3))
        @ invert(T @ T_hand_camera)
        @ T_base_target
        for T in hands
    ]
    return hands, targets, T_hand_camera


def errors(T: Array, truth: Array) -> tuple[float, float]:
    return float(np.linalg.norm(T[:3, 3] - truth[:3, 3])), float(rotation_angle(T[:3, :3], truth[:3, :3]))


@pytest.mark.parametrize("seed", range(3))
def test_exact_poses_give_the_camera_exactly_on_the_hand_and_before_the_robot(seed: int) -> None:
    hands, targets, truth = session(seed)
    found = solve_hand_eye(hands, targets, mount="eye-in-hand")
    np.testing.assert_allclose(found.X, truth, atol=1e-7)
    np.testing.assert_allclose(park_martin(np.array(hands), np.array(targets)), truth, atol=1e-9)
    # The same numbers read the other way: the camera stands, the target is on a hand that is where the inverses say.
    standing = solve_hand_eye([invert(T) for T in hands], targets, mount="eye-to-hand")
    np.testing.assert_allclose(standing.X, truth, atol=1e-7)
    assert found.scatter_m.max() < 1e-7


def test_the_refinement_is_better_than_park_and_martin_alone_and_knows_its_error() -> None:
    started, refined, normalised = [], [], []
    for seed in range(40):
        hands, targets, truth = session(seed, turn=0.006, shift=0.001)
        found = solve_hand_eye(hands, targets, mount="eye-in-hand")
        started.append(errors(found.start, truth))
        refined.append(errors(found.X, truth))
        normalised.append((found.X[:3, :3].T @ (found.X[:3, 3] - truth[:3, 3])) / found.deviations[3:])
    start, end = np.median(started, axis=0), np.median(refined, axis=0)
    report(f"Park-Martin {start[0] * 1e3:.2f} mm {np.degrees(start[1]):.3f} deg, refined {end[0] * 1e3:.2f} mm "
          f"{np.degrees(end[1]):.3f} deg")  # fmt: skip
    assert end[0] < 0.9 * start[0]
    assert end[1] < 0.7 * start[1]
    assert 0.6 < np.sqrt((np.array(normalised) ** 2).mean()) < 1.6


def test_real_poses_of_a_robot_put_the_target_in_one_place(shared_data: Path) -> None:
    folder = shared_data / "calib_formats" / "hand_eye" / "visp"
    hands, targets = (
        [read_visp_pose(folder / f"pose_{kind}_{i}.yaml") for i in range(1, 9)] for kind in ("fPe", "cPo")
    )
    found = solve_hand_eye(hands, targets, mount="eye-in-hand")
    report(f"scatter {found.scatter_rms_m * 1e3:.2f} mm rms an axis, farthest {found.scatter_m.max() * 1e3:.2f} mm, "
          f"{np.degrees(found.scatter_rad).mean():.2f} degrees")  # fmt: skip
    assert found.scatter_rms_m < 0.002
    assert np.degrees(found.scatter_rad).mean() < 0.6


def test_too_little_turning_is_refused_with_the_reason() -> None:
    hands, targets, _ = session(0)
    with pytest.raises(CalibrationError, match="2 different rotations of the hand in 2 poses, 3 are the least"):
        solve_hand_eye(hands[:2], targets[:2], mount="eye-in-hand")
    still = [transform_from(hands[0][:3, :3], T[:3, 3]) for T in hands]
    with pytest.raises(CalibrationError, match=r"1 different rotations.* moving it without turning says nothing"):
        solve_hand_eye(still, targets, mount="eye-in-hand")
    axis = np.array([0.2, 0.3, 1.0])
    hinged = [
        transform_from(rotation_about(axis, a), T[:3, 3]) for a, T in zip(np.linspace(0, 2, 12), hands, strict=True)
    ]
    with pytest.raises(CalibrationError, match="about one axis"):
        solve_hand_eye(hinged, targets, mount="eye-in-hand")
    with pytest.raises(CalibrationError, match="12 poses of the robot, 11 of the target"):
        solve_hand_eye(hands, targets[1:], mount="eye-in-hand")


def write_poses(path: Path, key: str, poses: list[Array]) -> Path:
    path.write_text(json.dumps({"poses": [{"name": f"{i}", key: T.tolist()} for i, T in enumerate(poses)]}))
    return path


def test_the_command_places_the_camera_in_the_hands_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hands, targets, truth = session(3, turn=0.002, shift=0.0005)
    camera = CalibratedCamera("color", "color", RawCamera(Camera(np.diag([600.0, 600, 1]) + np.array(
        [[0, 0, 319.5], [0, 0, 239.5], [0, 0, 0]]), 640, 480)))  # fmt: skip
    (tmp_path / "camera.json").write_text(to_json(Calibration((camera,), Provenance("test", "test"))))
    robot = write_poses(tmp_path / "robot.json", "T_base_hand", hands)
    target = write_poses(tmp_path / "target.json", "T_camera_target", targets)
    out, report = tmp_path / "out.json", tmp_path / "report.html"
    arguments = ["hand-eye", "--camera", str(tmp_path / "camera.json"), "-o", str(out), "--report", str(report)]
    assert main([*arguments, "--robot", str(robot), "--target", str(target)]) == 0
    found = read_calibration(out)["color"]
    assert found.world_frame == "hand"
    assert errors(invert(found.camera.T_camera_world), truth)[0] < 0.003
    assert "Each pose" in report.read_text()
    capsys.readouterr()
    millimetres = [transform_from(T[:3, :3], T[:3, 3] * 1e3 + 30.0) for T in hands]
    wrong = write_poses(tmp_path / "mm.json", "T_base_hand", millimetres)
    assert main([*arguments, "--robot", str(wrong), "--target", str(target)]) == 2
    assert "these are probably millimetres" in capsys.readouterr().err
    assert main([*arguments, "--robot", str(robot)]) == 2
    assert "--target, --pictures: expected one of them" in capsys.readouterr().err


def test_a_pose_that_is_none_is_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hands, targets, _ = session(1)
    camera = CalibratedCamera("color", "color", RawCamera(Camera(np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]),
                              640, 480)))  # fmt: skip
    (tmp_path / "camera.json").write_text(to_json(Calibration((camera,), Provenance("test", "test"))))
    robot = write_poses(tmp_path / "robot.json", "T_base_hand", [2.0 * T for T in hands])
    target = write_poses(tmp_path / "target.json", "T_camera_target", targets)
    arguments = ["hand-eye", "--camera", str(tmp_path / "camera.json"), "-o", str(tmp_path / "out.json")]
    assert main([*arguments, "--robot", str(robot), "--target", str(target)]) == 2
    assert "robot.json, pose 0: expected" in capsys.readouterr().err
