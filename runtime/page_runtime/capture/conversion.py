"""Frames from any source into any format that can be written; the target's name or `layout` says which.

Every format keeps colour, depth, time and camera to the last bit (TUM and folders: depth in the largest unit that is
exact), or refuses. Only the project's recording and its MCAP keep objects and true poses.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from page_runtime.camera import Camera
from page_runtime.capture.color_depth import INTRINSICS_FILE
from page_runtime.capture.color_video import VIDEO_NAMES, VideoWriter
from page_runtime.capture.documents import METRES_PER_MM, TIMES_FILE
from page_runtime.capture.mcap_recording import SUFFIX, McapRecordingWriter
from page_runtime.capture.ros_messages import CALIBRATION_TOPIC, exact_units, messages_of, text_message, typestore
from page_runtime.capture.tum import METRES_PER_UNIT as TUM_METRES_PER_UNIT
from page_runtime.image_files import PNG_FAST, SourceError, write_color, write_depth
from page_runtime.recorded import RecordedFrame
from page_runtime.recording import RecordingWriter

LEAST_STEP_S = 1e-6
EMPTY = "nothing to write: the source gave no frames"
# What cameras and data sets count depth in, mm.
DEPTH_UNITS_MM = (1.0, 0.5, 0.25, 0.2, 0.125, 0.1)


class FrameWriter(Protocol):
    """Takes frames in order; the first may bring the camera's calibration."""

    def write(self, recorded: RecordedFrame, *, calibration: str | None = None) -> int: ...


def layout_of(target: Path, layout: str | None) -> str:
    """The layout that is asked for, or that the target's name says: an .mcap file, else a recording's folder."""
    return layout or ("mcap" if target.suffix.lower() == SUFFIX else "recording")


def partial_of(target: Path) -> Path:
    """Where a folder grows before it takes its name."""
    return target.with_name(f".{target.name}.partial")


@contextmanager
def frame_writer(
    target: Path, layout: str | None = None, *, category: str | None = None, part_names: tuple[str, ...] = ()
) -> Iterator[FrameWriter]:
    """A writer into `target`, which must not exist. A folder takes its name when the block ends well; an MCAP file has
    its name from the first frame on, as it is worth something at any time."""
    if target.exists():
        raise FileExistsError(f"{target}: exists already; nothing is ever overwritten, give another name")
    kind = layout_of(target, layout)
    if kind == "mcap":
        recording = McapRecordingWriter(target, category=category, part_names=part_names)
        try:
            with recording:
                yield _InTime(recording)
            if not recording.frames:
                raise SourceError(EMPTY)
        finally:
            if not recording.frames:
                target.unlink()
    elif kind == "recording":
        writer = _Recording(target, category=category, part_names=part_names)
        try:
            yield writer
        except BaseException as error:
            writer.close(error)
            raise
        writer.close(None)
    else:
        partial = partial_of(target)
        shutil.rmtree(partial, ignore_errors=True)
        kinds = {"tum": _Tum, "pictures": _Pictures, "video": _Video}
        if kind in kinds:
            partial.mkdir(parents=True)
            folder = kinds[kind](partial)
        else:
            folder = _Bag(partial, kind, category, part_names)
        try:
            yield folder if kind in ("pictures", "video") else _InTime(folder)
            folder.close()
            partial.rename(target)
        finally:
            shutil.rmtree(partial, ignore_errors=True)


class _InTime:
    """Hands on frames whose times increase. These layouts know a frame by its time, and of frames of one time, as data
    sets without times have, one would be read with the pictures or the camera of another."""

    def __init__(self, writer: FrameWriter) -> None:
        self._writer, self._last_s = writer, -math.inf

    def write(self, recorded: RecordedFrame, *, calibration: str | None = None) -> int:
        frame = recorded.frame
        if frame.timestamp_s < self._last_s + LEAST_STEP_S:
            raise SourceError(
                f"frame {frame.index}: expected a time after {self._last_s:.6f} s, that of the frame before, got "
                f"{frame.timestamp_s:.6f} s, and this layout knows frames by their times; give them times "
                "(page-runtime convert --fps), or write a recording's folder"
            )
        self._last_s = frame.timestamp_s
        return self._writer.write(recorded, calibration=calibration)


