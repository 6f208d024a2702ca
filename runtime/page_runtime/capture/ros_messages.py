"""Frames as ROS 2 messages and back: Image, CompressedImage, CameraInfo, and what ROS has no message for, as JSON.

Topics are realsense-ros's, which tools know. Depth is 16UC1 millimetres where that is exact, else 32FC1 metres (REP
118), so that a frame comes back to the last bit. K is the undistorted camera's, D is zero.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.image_files import SourceError, decode_color_picture, decode_depth_picture, depth_in_metres
from page_runtime.recorded import Instance, PartTruth, RecordedFrame
from page_runtime.sampling import Region

COLOR_TOPIC = "/camera/color/image_raw"
INFO_TOPIC = "/camera/color/camera_info"
DEPTH_TOPIC = "/camera/aligned_depth_to_color/image_raw"
DEPTH_INFO_TOPIC = "/camera/aligned_depth_to_color/camera_info"
FACTS_TOPIC = "/page_edge/frame"
CALIBRATION_TOPIC = "/page_edge/calibration"
FRAME_ID = "camera_color_optical_frame"

IMAGE, COMPRESSED, INFO, STRING = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
    "std_msgs/msg/String",
)
TRANSFORMS, EXTRINSICS = "tf2_msgs/msg/TFMessage", "realsense2_camera_msgs/msg/Extrinsics"
EXTRINSICS_DEFINITION = "float64[9] rotation\nfloat64[3] translation\n"
MISSING = "ROS 2 bags need rosbags, which is not installed; pip install 'page-edge[ros]'"
METRES_PER_UNIT = 1e-3
COLOR_ENCODINGS = {"rgb8": None, "bgr8": cv2.COLOR_BGR2RGB, "rgba8": cv2.COLOR_RGBA2RGB, "bgra8": cv2.COLOR_BGRA2RGB}
DEPTH_ENCODINGS = ("16UC1", "mono16", "32FC1")
COMPRESSED_DEPTH_HEADER_BYTES = 12


@dataclass(frozen=True, eq=False, slots=True)
class Message:
    """A message to be written. kind: its ROS type. data: CDR."""

    topic: str
    kind: str
    time_ns: int
    data: bytes


@cache
def typestore() -> Any:
    """The message definitions of ROS 2, from rosbags."""
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise SourceError(MISSING) from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(EXTRINSICS_DEFINITION, EXTRINSICS))
    return store


def definition(kind: str) -> str:
    """The text that defines a message type, as MCAP and bags store it."""
    return typestore().generate_msgdef(kind, ros_version=2)[0]


def stamp_ns(head: bytes) -> int:
    """header.stamp, ns, from the first bytes of a message that begins with a header."""
    if len(head) < 12:
        raise SourceError("a message of fewer than 12 bytes has no header")
    order = "little" if head[1] & 1 else "big"
    seconds, nanoseconds = int.from_bytes(head[4:8], order, signed=True), int.from_bytes(head[8:12], order)
    return seconds * 1_000_000_000 + nanoseconds


def messages_of(recorded: RecordedFrame, *, category: str | None, part_names: tuple[str, ...]) -> Iterator[Message]:
    """The messages of one frame, colour first; the last completes it."""
    frame = recorded.frame
    color_ns = round(frame.timestamp_s * 1e9)
    depth_ns = round((frame.timestamp_s + frame.skew_s) * 1e9)
    facts = json.dumps(_facts(recorded, category, part_names), allow_nan=False)
    yield message_of(INFO_TOPIC, color_ns, _camera_info(frame.camera, color_ns))
    yield message_of(DEPTH_INFO_TOPIC, depth_ns, _camera_info(frame.camera, depth_ns))
    yield text_message(FACTS_TOPIC, color_ns, facts)
    yield message_of(COLOR_TOPIC, color_ns, _image(frame.color.reshape(-1), "rgb8", frame.camera, 3, color_ns))
    units = exact_units(frame.depth_m, metres_per_unit=METRES_PER_UNIT)
    pixels, encoding, size = (frame.depth_m, "32FC1", 4) if units is None else (units, "16UC1", 2)
    image = _image(np.ascontiguousarray(pixels).view(np.uint8).reshape(-1), encoding, frame.camera, size, depth_ns)
    yield message_of(DEPTH_TOPIC, depth_ns, image)


def text_message(topic: str, time_ns: int, text: str) -> Message:
    """A String."""
    return message_of(topic, time_ns, typestore().types[STRING](data=text))


def exact_units(depth_m: NDArray[np.float32], *, metres_per_unit: float) -> NDArray[np.uint16] | None:
    """Depth in whole units, or None where that would change a reading."""
    units = np.rint(depth_m * (1.0 / metres_per_unit))
    if not (units.min(initial=0) >= 0 and units.max(initial=0) <= np.iinfo(np.uint16).max):
        return None
    whole = units.astype(np.uint16)
    return whole if np.array_equal(depth_in_metres(whole, metres_per_unit=metres_per_unit), depth_m) else None


def message_of(topic: str, time_ns: int, message: Any) -> Message:
    """A message object of the type store, as bytes."""
    kind = message.__msgtype__
    return Message(topic, kind, time_ns, bytes(typestore().serialize_cdr(message, kind)))


def header_at(time_ns: int) -> Any:
    """A Header of the colour camera's optical frame."""
    types = typestore().types
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=FRAME_ID)


