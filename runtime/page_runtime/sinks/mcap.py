"""Frames and results in one MCAP file: a recording as `page-runtime record` writes, with TF and markers beside it."""

from __future__ import annotations

from pathlib import Path

from page_runtime.capture.mcap_recording import McapRecordingWriter
from page_runtime.capture.ros_results import result_messages
from page_runtime.category import Category
from page_runtime.live.result import LiveResult
from page_runtime.recorded import Instance, RecordedFrame


class McapSink:
    """Into the new file `path`. category: of the objects, for whoever plays the file as a recording."""

    def __init__(self, path: Path, *, category: Category | None = None, calibration: str | None = None) -> None:
        """FileExistsError when the file is there already, SourceError without the extra `ros`."""
        names = () if category is None else tuple(part.name for part in category.parts)
        self._writer = McapRecordingWriter(path, category=None if category is None else category.name, part_names=names)
        self._calibration, self._name = calibration, f"mcap {path}"

    @property
    def name(self) -> str:
        return self._name

    def write(self, result: LiveResult) -> None:
        """Append the frame, the regions the objects were found in, and the result."""
        recorded = RecordedFrame(result.frame, tuple(Instance(found.region) for found in result.objects))
        self._writer.write(recorded, calibration=self._calibration, beside=result_messages(result))

    def close(self) -> None:
        """Write the index."""
        self._writer.close()
