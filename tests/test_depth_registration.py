"""From raw pixels of two cameras to one frame: the right depth at the right pixel, whatever the units on disk."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from page_calibration.formats.registry import read_calibration, written
from page_runtime import Network, RgbdFrame, estimate, open_source
from page_runtime.camera import Camera
from page_runtime.depth_registration import Registration, register_depth, registered_frame, registration_between
from page_runtime.geometry import Array, apply, invert, rotation_about, transform_from
from page_runtime.image_files import write_color, write_depth
from page_runtime.lens import Distortion, RawCamera, sampled
from page_runtime.pose import PartPose

ROOT = Path(__file__).resolve().parents[1]
DEPTH = RawCamera(
    Camera(np.array([[431.0, 0, 322.0], [0, 432.0, 203.0], [0, 0, 1]]), 640, 400),
    Distortion("brown-conrady", np.array([-0.12, 0.05, 0.001, -0.0007, -0.01])),
)
T_COLOR_DEPTH = transform_from(rotation_about(np.array([0.2, 1.0, 0.3]), 0.06), np.array([-0.075, 0.01, 0.02]))
COLOR = RawCamera(
    Camera(np.array([[640.0, 0, 474.0], [0, 642.0, 275.0], [0, 0, 1]]), 960, 540, T_COLOR_DEPTH),
    Distortion("brown-conrady", np.array([0.12, -0.25, 0.0004, 0.0006, 0.1])),
)
# n . X = d in the depth camera's frame: 40 degrees to the axis, 0.6 to 3.5 m away.
NORMAL = np.array([0.6, 0.25, -0.76]) / np.linalg.norm([0.6, 0.25, -0.76])
OFFSET = float(NORMAL @ [0.0, 0.0, 1.0])


def pixel_grid(camera: Camera) -> Array:
    rows, columns = np.mgrid[: camera.height, : camera.width]
    return np.stack([columns, rows], axis=-1).astype(float)


@cache
def pixel_rays(raw: RawCamera) -> Array:
    return raw.rays(pixel_grid(raw.camera))


def plane_depth(raw: RawCamera, normal: Array = NORMAL, offset: float = OFFSET) -> Array:
    """True z-depth (H,W) of the plane of the depth camera's frame, seen by a camera placed in it."""
    T = raw.camera.T_camera_world
    normal_camera = T[:3, :3] @ normal
    return (offset + normal_camera @ T[:3, 3]) / (pixel_rays(raw) @ normal_camera)


@cache
def points_color() -> Array:
    """What each raw colour pixel sees of the plane, (H,W,3), colour camera's frame."""
    return pixel_rays(COLOR) * plane_depth(COLOR)[..., None]


@cache
def registration() -> Registration:
    return registration_between(DEPTH, COLOR)


def sensor_depth(step_m: float = 0.0) -> np.ndarray:
    z = plane_depth(DEPTH)
    return (np.round(z / step_m) * step_m if step_m else z).astype(np.float32)


@cache
def true_registered() -> Array:
    return plane_depth(RawCamera(COLOR.camera))


def error_mm(registered: np.ndarray) -> Array:
    """Along each registered pixel's ray, of pixels that have a reading."""
    rays = COLOR.camera.rays(pixel_grid(COLOR.camera))
    wrong = np.abs(registered - true_registered()) * np.linalg.norm(rays, axis=-1)
    return wrong[registered > 0] * 1e3


def test_registered_depth_of_a_slanted_plane_is_exact_between_the_sensors_pixels() -> None:
    registered = register_depth(registration(), sensor_depth())
    assert (registered > 0).mean() > 0.85
    assert np.percentile(error_mm(registered), 99.9) < 0.35
    rounded = register_depth(registration(), sensor_depth(1e-3))
    assert np.percentile(error_mm(rounded), 99.9) < 1.0  # the sensor's own rounding is 0.5 mm of z


def test_it_is_nearer_to_the_truth_than_opencvs_rounding_alone() -> None:
    nearest = sampled(sensor_depth(), registration().depth_map, nearest=True)
    rounded = cv2.registerDepth(
        DEPTH.camera.K, COLOR.camera.K, np.zeros(4), T_COLOR_DEPTH, np.where(nearest > 0, nearest, np.nan), (960, 540),
        depthDilation=True,
    )  # fmt: skip
    rounded = np.nan_to_num(rounded)
    assert np.median(error_mm(register_depth(registration(), sensor_depth()))) < 0.1 * np.median(error_mm(rounded))


