"""Bags of a rig whose depth was not registered to colour: registered on the way, or refused, never taken as it is."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from page_runtime import SourceError, open_source
from page_runtime.capture import ros_messages as ros
from page_runtime.depth_registration import register_depth, registration_between, undistort_color
from page_runtime.geometry import Array, invert, rotation_about, transform_from
from page_runtime.lens import RawCamera
from page_runtime.similarity import so3_log
from rendered_rooms import T_COLOR_DEPTH, look, random_room, rig

DEPTH, COLOR = rig()
COLOR_FRAME, DEPTH_FRAME, LINK = "camera_color_optical_frame", "camera_depth_optical_frame", "camera_link"
COLOR_TOPIC, DEPTH_TOPIC = "/camera/color/image_raw", "/camera/depth/image_rect_raw"
STAMP_NS = 5_000_000_000


@cache
def pictures() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(11)
    room = random_room(rng)
    return look(room, COLOR, rng)[0], look(room, DEPTH, rng)[1]


def header(frame: str) -> Any:
    types = ros.typestore().types
    stamp = types["builtin_interfaces/msg/Time"](sec=STAMP_NS // 10**9, nanosec=0)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def image(pixels: np.ndarray, encoding: str, frame: str) -> Any:
    step = pixels.strides[0]
    data = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
    return ros.typestore().types[ros.IMAGE](
        header=header(frame), height=pixels.shape[0], width=pixels.shape[1], encoding=encoding, is_bigendian=0,
        step=step, data=data,
    )  # fmt: skip


def info(raw: RawCamera, frame: str) -> Any:
    types, camera = ros.typestore().types, raw.camera
    roi = types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return types[ros.INFO](
        header=header(frame), height=camera.height, width=camera.width, distortion_model="plumb_bob",
        d=raw.distortion.coefficients, k=camera.K.ravel(), r=np.eye(3).ravel(),
        p=np.hstack([camera.K, np.zeros((3, 1))]).ravel(), binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip


def transforms(*placed: tuple[str, str, Array], length: float = 1.0) -> Any:
    types, found = ros.typestore().types, []
    for parent, child, T in placed:
        vector = so3_log(np.asarray(T[None, :3, :3], np.float64))[0]
        angle = float(np.linalg.norm(vector))
        x, y, z = np.sin(angle / 2) * vector / max(angle, 1e-12) * length
        rotation = types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=np.cos(angle / 2) * length)
        translation = types["geometry_msgs/msg/Vector3"](**dict(zip("xyz", map(float, T[:3, 3]), strict=True)))
        transform = types["geometry_msgs/msg/Transform"](translation=translation, rotation=rotation)
        stamped = types["geometry_msgs/msg/TransformStamped"](
            header=header(parent), child_frame_id=child, transform=transform
        )
        found.append(stamped)
    return types[ros.TRANSFORMS](transforms=found)


def through_link() -> Any:
    T_link_color = transform_from(rotation_about(np.array([0.4, -1.0, 0.3]), 1.7), np.array([0.01, 0.02, 0.0]))
    return transforms((LINK, COLOR_FRAME, T_link_color), (LINK, DEPTH_FRAME, T_link_color @ T_COLOR_DEPTH))


def extrinsics(T: Array) -> Any:
    return ros.typestore().types[ros.EXTRINSICS](rotation=T[:3, :3].T.ravel(), translation=T[:3, 3].copy())


def write_bag(folder: Path, *more: tuple[str, Any], depth_frame: str = DEPTH_FRAME, depth_info: bool = True) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer

    color, depth_m = pictures()
    messages = [
        (COLOR_TOPIC, image(color, "rgb8", COLOR_FRAME)),
        ("/camera/color/camera_info", info(COLOR, COLOR_FRAME)),
        (DEPTH_TOPIC, image(np.round(depth_m * 1e3).astype(np.uint16), "16UC1", depth_frame)),
        *([("/camera/depth/camera_info", info(DEPTH, depth_frame))] if depth_info else []),
        *more,
    ]
    store = ros.typestore()
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, message in messages:
            connection = writer.add_connection(topic, message.__msgtype__, typestore=store)
            writer.write(connection, STAMP_NS, store.serialize_cdr(message, message.__msgtype__))
    return folder


@pytest.mark.parametrize("said_by", ["transforms", "extrinsics"])
def test_depth_of_its_own_camera_is_registered_to_colour(tmp_path: Path, said_by: str) -> None:
    # The depth camera's lens is already out of an image_rect picture: its CameraInfo's P is what counts.
    straight = RawCamera(DEPTH.camera)
    more = ("/tf_static", through_link()) if said_by == "transforms" else (
        "/camera/extrinsics/depth_to_color", extrinsics(T_COLOR_DEPTH)
    )  # fmt: skip
    source = open_source(write_bag(tmp_path / "bag", more))
    frame = next(iter(source)).frame
    color, depth_m = pictures()
    registration = registration_between(straight, COLOR)
    np.testing.assert_array_equal(frame.color, undistort_color(registration, color))
    expected = register_depth(registration, depth_m)
    same = np.abs(frame.depth_m - expected) < 1e-4
    assert same.mean() > 0.999
    np.testing.assert_array_equal(frame.camera.K, COLOR.camera.K)
    np.testing.assert_array_equal(frame.camera.T_camera_world, np.eye(4))


def test_depth_in_the_frame_of_colour_is_taken_as_it_is_and_must_be_of_its_size(tmp_path: Path) -> None:
    source = open_source(write_bag(tmp_path / "bag", depth_frame=COLOR_FRAME))
    with pytest.raises(SourceError, match="colour is 640x400, depth 480x300"):
        next(iter(source))


@pytest.mark.parametrize(
    ("more", "depth_info", "words"),
    [
        ((), True, r"'camera_depth_optical_frame'.*/tf_static too"),
        ((("/tf_static", transforms((LINK, COLOR_FRAME, np.eye(4)))),), True, "/tf_static too"),
        ((("/tf_static", through_link()),), False, "/camera/depth/camera_info is not in the bag"),
        ((("/tf_static", transforms((COLOR_FRAME, DEPTH_FRAME, np.eye(4)), length=0.5)),), True, "quaternion"),
        ((("/camera/extrinsics/depth_to_color", extrinsics(2 * np.eye(4))),), True, "depth_to_color"),
    ],
    ids=["no transforms", "not these", "no depth camera", "no quaternion", "no rotation"],
)
def test_depth_that_cannot_be_registered_is_refused_with_what_to_record(
    tmp_path: Path, more: tuple[tuple[str, Any], ...], depth_info: bool, words: str
) -> None:
    with pytest.raises(SourceError, match=words):
        open_source(write_bag(tmp_path / "bag", *more, depth_info=depth_info))


def test_extrinsics_are_column_by_column(tmp_path: Path) -> None:
    """A transposed rotation is another one; the inverse must not pass for it either."""
    right = open_source(write_bag(tmp_path / "a", ("/camera/extrinsics/depth_to_color", extrinsics(T_COLOR_DEPTH))))
    other = extrinsics(invert(T_COLOR_DEPTH))
    wrong = open_source(write_bag(tmp_path / "b", ("/camera/extrinsics/depth_to_color", other)))
    depths = [next(iter(source)).frame.depth_m for source in (right, wrong)]
    assert (np.abs(depths[0] - depths[1]) > 0.01).mean() > 0.05