class _Recording:
    """The project's recording; its depth unit is known with the first frame."""

    def __init__(self, target: Path, *, category: str | None, part_names: tuple[str, ...]) -> None:
        self._target, self._category, self._part_names = target, category, part_names
        self._writer: RecordingWriter | None = None

    def write(self, recorded: RecordedFrame, *, calibration: str | None = None) -> int:
        if self._writer is None:
            self._writer = RecordingWriter(
                self._target,
                category=self._category,
                part_names=self._part_names,
                depth_unit_mm=exact_unit_mm(recorded),
                effort=PNG_FAST,
            ).__enter__()
        require_exact(recorded, self._writer.depth_unit_mm * METRES_PER_MM)
        if calibration is not None:
            self._writer.keep_calibration(calibration)
        return self._writer.write(recorded)

    def close(self, error: BaseException | None) -> None:
        if self._writer is None:
            if error is None:
                raise SourceError(EMPTY)
        elif not isinstance(error, OSError):
            # A full disk leaves .NAME.partial, which `repair` can finish.
            self._writer.__exit__(None if error is None else type(error), error, None)


class _Pictures:
    """color/, depth/, camera_intrinsic.json, timestamps_s.txt."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._unit_mm: float | None = None
        self._camera: Camera | None = None
        self._times_s: list[float] = []
        (folder / "depth").mkdir()
        self._begin()

    def _begin(self) -> None:
        (self._folder / "color").mkdir()

    def _write_color(self, recorded: RecordedFrame, name: str) -> None:
        write_color(self._folder / "color" / f"{name}.png", recorded.frame.color, effort=PNG_FAST)

    def write(self, recorded: RecordedFrame, *, calibration: str | None = None) -> int:
        del calibration
        frame, index = recorded.frame, len(self._times_s)
        self._camera = _same_camera(self._camera, frame.camera)
        self._unit_mm = self._unit_mm or exact_unit_mm(recorded)
        require_exact(recorded, self._unit_mm * METRES_PER_MM)
        self._write_color(recorded, f"{index:06d}")
        depth_path = self._folder / "depth" / f"{index:06d}.png"
        write_depth(depth_path, frame.depth_m, metres_per_unit=self._unit_mm * METRES_PER_MM, effort=PNG_FAST)
        self._times_s.append(frame.timestamp_s)
        return index

    def close(self) -> None:
        if self._camera is None:
            raise SourceError(EMPTY)
        document = _intrinsics(self._camera) | {"depth_scale": self._unit_mm}
        (self._folder / INTRINSICS_FILE).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        lines = "".join(f"{time_s!r}\n" for time_s in self._times_s)
        (self._folder / TIMES_FILE).write_text(lines, encoding="utf-8")


class _Video(_Pictures):
    """The same with color.mkv for color/."""

    def _begin(self) -> None:
        self._video: VideoWriter | None = None

    def _write_color(self, recorded: RecordedFrame, name: str) -> None:
        del name
        camera = recorded.frame.camera
        if self._video is None:
            self._video = VideoWriter(self._folder / VIDEO_NAMES[0], width=camera.width, height=camera.height)
        self._video.write(recorded.frame.color)

    def close(self) -> None:
        if self._video is not None:
            self._video.close()
        super().close()


class _Tum:
    """rgb/, depth/, rgb.txt, depth.txt, camera_intrinsic.json."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._camera: Camera | None = None
        self._lines: dict[str, list[str]] = {"rgb": [], "depth": []}
        for name in self._lines:
            (folder / name).mkdir()

    def write(self, recorded: RecordedFrame, *, calibration: str | None = None) -> int:
        del calibration
        frame, index = recorded.frame, len(self._lines["rgb"])
        self._camera = _same_camera(self._camera, frame.camera)
        require_exact(recorded, TUM_METRES_PER_UNIT)
        name = f"{index:06d}.png"
        write_color(self._folder / "rgb" / name, frame.color, effort=PNG_FAST)
        write_depth(self._folder / "depth" / name, frame.depth_m, metres_per_unit=TUM_METRES_PER_UNIT, effort=PNG_FAST)
        self._lines["rgb"].append(f"{frame.timestamp_s:.9f} rgb/{name}\n")
        self._lines["depth"].append(f"{frame.timestamp_s + frame.skew_s:.9f} depth/{name}\n")
        return index

    def close(self) -> None:
        if self._camera is None:
            raise SourceError(EMPTY)
        for name, lines in self._lines.items():
            text = "# timestamp filename\n" + "".join(lines)
            (self._folder / f"{name}.txt").write_text(text, encoding="utf-8")
        text = json.dumps(_intrinsics(self._camera), indent=1) + "\n"
        (self._folder / INTRINSICS_FILE).write_text(text, encoding="utf-8")


