"""Where the frames of a bag are to each other: /tf_static, and realsense-ros's extrinsics."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np

from page_runtime.capture import ros_messages as ros
from page_runtime.capture.ros_topics import Topics
from page_runtime.geometry import Array, invert, require_rigid, rotation_about, transform_from
from page_runtime.image_files import SourceError

STATIC_TOPIC = "/tf_static"
EXTRINSICS_NAME = "depth_to_color"


def transform_between(topics: Topics, to_frame: str, from_frame: str) -> Array | None:
    """T_to_from (4,4), metres, by the static transforms of the bag, or by realsense-ros's depth_to_color; None where
    neither says it. SourceError for a transform that is none."""
    found = _by_static(topics, to_frame, from_frame)
    return _by_extrinsics(topics) if found is None else found


def _by_static(topics: Topics, to_frame: str, from_frame: str) -> Array | None:
    # Of a frame: its neighbours, and what maps them to it.
    neighbours: dict[str, dict[str, Array]] = defaultdict(dict)
    for topic in (topic for topic in topics.of_kind(ros.TRANSFORMS) if topic.endswith(STATIC_TOPIC)):
        for stored in topics.messages[topic]:
            for stamped in topics.decoded(stored).transforms:
                parent, child = stamped.header.frame_id, stamped.child_frame_id
                T_parent_child = _transform(stamped.transform, where=f"{topics.path}: {topic}, {parent} to {child}")
                neighbours[parent][child], neighbours[child][parent] = T_parent_child, invert(T_parent_child)
    reached, waiting = {to_frame: np.eye(4)}, [to_frame]
    while waiting:
        frame = waiting.pop(0)
        for other, T_frame_other in neighbours[frame].items():
            if other not in reached:
                reached[other] = reached[frame] @ T_frame_other
                waiting.append(other)
    return reached.get(from_frame)


def _transform(transform: Any, *, where: str) -> Array:
    q, t = transform.rotation, transform.translation
    vector = np.array([q.x, q.y, q.z])
    sine, length = float(np.linalg.norm(vector)), float(np.linalg.norm([q.w, q.x, q.y, q.z]))
    if not abs(length - 1.0) < 1e-3:
        raise SourceError(f"{where}: expected a quaternion of length 1, got {length:.4g}")
    R = rotation_about(vector, 2.0 * float(np.arctan2(sine, q.w))) if sine > 0.0 else np.eye(3)
    return transform_from(R, np.array([t.x, t.y, t.z]))


def _by_extrinsics(topics: Topics) -> Array | None:
    """realsense2_camera_msgs/Extrinsics: R column by column, and metres, from depth to colour (librealsense,
    rs2_extrinsics)."""
    for topic in topics.of_kind(ros.EXTRINSICS):
        if topic.endswith(EXTRINSICS_NAME) and (message := topics.first(topic)) is not None:
            T = transform_from(np.reshape(message.rotation, (3, 3)).T, np.asarray(message.translation, dtype=float))
            try:
                return require_rigid(T, name=f"{topics.path}: {topic}")
            except ValueError as error:
                raise SourceError(str(error)) from error
    return None