def test_each_pixel_shows_the_nearest_surface_its_ray_meets() -> None:
    """A plate in front of the plane; at its outline and where its shadow falls, half a sensor's pixel is free."""
    near, x, y = 0.45, (200, 400), (100, 260)
    depth = sensor_depth()
    depth[y[0] : y[1], x[0] : x[1]] = near
    registered = register_depth(registration(), depth)

    plate = plane_depth(RawCamera(COLOR.camera), np.array([0.0, 0.0, 1.0]), near)
    on_plate = np.nan_to_num(_raw_depth_pixel(plate), nan=-99.0)
    inside, outside = (
        (on_plate >= [x[0] - m, y[0] - m]).all(axis=-1) & (on_plate <= [x[1] - 1 + m, y[1] - 1 + m]).all(axis=-1)
        for m in (-1.0, 1.5)
    )
    np.testing.assert_allclose(registered[inside], plate[inside], rtol=2e-3)
    behind = np.nan_to_num(_raw_depth_pixel(true_registered()), nan=-99.0)
    shadow = (behind >= [x[0] - 2, y[0] - 2]).all(axis=-1) & (behind <= [x[1] + 1, y[1] + 1]).all(axis=-1)
    free = ~outside & ~shadow & (registered > 0)
    assert free.mean() > 0.6
    np.testing.assert_allclose(registered[free], true_registered()[free], rtol=5e-3)
    assert not registered[shadow & ~outside & (cv2.erode(np.asarray(shadow, np.uint8), np.ones((9, 9))) > 0)].any()


def _raw_depth_pixel(z: Array) -> Array:
    """Where the raw depth camera sees the points that COLOR's pinhole has at depth z (H,W)."""
    return DEPTH.project(apply(invert(T_COLOR_DEPTH), COLOR.camera.backproject(pixel_grid(COLOR.camera), z)))


def test_no_reading_stays_no_reading() -> None:
    assert not register_depth(registration(), np.zeros((400, 640), np.float32)).any()
    depth = sensor_depth()
    depth[150:250, 300:420] = 0.0
    hole = DEPTH.rays(np.array([[360.0, 200.0]]))[0] * sensor_depth()[200, 360]
    u, v = np.rint(COLOR.camera.project(apply(T_COLOR_DEPTH, hole))).astype(int)
    assert not register_depth(registration(), depth)[v - 20 : v + 20, u - 20 : u + 20].any()


@pytest.mark.parametrize("spot", [(60, 60), (560, 80), (330, 200), (520, 330), (90, 340)])
def test_a_spot_goes_from_raw_pixels_through_registration_crop_and_resize_to_its_3d_point(
    spot: tuple[int, int],
) -> None:
    """Distortion, turned cameras, unequal sizes; within 0.1 px and 1 mm."""
    z = float(plane_depth(DEPTH)[spot[1], spot[0]])
    point_depth = DEPTH.backproject(np.array(spot, dtype=float), np.array(z))
    point_color = apply(T_COLOR_DEPTH, point_depth)
    u, v = COLOR.camera.project(point_depth)
    if not (40 < u < 920 and 40 < v < 500):
        pytest.fail(f"the spot {spot} is at ({u:.0f}, {v:.0f}), outside the colour picture")
    distance = np.linalg.norm(points_color() - point_color, axis=-1)
    gray = 255.0 * np.exp(-0.5 * (distance / (4.0 * point_color[2] / 640.0)) ** 2)
    color = np.repeat(gray.round().astype(np.uint8)[..., None], 3, axis=2)

    frame = registered_frame(registration(), color, sensor_depth(1e-3))
    x, y = round(float(u)) - 30, round(float(v)) - 25
    crop = frame.camera.cropped(x, y, 60, 50).resized(240, 200)
    picture = cv2.resize(frame.color[y : y + 50, x : x + 60, 0], (240, 200), interpolation=cv2.INTER_CUBIC)
    weight = picture.astype(float) ** 2
    rows, columns = np.mgrid[:200, :240]
    center = np.array([(columns * weight).sum(), (rows * weight).sum()]) / weight.sum()
    # Foreshortening moves a wide spot's centre of mass; compare with the same spot drawn by the true pinhole.
    ideal = np.linalg.norm(crop.backproject(pixel_grid(crop), plane_depth(RawCamera(crop))) - point_color, axis=-1)
    ideal = np.exp(-0.5 * (ideal / (4.0 * point_color[2] / 640.0)) ** 2) ** 2
    expected = np.array([(columns * ideal).sum(), (rows * ideal).sum()]) / ideal.sum()
    assert np.linalg.norm(expected - crop.project(point_depth)) < 1.0
    assert np.linalg.norm(center - expected) / 4.0 < 0.1  # 4 of these pixels are one of the colour camera's
    column, row = np.rint(crop.project(point_depth)).astype(int)
    depth = cv2.resize(frame.depth_m[y : y + 50, x : x + 60], (240, 200), interpolation=cv2.INTER_LINEAR)
    found = crop.backproject(crop.project(point_depth), np.asarray(depth[row, column], dtype=float))
    assert np.linalg.norm(found - point_color) < 1e-3
    np.testing.assert_allclose(apply(invert(T_COLOR_DEPTH), found), point_depth, atol=1e-3)


