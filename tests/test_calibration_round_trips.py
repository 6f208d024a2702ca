"""Calibrations written and read again: without loss, or with the loss said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration_examples import again, calibration, camera, placed, write_as
from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError, Deviations, Provenance
from page_calibration.formats.registry import NAMES, read_calibration, same_lens, written
from page_runtime.camera import Camera
from page_runtime.geometry import invert, rotation_about, transform_from
from page_runtime.lens import Distortion, DistortionModel, RawCamera


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
