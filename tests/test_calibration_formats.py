"""Calibrations of other programs: read as their owners read them, written without loss, or refused with the reason."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from figures_shown import report
from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError, Deviations, Provenance
from page_calibration.formats.registry import NAMES, read_calibration, same_lens, written
from page_runtime.camera import Camera
from page_runtime.geometry import invert, orthonormalized, rotation_about, transform_from
from page_runtime.lens import Distortion, DistortionModel, RawCamera

K = np.array([[612.25, 0.0, 318.4], [0.0, 611.875, 241.7], [0.0, 0.0, 1.0]])
SMALL = ("none", ()), ("brown-conrady", (0.11, -0.23, 0.0007, -0.0004)), ("kannala-brandt", (0.01, 0.02, -0.01, 0.002))


def camera(
    frame: str = "color", world: str | None = None, T: np.ndarray | None = None, **changes: Any
) -> CalibratedCamera:
    lens = Distortion(*changes.pop("lens", SMALL[1]))
    raw = RawCamera(Camera(changes.pop("K", K), 640, 480, np.eye(4) if T is None else T), lens)
    return CalibratedCamera(frame, world or frame, raw, **changes)


def calibration(*cameras: CalibratedCamera) -> Calibration:
    return Calibration(cameras or (camera(),), Provenance("test", "nowhere"))


def placed(angle: float = 0.1, shift: float = 0.07) -> np.ndarray:
    return transform_from(rotation_about(np.array([0.3, 1.0, -0.2]), angle), np.array([shift, 0.004, -0.01]))


def write_as(tmp_path: Path, name: str, text: str) -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def again(tmp_path: Path, before: Calibration, name: str) -> Calibration:
    path = write_as(tmp_path, f"again-{name}", written(before, name).text)
    first = before.cameras[0].camera
    return read_calibration(path, size=(first.width, first.height))


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


def assert_same(before: Calibration, after: Calibration, *, names: bool = True) -> None:
    assert len(before) == len(after)
    for a, b in zip(before, after, strict=True):
        np.testing.assert_allclose(b.camera.K, a.camera.K, atol=1e-9, rtol=0)
        np.testing.assert_allclose(b.camera.T_camera_world, a.camera.T_camera_world, atol=1e-9, rtol=0)
        assert (a.camera.width, a.camera.height) == (b.camera.width, b.camera.height)
        assert same_lens(a.raw.distortion, b.raw.distortion)
        assert (a.depth_unit_m is None) == (b.depth_unit_m is None)
        assert a.depth_unit_m is None or b.depth_unit_m == pytest.approx(a.depth_unit_m, rel=1e-12)
        if names:
            assert (a.frame, a.world_frame) == (b.frame, b.world_frame)


def drawn(
    rng: np.random.Generator, frame: str, world: str, T: np.ndarray, lens: str, **changes: Any
) -> CalibratedCamera:
    counts = {"none": 0, "radtan": 4, "plumb-bob": 5, "rational": 8, "tilted": 14, "fisheye": 4}
    models: dict[str, DistortionModel] = {"none": "none", "fisheye": "kannala-brandt"}
    model = models.get(lens, "brown-conrady")
    coefficients = rng.uniform(-0.004, 0.004, counts[lens])
    width, height = (int(v) for v in rng.integers(200, 2000, 2))
    f = rng.uniform(0.7, 1.5) * max(width, height)
    K = np.array([[f, 0, width * rng.uniform(0.45, 0.55)], [0, f * 1.01, height * rng.uniform(0.45, 0.55)], [0, 0, 1]])
    return CalibratedCamera(
        frame, world, RawCamera(Camera(K, width, height, T), Distortion(model, coefficients)), **changes
    )


def random_place(rng: np.random.Generator) -> np.ndarray:
    return transform_from(rotation_about(rng.normal(size=3), rng.uniform(0, 3)), rng.uniform(-0.3, 0.3, 3) + 0.01)


# What each format can hold: lenses, whether the camera has a place, whether depth has a unit.
HOLDS = {
    "page": (("none", "radtan", "plumb-bob", "rational", "tilted", "fisheye"), True, True),
    "ros": (("none", "radtan", "plumb-bob", "rational", "fisheye"), False, False),
    "ros-json": (("none", "radtan", "plumb-bob", "rational", "fisheye"), False, False),
    "ros-ini": (("none", "radtan", "plumb-bob", "rational"), False, False),
    "kalibr": (("none", "radtan", "fisheye"), False, False),
    "open3d": (("none",), False, True),
    "open3d-parameters": (("none",), True, True),
    "bop": (("none",), False, True),
    "bop-scene": (("none",), True, True),
    "tum": (("none", "radtan", "plumb-bob", "fisheye"), False, True),
    "opencv": (("none", "radtan", "plumb-bob", "rational", "tilted", "fisheye"), True, True),
    "oak": (("none", "radtan", "plumb-bob", "rational", "tilted", "fisheye"), False, False),
}


@pytest.mark.parametrize("name", NAMES)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_what_a_format_can_hold_comes_back_as_it_was(
    tmp_path_factory: pytest.TempPathFactory, name: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    lenses, has_place, has_unit = HOLDS[name]
    frame = {"oak": "CAM_A", "kalibr": "cam0", "bop-scene": "0"}.get(name, "camera")
    one = drawn(
        rng, frame, "world" if has_place else frame, random_place(rng) if has_place else np.eye(4),
        str(rng.choice(lenses)),
        depth_unit_m=float(rng.choice([1e-3, 1e-4, 2e-4])) if has_unit else None,
    )  # fmt: skip
    before = calibration(one)
    result = written(before, name)
    assert [text for text in result.lost if text != "the picture size"] == []
    assert ("the picture size" in result.lost) == (name == "bop-scene")
    assert_same(before, again(tmp_path_factory.mktemp("formats"), before, name))


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_rigs_come_back_from_the_formats_that_hold_several_cameras(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    T_ba, T_ca = random_place(rng), random_place(rng)
    folder = tmp_path_factory.mktemp("rigs")
    for name, frames, world in (("page", "abc", "a"), ("oak", ("CAM_A", "CAM_B", "CAM_C"), "CAM_A")):
        cameras = [drawn(rng, f, world, T, "tilted") for f, T in zip(frames, (np.eye(4), T_ba, T_ca), strict=True)]
        before = calibration(*cameras)
        assert written(before, name).lost == ()
        assert_same(before, again(folder, before, name))
    for world, T_first in (("cam0", np.eye(4)), ("imu", T_ca)):
        places = (T_first, T_ba @ T_first)
        before = calibration(*(drawn(rng, f"cam{i}", world, T, "radtan") for i, T in enumerate(places)))
        assert written(before, "kalibr").lost == ()
        assert_same(before, again(folder, before, "kalibr"))


def test_a_rectified_ros_pair_keeps_where_its_right_camera_is(tmp_path: Path) -> None:
    R = rotation_about(np.array([0.1, 1.0, 0.3]), 0.02)
    T_pair_right = transform_from(R, np.array([0.12, 0.0, 0.0]))
    before = calibration(camera("right", "rectified pair", invert(T_pair_right)))
    text = written(before, "ros").text
    P = np.reshape(yaml.safe_load(text)["projection_matrix"]["data"], (3, 4))
    assert P[0, 3] == pytest.approx(-P[0, 0] * 0.12)
    assert_same(before, again(tmp_path, before, "ros"))
    assert_same(before, again(tmp_path, before, "ros-json"))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("open3d", ("brown-conrady distortion", "where 'color' is", "the camera 'depth'")),
        ("bop", ("brown-conrady distortion", "where 'color' is", "the camera 'depth'")),
        ("ros", ("where 'color' is", "depth unit", "the camera 'depth'")),
        ("kalibr", ("where 'color' is", "depth unit")),
        ("tum", ("where 'color' is", "the camera 'depth'")),
        ("bop-scene", ("picture size", "brown-conrady distortion")),
        ("opencv", ("the camera 'depth'",)),
    ],
)
def test_what_a_format_cannot_hold_is_said(name: str, expected: tuple[str, ...]) -> None:
    color = camera("color", "table", placed(), depth_unit_m=0.001, deviations=Deviations(np.ones(4)))
    result = written(calibration(color, camera("depth", "table", placed(0.2))), name)
    for words in expected:
        assert any(words in text for text in result.lost), (words, result.lost)
    assert any("standard deviations" in text for text in result.left_out)


@pytest.mark.parametrize("name", ["tum", "kalibr", "ros"])
def test_a_lens_a_format_has_no_coefficients_for_is_not_cut_short(name: str) -> None:
    lens = ("brown-conrady", (0.1, -0.2, 0, 0, 0.01, 0.1, -0.2, 0.01, 0.001, 0, 0, 0))
    with pytest.raises(CalibrationError, match="12 coefficients"):
        written(calibration(camera(lens=lens)), name)


def test_camera_json_keeps_standard_deviations_and_provenance(tmp_path: Path) -> None:
    deviations = Deviations(np.array([0.5, 0.6, 0.7, 0.8]), np.full(4, 1e-3), None, np.full(3, 1e-4))
    before = Calibration((camera(deviations=deviations),), Provenance("made", "here", ("a note",), ("a warning",)))
    after = read_calibration(write_as(tmp_path, "camera.json", written(before, "page").text))
    assert after.provenance == before.provenance
    found = after.cameras[0].deviations
    assert found is not None
    assert found.rotation_rad is None
    np.testing.assert_array_equal(found.intrinsics_px, deviations.intrinsics_px)


# --- refusals ------------------------------------------------------------------------------------------------------


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
