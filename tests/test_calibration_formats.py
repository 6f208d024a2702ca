"""Calibrations of other programs, read and written as their owners do."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from calibration_examples import SMALL, K, calibration, camera, placed, write_as
from figures_shown import report
from page_calibration.calibration import CalibrationError
from page_calibration.formats.registry import read_calibration, written
from page_runtime.camera import Camera
from page_runtime.lens import RawCamera

# --- against the programs that own the formats ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def dai() -> Any:
    """depthai, without the messages it sends home."""
    os.environ.setdefault("DEPTHAI_TELEMETRY", "0")
    os.environ.setdefault("DEPTHAI_LEVEL", "error")
    return pytest.importorskip("depthai")


def oak_files(shared_data: Path) -> list[Path]:
    return sorted((shared_data / "oak_calib").glob("*.json"))


# depthai scales in float32 and then crops the wrong axis when the scaled height is a rounding away from the wanted one.
DEPTHAI_CROPS_WRONG = (1280, 720), (640, 400)


def test_real_eeproms_agree_with_depthai_or_are_refused_as_it_refuses_them(shared_data: Path, dai: Any) -> None:
    rows, wrong_crops, compared = [], 0, 0
    for path in oak_files(shared_data):
        try:
            theirs = dai.CalibrationHandler(str(path))
        except RuntimeError:
            with pytest.raises(CalibrationError, match="old EEPROM version"):
                read_calibration(path)
            rows.append((path.name, "refused by both: old EEPROM version"))
            continue
        ours = read_calibration(path)
        sockets = {f: getattr(dai.CameraBoardSocket, f) for f in ours.frames}
        worst = 0.0
        for a in ours:
            for b in ours:
                if a.frame == b.frame or a.world_frame != b.world_frame:
                    continue
                T_cm = np.array(theirs.getCameraExtrinsics(sockets[a.frame], sockets[b.frame], False))
                T_cm[:3, 3] *= 0.01
                worst = max(worst, np.abs(T_cm - ours.transform(b.frame, a.frame)).max())
            expected = theirs.getDistortionCoefficients(sockets[a.frame])
            np.testing.assert_allclose(a.raw.distortion.coefficients, expected[: len(a.raw.distortion.coefficients)])
            for size in ((640, 400), (640, 480), (1280, 720), (1920, 1080), (300, 300), (416, 416), (512, 288)):
                # depthai assumes bars where a wider picture is wanted at 4:3 or narrower, and else a cut.
                has_bars = 3 * size[0] <= 4 * size[1] and 3 * a.camera.width > 4 * a.camera.height
                K_ours = (a.raw.letterboxed(*size) if has_bars else a.raw.covering(*size)).camera.K
                K_theirs = np.array(theirs.getCameraIntrinsics(sockets[a.frame], *size))
                # It scales pixels' corners: half a pixel of ours stays half a pixel.
                K_theirs[:2, 2] += (K_ours[0, 0] / a.camera.K[0, 0] - 1.0) / 2.0
                compared += 1
                if np.abs(K_ours - K_theirs).max() > 2e-3:
                    assert ((a.camera.width, a.camera.height), size) == DEPTHAI_CROPS_WRONG, (path, a.frame, size)
                    wrong_crops += 1
        assert worst < 1e-5, path
        rows.append((path.name, f"{len(ours)} cameras, extrinsics within {worst:.1e}"))
    report("\n".join(f"{name:115s} {text}" for name, text in rows))
    report(f"{compared} intrinsics compared, {wrong_crops} times depthai crops the wrong axis")
    assert sum("refused" not in text for _, text in rows) == 15
    assert 0 < wrong_crops < compared / 50


def test_a_1280x720_calibration_delivered_at_640x400_is_cropped_left_and_right() -> None:
    raw = RawCamera(Camera(np.array([[800.0, 0, 639.5], [0, 800.0, 359.5], [0, 0, 1.0]]), 1280, 720)).covering(640, 400)
    np.testing.assert_allclose(raw.camera.K, [[800 * 400 / 720, 0, 319.5], [0, 800 * 400 / 720, 199.5], [0, 0, 1]])


def test_an_eeprom_we_write_is_loaded_by_depthai_with_the_same_numbers(tmp_path: Path, dai: Any) -> None:
    before = calibration(
        camera("CAM_A", lens=("brown-conrady", (0.1, -0.2, 0.001, 0.002, 0.05))),
        camera("CAM_B", "CAM_A", placed()),
        camera("CAM_C", "CAM_A", placed(0.05, -0.04), lens=SMALL[2]),
    )
    path = write_as(tmp_path, "eeprom.json", written(before, "oak").text)
    theirs = dai.CalibrationHandler(str(path))
    T_cm = np.array(theirs.getCameraExtrinsics(dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C, False))
    T_cm[:3, 3] *= 0.01
    np.testing.assert_allclose(T_cm, before.transform("CAM_C", "CAM_B"), atol=1e-6)
    np.testing.assert_allclose(theirs.getCameraIntrinsics(dai.CameraBoardSocket.CAM_A), K, atol=1e-4)


def test_open3d_reads_what_we_write_and_we_read_what_it_writes(tmp_path: Path) -> None:
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    before = calibration(camera("camera", "world", placed(), lens=SMALL[0]))
    theirs = o3d.io.read_pinhole_camera_parameters(
        str(write_as(tmp_path, "ours.json", written(before, "open3d-parameters").text))
    )
    np.testing.assert_allclose(theirs.extrinsic, placed(), atol=1e-12)
    np.testing.assert_allclose(theirs.intrinsic.intrinsic_matrix, K)
    o3d.io.write_pinhole_camera_parameters(str(tmp_path / "theirs.json"), theirs)
    o3d.io.write_pinhole_camera_intrinsic(str(tmp_path / "intrinsic.json"), theirs.intrinsic)
    read = read_calibration(tmp_path / "theirs.json")["camera"]
    np.testing.assert_allclose(read.camera.T_camera_world, placed(), atol=1e-12)
    np.testing.assert_allclose(read_calibration(tmp_path / "intrinsic.json")["camera"].camera.K, K)
    assert read.world_frame == "world"


def test_opencv_reads_what_we_write_and_we_read_what_it_writes(tmp_path: Path) -> None:
    path = write_as(tmp_path, "ours.yaml", written(calibration(camera(T=placed(), world="table")), "opencv").text)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("camera_matrix").mat(), K)
    np.testing.assert_array_equal(storage.getNode("distortion_coefficients").mat().ravel(), SMALL[1][1])
    for name in ("theirs.yaml", "theirs.xml", "theirs.json"):
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 640)
        storage.write("image_height", 480)
        storage.write("camera_matrix", K)
        storage.write("distortion_coefficients", np.array([[0.1, -0.2, 0.001, 0.002, 0.05]]))
        storage.release()
        read = read_calibration(tmp_path / name)["camera"]
        np.testing.assert_array_equal(read.camera.K, K)
        np.testing.assert_array_equal(read.raw.distortion.coefficients, [0.1, -0.2, 0.001, 0.002, 0.05])


def test_real_ros_kalibr_and_tum_files_have_the_numbers_in_them(shared_data: Path) -> None:
    folder = shared_data / "calib_formats"
    ros = yaml.safe_load((folder / "ros_camera_info" / "usb_cam_camera_info.yaml").read_text())
    read = read_calibration(folder / "ros_camera_info" / "usb_cam_camera_info.yaml")["test_camera"]
    np.testing.assert_array_equal(read.camera.K.ravel(), ros["camera_matrix"]["data"])
    np.testing.assert_array_equal(read.raw.distortion.coefficients, ros["distortion_coefficients"]["data"])
    R = np.reshape(ros["rectification_matrix"]["data"], (3, 3))
    np.testing.assert_allclose(read.camera.T_camera_world[:3, :3], R.T, atol=1e-5)
    ini = read_calibration(folder / "ros_camera_info" / "calib8.ini")["mono_left"]
    assert len(ini.raw.distortion.coefficients) == 8
    assert ini.camera.K[0, 0] == 369.344588
    text = (folder / "kalibr" / "rs_t265_imucam_chain.yaml").read_text().replace("%YAML:1.0", "")
    chain, kalibr = yaml.safe_load(text), read_calibration(folder / "kalibr" / "rs_t265_imucam_chain.yaml")
    np.testing.assert_allclose(kalibr.transform("cam1", "cam0"), chain["cam1"]["T_cn_cnm1"], atol=1e-5)
    np.testing.assert_allclose(kalibr["cam0"].camera.T_camera_world, chain["cam0"]["T_cam_imu"], atol=1e-8)
    assert kalibr["cam0"].raw.distortion.model == "kannala-brandt"
    assert any("timeshift_cam_imu" in note for note in kalibr.provenance.notes)
    tum = folder / "tum" / "orbslam2_TUM1.yaml"
    storage = cv2.FileStorage(str(tum), cv2.FILE_STORAGE_READ)
    slam = read_calibration(tum)["camera"]
    for value, name in ((slam.camera.K[0, 0], "fx"), (slam.raw.distortion.coefficients[4], "k3")):
        assert value == storage.getNode(f"Camera.{name}").real()
    assert slam.depth_unit_m == pytest.approx(0.0002)


def test_every_shared_calibration_file_is_read_or_refused_for_what_it_is(shared_data: Path) -> None:
    refused = {
        "MANIFEST.tsv": "not a calibration known here",
        "param.txt": "bare numbers",
        "fr1_xyz_associations.txt": "timestamps and pictures",
        **{f"pos{i}.txt": "bare numbers" for i in range(8)},
        **{f"pose_{kind}_{i}.yaml": "a pose rather than a camera" for kind in ("cPo", "fPe") for i in range(1, 9)},
    }
    rows = []
    for path in sorted((shared_data / "calib_formats").rglob("*.*")):
        if path.name in refused:
            with pytest.raises(CalibrationError, match=refused[path.name]):
                read_calibration(path)
            rows.append((path.name, f"refused: {refused[path.name]}"))
        else:
            found = read_calibration(path)
            rows.append((path.name, f"{found.provenance.format}: {', '.join(found.frames)}"))
    report("\n".join(f"{name:40s} {text}" for name, text in rows))
    assert len(rows) == 14 + len(refused)


def test_a_calibration_that_differs_from_the_boards_drawing_is_warned_of(shared_data: Path) -> None:
    name = "oak-examples__depth-test_z-acc_spatial-noise__calib_18443010F116631200"
    found = read_calibration(shared_data / "oak_calib" / f"{name}.json")
    assert any("CAM_B is 8.45 cm from CAM_C" in w and "12.6 %" in w for w in found.provenance.warnings)
    assert not any(
        "drawing" in w for w in read_calibration(shared_data / "oak_calib" / f"{name}.old.json").provenance.warnings
    )


# --- there and back ------------------------------------------------------------------------------------------------
