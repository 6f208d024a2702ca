"""Recordings of two makers' own tools: RealSense .bag and Azure Kinect .mkv, through Open3D (extra `open3d`).

Open3D aligns the depth of either to colour while it reads. It says a RealSense's K, but not an Azure Kinect's, whose
camera_intrinsic.json must lie beside the file; Microsoft's k4arecord library must be installed for it, and its colour
keeps what lens distortion it has. Neither was tried on a recording of a camera: none was at hand. What is tested is
that other files are refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.camera import Camera
from page_runtime.capture.color_depth import INTRINSICS_FILE, folder_intrinsics
from page_runtime.image_files import SourceError, depth_in_metres
from page_runtime.recorded import FrameEntry, Pixels, Source, require_central, require_playable

REALSENSE_FORMAT = "RealSense recording"
KINECT_FORMAT = "Azure Kinect recording"
ROS1_MAGIC = b"#ROSBAG V2.0"
MATROSKA_MAGIC = b"\x1aE\xdf\xa3"
KINECT_METRES_PER_UNIT = 1e-3
SECONDS_PER_US = 1e-6


def is_realsense_bag(path: Path) -> bool:
    """Whether the file is a bag of ROS 1, which is what RealSense's tools write."""
    return path.suffix.lower() == ".bag" and _begins_with(path, ROS1_MAGIC)


def is_kinect_video(path: Path) -> bool:
    """Whether the file is a Matroska video."""
    return path.suffix.lower() == ".mkv" and _begins_with(path, MATROSKA_MAGIC)


def _begins_with(path: Path, magic: bytes) -> bool:
    with path.open("rb") as file:
        return file.read(len(magic)) == magic


def read_realsense(path: Path) -> Source:
    """A RealSense .bag as a source, without truths."""
    reader = _opened(path, _open3d().t.io.RSBagReader())
    metadata = reader.metadata
    camera = _camera(np.array(metadata.intrinsics.intrinsic_matrix), metadata.width, metadata.height, where=str(path))
    # A float32 of the device: 0.0010000000474974513 is meant to be a millimetre.
    metres_per_unit = float(f"{1.0 / metadata.depth_scale:.6g}")
    return _source(path, REALSENSE_FORMAT, _Frames(path, realsense=True, metres_per_unit=metres_per_unit), camera)


def read_kinect(path: Path) -> Source:
    """An Azure Kinect .mkv as a source, without truths."""
    metadata = _opened(path, _open3d().io.AzureKinectMKVReader()).get_metadata()
    K, size = folder_intrinsics(path.parent)
    if size != (metadata.width, metadata.height):
        raise SourceError(
            f"{path.parent / INTRINSICS_FILE}: K is for {size[0]}x{size[1]} but {path.name} is "
            f"{metadata.width}x{metadata.height}; give the intrinsics of the recorded resolution"
        )
    camera = _camera(np.array(K), *size, where=str(path.parent / INTRINSICS_FILE))
    frames = _Frames(path, realsense=False, metres_per_unit=KINECT_METRES_PER_UNIT)
    return _source(path, KINECT_FORMAT, frames, camera)


def _open3d() -> Any:
    try:
        import open3d
    except ImportError as error:
        raise SourceError(
            "recordings of RealSense (.bag) and Azure Kinect (.mkv) need Open3D, which cannot be loaded "
            f"({error}); pip install 'page-edge[open3d]'"
        ) from error
    return open3d


def _opened(path: Path, reader: Any) -> Any:
    try:
        opened = reader.open(str(path))
    except RuntimeError as error:
        raise SourceError(f"{path}: Open3D cannot open it ({' '.join(str(error).split())[:200]})") from error
    if not opened:
        raise SourceError(f"{path}: Open3D cannot open it; is it whole, and what its suffix says?")
    return reader


def _camera(K: Any, width: int, height: int, *, where: str) -> Camera:
    try:
        camera = Camera(K, int(width), int(height))
    except ValueError as error:
        raise SourceError(f"{where}: {error}") from error
    require_central(camera, where=where)
    return camera


def _source(path: Path, format: str, frames: _Frames, camera: Camera) -> Source:
    entries = tuple(
        FrameEntry(path, path, 0.0, camera, (), time_s, index, 0.0, partial(frames.pixels, index))
        for index, time_s in enumerate(frames.times_s())
    )
    return require_playable(Source(path, format, entries))


@dataclass(eq=False, slots=True)
class _Frames:
    """The frames of a recording, by number; reading them in order decodes each once."""

    path: Path
    realsense: bool
    metres_per_unit: float
    _running: Iterator[tuple[float, Any]] | None = None
    _next: int = 0

    def times_s(self) -> list[float]:
        """The time of every frame."""
        return [time_s for time_s, _ in self._play()]

    def pixels(self, index: int) -> Pixels:
        """Colour and depth of frame `index`."""
        if self._running is None or index < self._next:
            self._running, self._next = self._play(), 0
        for _, image in self._running:
            self._next += 1
            if self._next == index + 1:
                color = np.ascontiguousarray(np.asarray(image.color)[..., :3], dtype=np.uint8)
                units = np.asarray(image.depth).astype(np.uint16).reshape(color.shape[:2])
                return color, depth_in_metres(units, metres_per_unit=self.metres_per_unit)
        raise SourceError(f"{self.path}: frame {index} cannot be read; copy or record it again")

    def _play(self) -> Iterator[tuple[float, Any]]:
        io = _open3d()
        reader = _opened(self.path, io.t.io.RSBagReader() if self.realsense else io.io.AzureKinectMKVReader())
        number = 0
        while not reader.is_eof():
            image = reader.next_frame()
            if image is None or np.asarray(image.color).size == 0:
                continue
            # Open3D tells the time of a RealSense frame only; an Azure Kinect's are 1/30 s apart.
            time_s = reader.get_timestamp() * SECONDS_PER_US if self.realsense else number / 30
            yield time_s, image
            number += 1
