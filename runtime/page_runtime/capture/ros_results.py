"""Results as ROS 2 messages beside the frames they are of: TF, markers, joint states, and the line of JSON.

Frames of parts are named object_NUMBER/PART, spaces as underscores, below the colour camera's optical frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from page_runtime.capture.ros_messages import Message, header_at, message_of, text_message, typestore
from page_runtime.geometry import Array
from page_runtime.live.result import LiveObject, LiveResult
from page_runtime.overlay import PART_COLORS
from page_runtime.pose import PartPose
from page_runtime.schema import json_line, result_record
from page_runtime.similarity import unit_quaternions

TF_TOPIC = "/tf"
MARKERS_TOPIC = "/page_edge/markers"
JOINTS_TOPIC = "/page_edge/joint_states"
RESULT_TOPIC = "/page_edge/result"

BOX_ALPHA = 0.4
# A text of 8 % of the part's diagonal can be read beside it.
TEXT_SHARE = 0.08


def part_frame(number: int, part: str) -> str:
    """The TF frame of a part of object `number`."""
    return f"object_{number}/{part.replace(' ', '_')}"


def result_messages(result: LiveResult) -> Iterator[Message]:
    """The messages of one result, stamped with the frame's time; no transform of a part that has no pose."""
    time_ns = round(result.frame.timestamp_s * 1e9)
    types = typestore().types
    seen = [
        (found.number, k, part)
        for found in result.objects
        for k, part in enumerate(found.pose.parts)
        if isinstance(part, PartPose)
    ]
    transforms = [_transform(part_frame(number, part.name), part.T_camera_part, time_ns) for number, _, part in seen]
    yield message_of(TF_TOPIC, time_ns, types["tf2_msgs/msg/TFMessage"](transforms=transforms))
    # The first marker takes away those of the result before: what was lost must not stay on the screen.
    markers = [_marker(time_ns, action=types["visualization_msgs/msg/Marker"].DELETEALL)]
    for at, (number, k, part) in enumerate(seen):
        markers += _part_markers(number, k, part, time_ns, first_id=2 * at)
    yield message_of(MARKERS_TOPIC, time_ns, types["visualization_msgs/msg/MarkerArray"](markers=markers))
    yield message_of(JOINTS_TOPIC, time_ns, _joint_state(result.objects, time_ns))
    yield text_message(RESULT_TOPIC, time_ns, json_line(result_record(result)).rstrip())


def _quaternion(T_camera_part: Array) -> Any:
    w, x, y, z = (float(value) for value in unit_quaternions(np.asarray(T_camera_part, float)[None, :3, :3])[0])
    return typestore().types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)


def _vector(values: Array, kind: str = "Vector3") -> Any:
    x, y, z = (float(value) for value in values)
    return typestore().types[f"geometry_msgs/msg/{kind}"](x=x, y=y, z=z)


def _transform(child: str, T_camera_part: Array, time_ns: int) -> Any:
    types = typestore().types
    transform = types["geometry_msgs/msg/Transform"](
        translation=_vector(T_camera_part[:3, 3]), rotation=_quaternion(T_camera_part)
    )
    return types["geometry_msgs/msg/TransformStamped"](
        header=header_at(time_ns), child_frame_id=child, transform=transform
    )


def _part_markers(number: int, k: int, part: PartPose, time_ns: int, *, first_id: int) -> list[Any]:
    """The part's box, and its name and confidence above it."""
    kind = typestore().types["visualization_msgs/msg/Marker"]
    color = np.array(PART_COLORS[k % len(PART_COLORS)]) / 255.0
    name, place = part_frame(number, part.name), np.asarray(part.T_camera_part)
    diagonal_m = float(np.linalg.norm(part.extents_m))
    letters_m = np.array([0.0, 0.0, TEXT_SHARE * diagonal_m])
    above = place.copy()
    above[1, 3] -= (0.5 + TEXT_SHARE) * diagonal_m
    text = f"{part.name} {part.confidence:.2f}"
    return [
        _marker(time_ns, name, first_id, kind.CUBE, kind.ADD, place, part.extents_m, color, BOX_ALPHA),
        _marker(time_ns, name, first_id + 1, kind.TEXT_VIEW_FACING, kind.ADD, above, letters_m, color, 1.0, text=text),
    ]


def _marker(
    time_ns: int,
    name: str = "",
    number: int = 0,
    kind: int = 0,
    action: int = 0,
    T_camera_marker: Array | None = None,
    scale_m: Array | None = None,
    color: Array | None = None,
    alpha: float = 0.0,
    *,
    text: str = "",
) -> Any:
    types, nothing = typestore().types, np.zeros(0, np.uint8)
    place = np.eye(4) if T_camera_marker is None else T_camera_marker
    red, green, blue = (0.0, 0.0, 0.0) if color is None else (float(value) for value in color)
    return types["visualization_msgs/msg/Marker"](
        header=header_at(time_ns),
        ns=name,
        id=number,
        type=kind,
        action=action,
        pose=types["geometry_msgs/msg/Pose"](position=_vector(place[:3, 3], "Point"), orientation=_quaternion(place)),
        scale=_vector(np.zeros(3) if scale_m is None else scale_m),
        color=types["std_msgs/msg/ColorRGBA"](r=red, g=green, b=blue, a=alpha),
        lifetime=types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=types["sensor_msgs/msg/CompressedImage"](header=header_at(time_ns), format="", data=nothing),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=types["visualization_msgs/msg/MeshFile"](filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )


def _joint_state(objects: tuple[LiveObject, ...], time_ns: int) -> Any:
    """The joints that have a state, rad or m, named as their child frames would be."""
    states = [
        (part_frame(found.number, joint.name), float(joint.value))
        for found in objects
        for joint in found.pose.joints
        if joint.value is not None
    ]
    return typestore().types["sensor_msgs/msg/JointState"](
        header=header_at(time_ns),
        name=[name for name, _ in states],
        position=np.array([value for _, value in states], dtype=np.float64),
        velocity=np.zeros(0),
        effort=np.zeros(0),
    )