def test_pictures_of_another_size_or_type_than_their_camera_are_refused() -> None:
    with pytest.raises(ValueError, match="expected 640x400 float32, the size its camera is for, got 640x480"):
        register_depth(registration(), np.zeros((480, 640), np.float32))
    with pytest.raises(ValueError, match="got 640x400 uint16"):
        register_depth(registration(), np.zeros((400, 640), np.uint16))  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="color: expected 960x540 uint8"):
        registered_frame(registration(), np.zeros((400, 640, 3), np.uint8), sensor_depth())


def test_the_same_scene_in_mm_m_bop_scale_and_tum_units_gives_the_same_pose(tmp_path: Path) -> None:
    recorded = open_source(ROOT / "tests" / "data" / "box").entries[0].read()
    region = recorded.instances[0].region
    assert region is not None
    frame = recorded.frame
    depth_m = (np.round(frame.depth_m * 1e3) * 1e-3).astype(np.float32)
    frames = {"m": RgbdFrame(frame.color, depth_m, frame.camera)}
    settings = (
        (
            "%YAML:1.0\n---\n"
            + "".join(
                f"Camera.{n}: {frame.camera.K[i, j]!r}\n"
                for n, i, j in (("fx", 0, 0), ("fy", 1, 1), ("cx", 0, 2), ("cy", 1, 2))
            )
            + f"Camera.width: {frame.camera.width}\nCamera.height: {frame.camera.height}\nDepthMapFactor: 5000.0\n"
        )
        .replace("np.float64(", "")
        .replace(")", "")
    )
    (tmp_path / "TUM.yaml").write_text(settings)
    tum = written(read_calibration(tmp_path / "TUM.yaml"), "open3d").text
    millimetres = json.dumps({k: v for k, v in json.loads(tum).items() if k != "depth_scale"})
    for name, intrinsics, unit_m in (("mm", millimetres, 1e-3), ("tum", tum, 1 / 5000)):
        for folder in ("color", "depth"):
            (tmp_path / name / folder).mkdir(parents=True)
        write_color(tmp_path / name / "color" / "0.png", frame.color)
        write_depth(tmp_path / name / "depth" / "0.png", depth_m, metres_per_unit=unit_m)
        (tmp_path / name / "camera_intrinsic.json").write_text(intrinsics)
        frames[name] = open_source(tmp_path / name).entries[0].read().frame
    bop = tmp_path / "bop"
    for folder in ("rgb", "depth"):
        (bop / folder).mkdir(parents=True)
    write_color(bop / "rgb" / "000000.png", frame.color)
    write_depth(bop / "depth" / "000000.png", depth_m, metres_per_unit=1e-4)
    (bop / "scene_camera.json").write_text(
        json.dumps({"0": {"cam_K": frame.camera.K.ravel().tolist(), "depth_scale": 0.1}})
    )
    frames["bop"] = open_source(bop).entries[0].read().frame
    network = Network(ROOT / "runtime" / "bundles" / "box.onnx", threads=1)
    poses = {name: estimate(network, one, region) for name, one in frames.items()}
    for name, pose in poses.items():
        for part, reference in zip(pose.parts, poses["m"].parts, strict=True):
            assert isinstance(part, PartPose), name
            assert isinstance(reference, PartPose)
            np.testing.assert_allclose(part.T_camera_part, reference.T_camera_part, atol=1e-4)