def _image(data: NDArray[np.uint8], encoding: str, camera: Camera, pixel_bytes: int, time_ns: int) -> Any:
    return typestore().types[IMAGE](
        header=header_at(time_ns),
        height=camera.height,
        width=camera.width,
        encoding=encoding,
        is_bigendian=0,
        step=camera.width * pixel_bytes,
        data=data,
    )


def _camera_info(camera: Camera, time_ns: int) -> Any:
    types = typestore().types
    roi = types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return types[INFO](
        header=header_at(time_ns),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=camera.K.ravel(),
        r=np.eye(3).ravel(),
        p=np.hstack([camera.K, np.zeros((3, 1))]).ravel(),
        binning_x=0,
        binning_y=0,
        roi=roi,
    )


def _facts(recorded: RecordedFrame, category: str | None, part_names: tuple[str, ...]) -> dict[str, Any]:
    frame = recorded.frame
    return {
        "index": frame.index,
        "timestamp_s": frame.timestamp_s,
        "skew_s": frame.skew_s,
        "T_camera_world": frame.camera.T_camera_world.tolist(),
        "category": category,
        "parts": list(part_names),
        "instances": [
            {
                "region": None if instance.region is None else [int(value) for value in instance.region],
                "truths": None if instance.truths is None else [_truth(truth) for truth in instance.truths],
            }
            for instance in recorded.instances
        ],
    }


def _truth(truth: PartTruth) -> dict[str, Any]:
    return {
        "name": truth.name,
        "T_camera_part": truth.T_camera_part.tolist(),
        "extents_m": truth.extents_m.tolist(),
        "visible_share": truth.visible_share,
        "joint_state": truth.joint_state,
    }


def instances_of(facts: dict[str, Any]) -> tuple[Instance, ...]:
    """The objects that a frame's JSON tells of."""
    return tuple(
        Instance(
            _region(entry["region"]),
            None if entry["truths"] is None else tuple(PartTruth(**truth) for truth in entry["truths"]),
        )
        for entry in facts["instances"]
    )


def _region(values: list[int] | None) -> Region | None:
    if values is None:
        return None
    x, y, width, height = (int(value) for value in values)
    return x, y, width, height


def decode(data: bytes, kind: str, *, where: str) -> Any:
    """A message object; SourceError when the bytes are none of that type."""
    try:
        return typestore().deserialize_cdr(data, kind)
    except Exception as error:
        # The generated parsers raise whatever the damaged bytes lead to: struct.error, IndexError, UnicodeDecodeError.
        if isinstance(error, SourceError):
            raise
        raise SourceError(f"{where}: a damaged {kind} ({type(error).__name__}: {error})") from error


def is_depth(message: Any) -> bool:
    """Whether an Image or CompressedImage holds depth."""
    encoding = message.format if hasattr(message, "format") else message.encoding
    return encoding in DEPTH_ENCODINGS or "compressedDepth" in encoding


def color_pixels(message: Any, *, where: str) -> NDArray[np.uint8]:
    """(H,W,3) uint8 RGB of an Image or CompressedImage."""
    if hasattr(message, "format"):
        return decode_color_picture(message.data, where=where)
    if message.encoding not in COLOR_ENCODINGS:
        raise SourceError(f"{where}: expected colour as {', '.join(COLOR_ENCODINGS)}, got {message.encoding!r}")
    channels = 4 if message.encoding.endswith("a8") else 3
    pixels = _rows(message, np.dtype(np.uint8), channels, where=where).reshape(message.height, message.width, channels)
    conversion = COLOR_ENCODINGS[message.encoding]
    return (
        np.ascontiguousarray(pixels) if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)
    )


def depth_pixels(message: Any, *, where: str) -> NDArray[np.float32]:
    """(H,W) float32 metres of an Image or CompressedImage of depth."""
    if hasattr(message, "format"):
        units = decode_depth_picture(message.data[COMPRESSED_DEPTH_HEADER_BYTES:], where=where)
        return depth_in_metres(units, metres_per_unit=METRES_PER_UNIT)
    if message.encoding not in DEPTH_ENCODINGS:
        raise SourceError(f"{where}: expected depth as {', '.join(DEPTH_ENCODINGS)}, got {message.encoding!r}")
    kind = np.dtype(np.float32 if message.encoding == "32FC1" else np.uint16)
    order = kind.newbyteorder(">" if message.is_bigendian else "<")
    pixels = _rows(message, order, 1, where=where)
    if kind == np.uint16:
        return depth_in_metres(pixels.astype(np.uint16), metres_per_unit=METRES_PER_UNIT)
    # REP 118: too near is -inf, too far +inf, nothing seen NaN; none of them is a reading.
    return np.nan_to_num(pixels.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)


def _rows(message: Any, kind: np.dtype[Any], channels: int, *, where: str) -> NDArray[Any]:
    """(H, W * channels) of the rows of an Image, without what pads them."""
    used = message.width * channels * kind.itemsize
    if message.step < used or len(message.data) < message.step * message.height or not used:
        raise SourceError(
            f"{where}: expected {message.height} rows of {used} bytes, got {len(message.data)} bytes in rows of "
            f"{message.step}"
        )
    rows = message.data[: message.step * message.height].reshape(message.height, message.step)[:, :used]
    return np.ascontiguousarray(rows).view(kind)
