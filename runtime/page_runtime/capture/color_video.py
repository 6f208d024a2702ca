"""A folder with a colour video, color.mkv (or .avi, .mp4, .mov), and a 16-bit depth picture for each of its frames.

depth/ holds one PNG for each frame of the video, in order of their names; camera_intrinsic.json is that of plain
folders. timestamps_s.txt, one time a line, is used where it is there; otherwise frames are 1 / fps apart. Huffyuv and
FFV1 keep every value of the colour; H.264 does not. Depth never belongs into a video: 16 bits do not survive.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.capture.color_depth import INTRINSICS_FILE, depth_unit, folder_intrinsics
from page_runtime.capture.documents import frame_times, pictures, require_folder
from page_runtime.image_files import SourceError, read_depth
from page_runtime.recorded import FrameEntry, Pixels, Source, require_central, require_playable

FORMAT = "colour video and depth pictures"
VIDEO_NAMES = tuple(f"color{suffix}" for suffix in (".mkv", ".avi", ".mp4", ".mov"))
# FFV1 is a fifth smaller, and takes twice the time to read and eight times to write.
LOSSLESS_CODEC = "HFYU"


def color_video(path: Path) -> Path | None:
    """The folder's video."""
    return next((path / name for name in VIDEO_NAMES if (path / name).is_file()), None)


def read_color_video(path: Path) -> Source:
    """The folder as a source, without truths."""
    file = color_video(path)
    if file is None:
        raise SourceError(f"{path}: expected one of {', '.join(VIDEO_NAMES)}")
    depth = list(pictures(require_folder(path / "depth", holding="a 16-bit depth picture for each frame")).values())
    video = Video(file)
    frames, fps = video.count(), video.fps
    if frames != len(depth):
        raise SourceError(
            f"{path}: {file.name} has {frames} frames, but depth/ {len(depth)} pictures; expected one for each frame"
        )
    K, size = folder_intrinsics(path)
    if size != (video.width, video.height):
        raise SourceError(
            f"{path / INTRINSICS_FILE}: K is for {size[0]}x{size[1]} but {file.name} is {video.width}x{video.height}; "
            "give the intrinsics of the recorded resolution"
        )
    try:
        camera = Camera(np.array(K), *size)
    except ValueError as error:
        raise SourceError(f"{path / INTRINSICS_FILE}: {error}") from error
    require_central(camera, where=str(path / INTRINSICS_FILE))
    metres_per_unit = depth_unit(path)
    times_s = frame_times(path, frames) or [index / fps for index in range(frames)]
    entries = tuple(
        FrameEntry(
            color_path=file,
            depth_path=depth_path,
            metres_per_unit=metres_per_unit,
            camera=camera,
            timestamp_s=time_s,
            index=index,
            decode=partial(_decode, video, index, depth_path, metres_per_unit),
        )
        for index, (depth_path, time_s) in enumerate(zip(depth, times_s, strict=True))
    )
    return require_playable(Source(path, FORMAT, entries))


def _decode(video: Video, index: int, depth_path: Path, metres_per_unit: float) -> Pixels:
    return video.frame(index), read_depth(depth_path, metres_per_unit=metres_per_unit)


class Video:
    """Frames of a video file, by number; reading them in order decodes each once."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._open()
        self.width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        self.fps = float(self._capture.get(cv2.CAP_PROP_FPS)) or 30.0

    def _open(self) -> None:
        self._capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            raise SourceError(f"{self.path}: not a video that can be decoded; copy or record it again")
        self._next = 0

    def count(self) -> int:
        """How many frames can be decoded: what containers say of themselves is not always true."""
        frames = 0
        while self._capture.grab():
            frames += 1
        self._open()
        return frames

    def frame(self, index: int) -> NDArray[np.uint8]:
        """(H,W,3) uint8 RGB. Seeking is by decoding from the start: key frames make other ways inexact."""
        if index < self._next:
            self._open()
        while self._next < index and self._capture.grab():
            self._next += 1
        read, pixels = self._capture.read()
        if not read or self._next != index:
            raise SourceError(f"{self.path}: frame {index} cannot be decoded; copy or record it again")
        self._next = index + 1
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)


class VideoWriter:
    """Frames into a video that keeps every value. SourceError for an odd size, of which OpenCV drops the last row or
    column."""

    def __init__(self, path: Path, *, width: int, height: int, fps: float = 30.0) -> None:
        if width % 2 or height % 2:
            raise SourceError(
                f"{path}: expected an even width and height for a video, got {width}x{height}; write pictures or an "
                ".mcap instead"
            )
        self._writer = cv2.VideoWriter(
            str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*LOSSLESS_CODEC), fps, (width, height)
        )
        if not self._writer.isOpened():
            raise OSError(f"{path}: this OpenCV cannot write {LOSSLESS_CODEC} video")

    def write(self, color: NDArray[np.uint8]) -> None:
        """Append (H,W,3) uint8 RGB."""
        self._writer.write(cv2.cvtColor(color, cv2.COLOR_RGB2BGR))

    def close(self) -> None:
        """Finish the file."""
        self._writer.release()
