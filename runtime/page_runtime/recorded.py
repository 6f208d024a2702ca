"""What playback yields, whatever the format on disk: frames, and what is known of the objects in them.

Every format is read into the same Source, a list of paths and facts; pixels are read when a frame is asked for. The
facts are small, so a source is checked whole before its first frame is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.capture.counts import FrameCounts, whole
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array, require_rigid
from page_runtime.image_files import SourceError, read_color, read_depth, read_header, require_depth_header
from page_runtime.sampling import Region, check_region

# A whole frame's principal point lies near its middle. K of half or twice the resolution puts it at a quarter or at
# the border, and nothing else in a recording gives such a K away.
PRINCIPAL_POINT_SHARES = (0.3, 0.7)


@dataclass(frozen=True, eq=False, slots=True)
class PartTruth:
    """The true pose of one part.

    T_camera_part: (4,4), canonical part frame, metres. extents_m: (3,) full size of its box along the part's axes.
    visible_share: visible pixels over those of its silhouette if nothing hid it, None where nobody measured it.
    joint_state: rad or m of the joint that moves this part against its parent, None for the root.
    """

    name: str
    T_camera_part: Array
    extents_m: Array
    visible_share: float | None = None
    joint_state: float | None = None

    def __post_init__(self) -> None:
        extents = np.asarray(self.extents_m, dtype=float)
        if extents.shape != (3,) or not np.isfinite(extents).all() or not (extents > 0).all():
            raise ValueError(f"PartTruth {self.name!r}.extents_m: expected three positive metres, got {extents}")
        object.__setattr__(self, "extents_m", extents)
        T_camera_part = require_rigid(self.T_camera_part, name=f"PartTruth {self.name!r}.T_camera_part")
        object.__setattr__(self, "T_camera_part", T_camera_part)


@dataclass(frozen=True, eq=False, slots=True)
class Instance:
    """One object in a frame. region: (x,y,w,h) px around what is visible of it, None where unknown. truths: in the
    category's order, None where unknown."""

    region: Region | None
    truths: tuple[PartTruth, ...] | None = None


@dataclass(frozen=True, eq=False, slots=True)
class RecordedFrame:
    """A frame and the objects known to be in it; no instance: nothing is known of this frame."""

    frame: RgbdFrame
    instances: tuple[Instance, ...] = ()


class FrameSource(Protocol):
    """What every source of frames is, live or recorded.

    Iterating gives frames with depth registered to colour, in order. A recorded source gives every frame, the same ones
    each time; a live source gives the newest, once. format: in words. category, part_names: None where the source does
    not say. counts: what became of the readings so far. calibration: what the camera says of itself, JSON text.
    """

    @property
    def format(self) -> str: ...
    @property
    def category(self) -> str | None: ...
    @property
    def part_names(self) -> tuple[str, ...] | None: ...
    @property
    def counts(self) -> FrameCounts: ...
    @property
    def calibration(self) -> str | None: ...

    def __iter__(self) -> Iterator[RecordedFrame]: ...


# color (H,W,3) uint8 RGB and depth_m (H,W) float32.
Pixels = tuple[NDArray[np.uint8], NDArray[np.float32]]


@dataclass(frozen=True, eq=False, slots=True)
class FrameEntry:
    """A frame on disk. color_path, depth_path: its pictures, or the file they are in. metres_per_unit: of its depth
    picture. index: the number results are reported under. decode: reads the pixels where they are not two pictures."""

    color_path: Path
    depth_path: Path
    metres_per_unit: float
    camera: Camera
    instances: tuple[Instance, ...] = ()
    timestamp_s: float = 0.0
    index: int = 0
    skew_s: float = 0.0
    decode: Callable[[], Pixels] | None = None

    def read(self) -> RecordedFrame:
        """Decode the pictures; SourceError when one cannot be read."""
        if self.decode is not None:
            color, depth_m = self.decode()
        else:
            color = read_color(self.color_path)
            depth_m = read_depth(self.depth_path, metres_per_unit=self.metres_per_unit)
        try:
            frame = RgbdFrame(color, depth_m, self.camera, self.timestamp_s, self.index, self.skew_s)
        except ValueError as error:
            raise SourceError(f"{self.color_path}: {error}") from error
        return RecordedFrame(frame, self.instances)


