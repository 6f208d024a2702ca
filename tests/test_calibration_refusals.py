"""Calibrations that are wrong, refused with the reason."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration_examples import SMALL, K, calibration, camera, placed, write_as
from page_calibration.calibration import CalibrationError
from page_calibration.formats.registry import read_calibration, written
from page_runtime.camera import Camera
from page_runtime.geometry import invert, orthonormalized, transform_from


def page(**changes: Any) -> str:
    document = json.loads(written(calibration(camera("color", "table", placed())), "page").text)
    for key, value in changes.items():
        document["cameras"][0][key] = value
    return json.dumps(document)


def kalibr_pair(T: np.ndarray) -> str:
    return written(calibration(camera("cam0"), camera("cam1", "cam0", placed())), "kalibr").text.replace(
        str(placed().tolist()[0]), str(T.tolist()[0])
    )


def scaled(factor: float) -> np.ndarray:
    T = placed()
    T[:3, 3] *= factor
    return T


def eeprom(**changes: Any) -> str:
    document = json.loads(written(calibration(camera("CAM_A"), camera("CAM_B", "CAM_A", placed())), "oak").text)
    document["cameraData"][1][1].update(changes)
    return json.dumps(document)


def extrinsics(T: np.ndarray, factor_cm: float = 100.0, to: int = 0) -> dict[str, Any]:
    x, y, z = T[:3, 3] * factor_cm
    return {"rotationMatrix": T[:3, :3].tolist(), "translation": {"x": x, "y": y, "z": z}, "toCameraSocket": to}


MIRRORED, STRETCHED = placed() @ np.diag([-1.0, 1, 1, 1]), placed() @ np.diag([1.02, 1, 1, 1])
BLURRED = json.loads(written(calibration(camera(lens=SMALL[0])), "ros-json").text)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.json", page(T_camera_world=STRETCHED.tolist()), "expected a rotation"),
        ("a.json", page(T_camera_world=MIRRORED.tolist()), r"determinant -1"),
        ("a.json", page(T_camera_world=placed().T.tolist()), "stored transposed"),
        ("a.json", page(T_camera_world=scaled(1e4).tolist()), "probably millimetres"),
        ("a.json", page(K=(2 * K - np.diag([0, 0, 1.0])).tolist()), "another resolution|does not match the image size"),
        ("a.json", page(K=K.T.tolist()), "stored transposed"),
        ("a.json", page(K=np.eye(3).tolist()), "K is the identity"),
        ("a.json", page(K=np.diag([3.04, 3.04, 1.0]).tolist()), "expected pixels, not mm"),
        ("a.json", page(K=(K * [[1], [1.6], [1]] - [[0, 0, 0], [0, 0, 145], [0, 0, 0]]).tolist()), "more than half"),
        ("a.json", page(size_px=[0, 480]), "positive size"),
        ("a.json", page(distortion={"model": "brown-conrady", "coefficients": [0.1, 0.2]}), "4 or 5 or 8"),
        ("a.json", page(distortion={"model": "brown-conrady", "coefficients": [-5.0, 0, 0, 0]}), "no ray for"),
        ("a.json", page(distortion={"model": "omni", "coefficients": []}), "expected none, brown-conrady"),
        ("a.json", page(depth_unit_m=5000), "5000 m; expected metres a unit"),
        ("a.json", page(colour=1), "unknown field 'colour'"),
        ("a.json", page().replace('"version": 1', '"version": 2'), "expected version 1, got 2"),
        ("a.json", page()[:200], "cut off or damaged"),
        ("a.json", "", "empty"),
        ("a.yaml", kalibr_pair(scaled(1000)), "70 m apart; expected metres on one rig, these are probably millimetres"),
        ("a.yaml", kalibr_pair(scaled(100)), "probably centimetres"),
        ("a.yaml", kalibr_pair(STRETCHED), "cam1, T_cn_cnm1: expected a rotation"),
        ("a.yaml", kalibr_pair(placed()).replace("pinhole", "omni"), "only pinhole cameras have a K"),
        ("a.yaml", kalibr_pair(placed()).replace("radtan", "fov"), "none of radtan, equidistant"),
        ("a.json", eeprom(extrinsics=extrinsics(placed(), 1.0)), "holds centimetres, these are probably metres"),
        ("a.json", eeprom(extrinsics=extrinsics(placed() @ placed(), 1e4)), "probably millimetres"),
        ("a.json", eeprom(extrinsics=extrinsics(MIRRORED)), "CAM_B, extrinsics: expected a rotation"),
        ("a.json", eeprom(extrinsics=extrinsics(placed(), to=5)), "leads to CAM_F, which has no camera"),
        ("a.json", eeprom(extrinsics=extrinsics(placed(), to=1)), "leads in a circle"),
        ("a.json", eeprom(extrinsics=extrinsics(transform_from(np.eye(3), np.zeros(3)))), "at the very place"),
        ("a.json", eeprom(width=0), "the EEPROM was not filled"),
        ("a.json", eeprom(cameraType=4), "neither perspective"),
        ("a.json", eeprom().replace('"version": 7', '"version": 5'), "old EEPROM version 5"),
        ("a.json", json.dumps(BLURRED | {"K": [0.0] * 9}), "not calibrated"),
        ("a.json", json.dumps(BLURRED | {"width": 0, "height": 0}), "uncalibrated camera"),
        ("a.json", json.dumps(BLURRED | {"distortion_model": "mei"}), "none of plumb_bob"),
        ("a.json", json.dumps(BLURRED | {"D": [0.1, 0.2]}), "4 or 5 or 8"),
        ("a.json", json.dumps({"intrinsic_matrix": K.T.ravel().tolist()}), "give --size WIDTHxHEIGHT"),
        ("a.json", json.dumps({"width": 640, "height": 480, "intrinsic_matrix": K.ravel().tolist()}), "transposed"),
        ("a.json", json.dumps({"width": 640, "height": 480, "intrinsic_matrix": [1, 2]}), "expected 9 numbers"),
        ("a.json", json.dumps({"0": {"cam_K": K.ravel().tolist()}}), "keep rgb/ beside it"),
        ("a.yaml", "%YAML:1.0\n---\nCamera.fx: 500.\nCamera.width: 640\nCamera.height: 480\n", "'Camera.cx'"),
        ("a.txt", "hello", "not a calibration known here; understood are camera.json and OAK EEPROM"),
    ],
)  # fmt: skip
def test_a_wrong_calibration_is_refused_with_the_reason(tmp_path: Path, name: str, text: str, reason: str) -> None:
    path = write_as(tmp_path, name, text)
    with pytest.raises(CalibrationError, match=reason) as caught:
        read_calibration(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_an_error_and_never_an_identity(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="No such file"):
        read_calibration(tmp_path / "camera.json")
    with pytest.raises(CalibrationError, match="got a folder"):
        read_calibration(tmp_path)


def test_another_size_than_the_file_says_is_refused(tmp_path: Path) -> None:
    path = write_as(
        tmp_path, "a.json", json.dumps({"width": 640, "height": 480, "intrinsic_matrix": K.T.ravel().tolist()})
    )
    with pytest.raises(CalibrationError, match="it is for 640x480, but --size says 1280x720"):
        read_calibration(path, size=(1280, 720))


def test_region_and_binning_of_a_camera_info_follow_the_delivered_picture(tmp_path: Path) -> None:
    roi = {"x_offset": 100, "y_offset": 40, "width": 440, "height": 400}
    document = BLURRED | {"roi": roi, "binning_x": 2, "binning_y": 2}
    found = read_calibration(write_as(tmp_path, "a.json", json.dumps(document))).cameras[0].camera
    expected = Camera(K, 640, 480).cropped(100, 40, 440, 400).resized(220, 200)
    np.testing.assert_allclose(found.K, expected.K)
    assert (found.width, found.height) == (220, 200)


def test_cameras_of_different_worlds_have_no_transform_between_them() -> None:
    with pytest.raises(CalibrationError, match="nothing says where 'color' and 'depth' are"):
        calibration(camera(), camera("depth")).transform("color", "depth")


def test_a_rotation_rounded_to_float32_is_made_orthonormal_again() -> None:
    T = placed().astype(np.float32).astype(float)
    np.testing.assert_allclose(orthonormalized(T) @ invert(orthonormalized(T)), np.eye(4), atol=1e-15)
    np.testing.assert_allclose(orthonormalized(T), T, atol=1e-7)