class _Bag:
    """A ROS 2 bag's folder, by rosbags."""

    def __init__(self, folder: Path, kind: str, category: str | None, part_names: tuple[str, ...]) -> None:
        self._typestore = typestore()
        from rosbags.rosbag2 import StoragePlugin, Writer

        plugin = StoragePlugin.MCAP if kind == "ros2-mcap" else StoragePlugin.SQLITE3
        self._writer = Writer(folder, version=9, storage_plugin=plugin)
        self._writer.open()
        self._connections: dict[str, Any] = {}
        self._category, self._part_names = category, part_names
        self._frames = 0

    def write(self, recorded: RecordedFrame, *, calibration: str | None = None) -> int:
        messages = list(messages_of(recorded, category=self._category, part_names=self._part_names))
        if calibration is not None and CALIBRATION_TOPIC not in self._connections:
            messages.append(text_message(CALIBRATION_TOPIC, messages[0].time_ns, calibration))
        for message in messages:
            if message.topic not in self._connections:
                self._connections[message.topic] = self._writer.add_connection(
                    message.topic, message.kind, typestore=self._typestore
                )
            self._writer.write(self._connections[message.topic], message.time_ns, message.data)
        self._frames += 1
        return self._frames - 1

    def close(self) -> None:
        self._writer.close()
        if not self._frames:
            raise SourceError(EMPTY)


def exact_unit_mm(recorded: RecordedFrame) -> float:
    """The largest usual depth unit, mm, in which every reading of the frame is a whole number."""
    for unit_mm in DEPTH_UNITS_MM:
        if exact_units(recorded.frame.depth_m, metres_per_unit=unit_mm * METRES_PER_MM) is not None:
            return unit_mm
    return DEPTH_UNITS_MM[-1]


def require_exact(recorded: RecordedFrame, metres_per_unit: float) -> None:
    """SourceError when whole units would change a reading of the frame."""
    if exact_units(recorded.frame.depth_m, metres_per_unit=metres_per_unit) is None:
        raise SourceError(
            f"frame {recorded.frame.index}: its depth is not in whole units of {metres_per_unit * 1e3:g} mm or reaches "
            "beyond 65535 of them, and would be changed; write an .mcap, which keeps metres as they are"
        )


def _same_camera(known: Camera | None, camera: Camera) -> Camera:
    if known is not None and (
        not np.array_equal(known.K, camera.K) or (known.width, known.height) != (camera.width, camera.height)
    ):
        raise SourceError("the camera changes between frames, which this layout cannot say; write an .mcap")
    return camera


def _intrinsics(camera: Camera) -> dict[str, Any]:
    return {"width": camera.width, "height": camera.height, "intrinsic_matrix": camera.K.T.ravel().tolist()}


def copy_frames(frames: Iterable[RecordedFrame], writer: FrameWriter, *, calibration: str | None = None) -> int:
    """Write every frame; returns how many."""
    count = 0
    for recorded in frames:
        writer.write(recorded, calibration=calibration)
        count += 1
    return count
