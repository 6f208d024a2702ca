"""Frames into one MCAP file that any ROS 2 tool reads, and that is worth something when the program is killed.

Frames are written in chunks, each whole and with a checksum, and each chunk is handed to the system at once: what a
kill costs is the chunk that was being filled. Where the disk takes no more, the file is cut after its last whole chunk
and left at that. `repair.py` closes such a file. Calibration is inside: a CameraInfo with
every frame, and the camera's own, where it has one, as the attachment calibration.json.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType

from page_runtime.capture.ros_messages import Message, definition, messages_of, typestore
from page_runtime.image_files import SourceError
from page_runtime.recorded import RecordedFrame

CALIBRATION_FILE = "calibration.json"
SUFFIX = ".mcap"
CHUNK_BYTES = 1 << 20


class McapWriter:
    """Messages into an MCAP file of ROS 2's profile; an existing file is never overwritten."""

    def __init__(self, path: Path) -> None:
        try:
            from mcap.writer import CompressionType, Writer
        except ImportError as error:
            raise SourceError("MCAP files need mcap, which is not installed; pip install 'page-edge[ros]'") from error
        typestore()
        self.path = path
        self._file = path.open("xb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4)
        self._writer.start(profile="ros2", library="page-edge")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._numbers: dict[str, int] = {}
        self._whole_bytes = 0
        self._failure: tuple[int | None, str, str] | None = None
        self.flush()

    def __enter__(self) -> McapWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def write(self, message: Message) -> None:
        """Append one message; OSError when the disk takes no more, then and from then on."""
        self._to_disk(lambda: self._write(message))

    def _write(self, message: Message) -> None:
        if message.topic not in self._channels:
            if message.kind not in self._schemas:
                text = definition(message.kind).encode()
                self._schemas[message.kind] = self._writer.register_schema(message.kind, "ros2msg", text)
            self._channels[message.topic] = self._writer.register_channel(
                message.topic, "cdr", self._schemas[message.kind], {"offered_qos_profiles": ""}
            )
        number = self._numbers[message.topic] = self._numbers.get(message.topic, 0) + 1
        self._writer.add_message(
            self._channels[message.topic], message.time_ns, message.data, message.time_ns, sequence=number
        )

    def attach(self, name: str, data: bytes) -> None:
        """Append a file; OSError as `write`."""
        self._to_disk(lambda: self._writer.add_attachment(0, 0, name, "application/json", data))

    def flush(self) -> None:
        """Hand every whole chunk to the system; OSError as `write`."""
        self._to_disk(self._file.flush)
        self._whole_bytes = self._file.tell()

    def close(self) -> None:
        """Write the index and close the file; OSError when that did not go well. Nothing where `write` has failed."""
        if not self._file.closed:
            self._to_disk(self._finish)

    def _finish(self) -> None:
        self._writer.finish()
        self._file.close()

    def _to_disk(self, action: Callable[[], object]) -> None:
        if self._failure is None:
            try:
                action()
            except OSError as error:
                self._abandon(error)
            else:
                return
        assert self._failure is not None
        raise OSError(*self._failure)

    def _abandon(self, error: OSError) -> None:
        """Close the file as a killed process would have left it: whole chunks, no index."""
        self._failure = error.errno, f"{error.strerror}; the file ends after its last whole chunk", str(self.path)
        with contextlib.suppress(OSError):
            # What is still in the buffer fails again here; the descriptor is given back all the same.
            self._file.close()
        with contextlib.suppress(OSError):
            os.truncate(self.path, self._whole_bytes)


class McapRecordingWriter:
    """Frames into an MCAP file. category, part_names: of the objects in it, where they are known."""

    def __init__(self, path: Path, *, category: str | None = None, part_names: tuple[str, ...] = ()) -> None:
        self._writer = McapWriter(path)
        self._category, self._part_names = category, part_names
        self._has_calibration = False
        self.frames = 0

    def __enter__(self) -> McapRecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Write the index and close the file; OSError when that did not go well."""
        self._writer.close()

    def write(self, recorded: RecordedFrame, *, calibration: str | None = None, beside: Iterable[Message] = ()) -> int:
        """Append a frame and return its number; the calibration once, with the first that brings it.

        beside: messages of the same time. They come first, as the depth picture completes a frame.
        """
        if calibration is not None and not self._has_calibration:
            self._writer.attach(CALIBRATION_FILE, calibration.encode())
            self._has_calibration = True
        for message in beside:
            self._writer.write(message)
        for message in messages_of(recorded, category=self._category, part_names=self._part_names):
            self._writer.write(message)
        self._writer.flush()
        self.frames += 1
        return self.frames - 1
