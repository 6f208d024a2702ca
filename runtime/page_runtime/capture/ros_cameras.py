"""The cameras of a bag: colour's by its CameraInfo, and depth's where depth has yet to be registered to colour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.capture import ros_messages as ros
from page_runtime.capture.ros_topics import REGISTERED_WORDS, Topics
from page_runtime.capture.ros_transforms import transform_between
from page_runtime.capture.undistortion import lens_of
from page_runtime.depth_registration import Registration, registration_between
from page_runtime.geometry import Array
from page_runtime.image_files import SourceError
from page_runtime.lens import NO_DISTORTION, RawCamera
from page_runtime.recorded import require_central


@dataclass(frozen=True, eq=False, slots=True)
class Cameras:
    """What CameraInfo said, by its stamp; several: whether it did not always say the same."""

    by_stamp_ns: Mapping[int, RawCamera]
    several: bool

    def at(self, stamp_ns: int) -> RawCamera | None:
        """The camera of a picture: of a camera that changes only what was said with that very picture."""
        if self.several:
            return self.by_stamp_ns.get(stamp_ns)
        return next(iter(self.by_stamp_ns.values()))


@dataclass(frozen=True, eq=False, slots=True)
class Registering:
    """How depth comes to colour: the depth camera, and where colour is to it. What depends on the colour camera alone
    is computed when it is first asked for, once."""

    depth: RawCamera
    T_color_depth: Array
    _known: dict[int, tuple[RawCamera, Registration]] = field(default_factory=dict)

    def to(self, color: RawCamera) -> Registration:
        """The registration to a colour camera."""
        if id(color) not in self._known:
            placed = replace(color, camera=replace(color.camera, T_camera_world=self.T_color_depth))
            self._known[id(color)] = color, registration_between(self.depth, placed)
        return self._known[id(color)][1]


def cameras_of(topics: Topics, pictures: str) -> Cameras:
    """The camera of a topic of pictures by the CameraInfo beside it; damaged messages of it are left out."""
    namespace, wanted = _namespace(pictures), f"{_namespace(pictures)}/camera_info"
    infos = topics.of_kind(ros.INFO)
    if wanted not in infos and len(infos) != 1:
        found = ", ".join(infos) or "none"
        raise SourceError(f"{topics.path}: expected {wanted} for {pictures}, found {found}; record it too")
    topic = wanted if wanted in infos else infos[0]
    is_rectified = "rect" in pictures.removeprefix(namespace)
    by_stamp_ns, said = {}, {}
    for stored in topics.messages[topic]:
        try:
            info = topics.decoded(stored)
        except SourceError:
            continue
        what = (info.width, info.height, info.distortion_model, *map(float, (*info.k, *info.d, *info.p)))
        if what not in said:
            said[what] = _camera(info, is_rectified=is_rectified, where=f"{topics.path}: {topic}")
        by_stamp_ns[ros.stamp_ns(stored[1].head)] = said[what]
    if not by_stamp_ns:
        raise SourceError(f"{topics.path}: every message of {topic} is damaged")
    return Cameras(by_stamp_ns, len(said) > 1)


def _namespace(pictures: str) -> str:
    return pictures.removesuffix("/compressed").removesuffix("/compressedDepth").rsplit("/", 1)[0]


def _camera(info: Any, *, is_rectified: bool, where: str) -> RawCamera:
    K = np.reshape(info.p, (3, 4))[:, :3] if is_rectified else np.reshape(info.k, (3, 3))
    try:
        camera = Camera(K.astype(float), int(info.width), int(info.height))
    except ValueError as error:
        raise SourceError(f"{where}: {error}") from error
    require_central(camera, where=where)
    if is_rectified or not len(info.d):
        return RawCamera(camera, NO_DISTORTION)
    return RawCamera(camera, lens_of(info.distortion_model, info.d, where=where))


def registering_of(topics: Topics, color: str, depth: str) -> Registering | None:
    """How the depth topic comes to the colour topic; None where it is registered already.

    It is where its messages carry colour's frame, or none at all, or its name says so. Depth of another frame with
    nothing in the bag to register it by is refused: taken as it is it would put every point beside its colour.
    """
    frames = [getattr(getattr(topics.first(topic), "header", None), "frame_id", "") for topic in (color, depth)]
    if frames[0] == frames[1] or not all(frames) or any(word in depth for word in REGISTERED_WORDS):
        return None
    T_color_depth = transform_between(topics, *frames)
    if T_color_depth is None:
        raise SourceError(
            f"{topics.path}: {depth} is in the frame {frames[1]!r}, {color} in {frames[0]!r}, and nothing in the bag "
            "says where they are to each other; record /tf_static too, or depth registered to colour "
            "(aligned_depth_to_color)"
        )
    if f"{_namespace(depth)}/camera_info" not in topics.of_kind(ros.INFO):
        raise SourceError(
            f"{topics.path}: {depth} has yet to be registered to colour, and its {_namespace(depth)}/camera_info is "
            "not in the bag; record it too, or depth registered to colour (aligned_depth_to_color)"
        )
    cameras = cameras_of(topics, depth)
    if cameras.several:
        raise SourceError(f"{topics.path}: the camera of {depth} changes, which cannot be registered; record it anew")
    return Registering(next(iter(cameras.by_stamp_ns.values())), T_color_depth)


def require_size(picture: NDArray[Any], camera: Camera, *, where: str) -> None:
    """SourceError when a picture is not of the size its CameraInfo is for."""
    if picture.shape[:2] != (camera.height, camera.width):
        raise SourceError(
            f"{where}: the picture is {picture.shape[1]}x{picture.shape[0]}, its CameraInfo says "
            f"{camera.width}x{camera.height}; record the camera_info of the pictures"
        )