@dataclass(frozen=True, eq=False, slots=True)
class Source:
    """Recorded frames in order. format: in words. category, part_names: None where the format does not say. pairing:
    what became of the readings, where the format stores readings and not frames. calibration: of the camera, where it
    was recorded."""

    path: Path
    format: str
    entries: tuple[FrameEntry, ...]
    category: str | None = None
    part_names: tuple[str, ...] | None = None
    pairing: FrameCounts | None = None
    calibration: str | None = None

    def __len__(self) -> int:
        return len(self.entries)

    def __iter__(self) -> Iterator[RecordedFrame]:
        """Frames one by one; only the one in use is in memory."""
        return (entry.read() for entry in self.entries)

    @property
    def counts(self) -> FrameCounts:
        """What became of the readings: known before the first frame is read."""
        return self.pairing or whole(len(self.entries))

    def with_region(self, region: Region) -> Source:
        """The same frames with one object in each, there, whatever the source says of its objects."""
        return replace(self, entries=tuple(replace(entry, instances=(Instance(region),)) for entry in self.entries))

    @property
    def has_regions(self) -> bool:
        """Whether any frame says where an object is."""
        return any(instance.region is not None for entry in self.entries for instance in entry.instances)

    @property
    def has_truth(self) -> bool:
        """Whether any frame has true poses."""
        return any(instance.truths for entry in self.entries for instance in entry.instances)


def camera_of_picture(
    K: object, color_path: Path, *, where: str, declared_size: tuple[int, int] | None = None
) -> Camera:
    """The camera of a whole frame: K (3,3) or nine numbers row by row, the size from the picture's header.

    declared_size: (width, height) the calibration says it is for. Raises SourceError when they cannot belong together.
    """
    header = read_header(color_path)
    size = header.width, header.height
    if declared_size is not None and declared_size != size:
        raise SourceError(
            f"{where}: K is for {declared_size[0]}x{declared_size[1]} but {color_path.name} is {size[0]}x{size[1]}; "
            "give the intrinsics of the recorded resolution"
        )
    try:
        camera = Camera(np.asarray(K, dtype=float).reshape(3, 3), *size)
    except (TypeError, ValueError) as error:
        raise SourceError(f"{where}: {error}") from error
    require_central(camera, where=where)
    return camera


def require_central(camera: Camera, *, where: str) -> None:
    """Raise SourceError when the principal point says that K is of another resolution, or of a crop."""
    cx, cy = camera.K[0, 2], camera.K[1, 2]
    low, high = PRINCIPAL_POINT_SHARES
    if not (low <= cx / camera.width <= high and low <= cy / camera.height <= high):
        raise SourceError(
            f"{where}: K does not match the image size: its principal point ({cx:.1f}, {cy:.1f}) px is not near the "
            f"middle of the {camera.width}x{camera.height} picture; give the intrinsics of the recorded resolution"
        )


Refuse = Callable[[SourceError], None]


def refuse(error: SourceError) -> None:
    """What becomes of a frame that cannot be played: the whole source is refused. Others may note it and go on."""
    raise error


def require_playable(source: Source, on_problem: Refuse = refuse) -> Source:
    """`source` without the frames that cannot be played: no depth picture, sizes that differ, a region outside.

    on_problem hears of each of them, by default raising its SourceError. A source without frames is always one.
    """
    if not source.entries:
        raise SourceError(f"{source.path}: no frames in this {source.format}")
    entries = []
    for entry in source.entries:
        try:
            _require_playable_entry(source, entry)
        except SourceError as error:
            on_problem(error)
        else:
            entries.append(entry)
    return source if len(entries) == len(source.entries) else replace(source, entries=tuple(entries))


def _require_playable_entry(source: Source, entry: FrameEntry) -> None:
    if entry.decode is None:
        _require_depth_picture(entry)
    for instance in entry.instances:
        if instance.region is None:
            continue
        try:
            check_region(instance.region, entry.camera.width, entry.camera.height)
        except ValueError as error:
            raise SourceError(f"{source.path}, frame {entry.index}: {error}") from error


def _require_depth_picture(entry: FrameEntry) -> None:
    depth = require_depth_header(entry.depth_path)
    if (depth.width, depth.height) != (entry.camera.width, entry.camera.height):
        raise SourceError(
            f"{entry.depth_path}: depth is {depth.width}x{depth.height} but {entry.color_path.name} is "
            f"{entry.camera.width}x{entry.camera.height}; register depth to colour first"
        )
    if not (np.isfinite(entry.metres_per_unit) and entry.metres_per_unit > 0):
        scale_mm = entry.metres_per_unit * 1e3
        raise SourceError(f"{entry.depth_path}: expected a positive depth scale, got {scale_mm} mm a unit")
