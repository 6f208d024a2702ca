"""Frames from any source into any format that can be written; the target's name or `layout` says which.

Every format keeps colour, depth, time and camera to the last bit (TUM and folders: depth in the largest unit that is
exact), or refuses. Only the project's recording and its MCAP keep objects and true poses.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from page_runtime.capture.documents import METRES_PER_MM
from page_runtime.capture.mcap_recording import SUFFIX, McapRecordingWriter
from page_runtime.capture.picture_folders import (
    EMPTY,
    PictureFolder,
    TumFolder,
    VideoFolder,
    exact_unit_mm,
    require_exact,
)
from page_runtime.capture.ros_messages import CALIBRATION_TOPIC, messages_of, text_message, typestore
from page_runtime.image_files import PNG_FAST, SourceError
from page_runtime.recorded import RecordedFrame
from page_runtime.recording import RecordingWriter

LEAST_STEP_S = 1e-6


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
        kinds = {"tum": TumFolder, "pictures": PictureFolder, "video": VideoFolder}
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


def copy_frames(frames: Iterable[RecordedFrame], writer: FrameWriter, *, calibration: str | None = None) -> int:
    """Write every frame; returns how many."""
    count = 0
    for recorded in frames:
        writer.write(recorded, calibration=calibration)
        count += 1
    return count
