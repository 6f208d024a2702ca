"""Writing frames as folders of pictures, or a video, beside 16-bit depth: the layouts without a container.

Depth is kept to the last bit in the largest unit that is exact, or refused; so are cameras that change, which none of
these layouts can say.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.camera import Camera
from page_runtime.capture.color_depth import INTRINSICS_FILE
from page_runtime.capture.color_video import VIDEO_NAMES, VideoWriter
from page_runtime.capture.documents import METRES_PER_MM, TIMES_FILE
from page_runtime.capture.ros_messages import exact_units
from page_runtime.capture.tum import METRES_PER_UNIT as TUM_METRES_PER_UNIT
from page_runtime.image_files import PNG_FAST, SourceError, write_color, write_depth
from page_runtime.recorded import RecordedFrame

EMPTY = "nothing to write: the source gave no frames"
# What cameras and data sets count depth in, mm.
DEPTH_UNITS_MM = (1.0, 0.5, 0.25, 0.2, 0.125, 0.1)


class PictureFolder:
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


class VideoFolder(PictureFolder):
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


class TumFolder:
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
