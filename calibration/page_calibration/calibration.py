"""What a calibration is: cameras, each with K, lens, place and the names of its frames, and where that came from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from page_runtime.camera import Camera
from page_runtime.geometry import Array, invert
from page_runtime.lens import RawCamera


class CalibrationError(ValueError):
    """What was given as a calibration, or to calibrate with, cannot be used; the message says why."""


@dataclass(frozen=True, eq=False, slots=True)
class Deviations:
    """Standard deviations of what was estimated; None: not estimated here.

    intrinsics_px: (4,) of fx, fy, cx, cy. distortion: (n,), as many as coefficients. rotation_rad, translation_m: (3,)
    of T_camera_world, in the camera's axes.
    """

    intrinsics_px: Array | None = None
    distortion: Array | None = None
    rotation_rad: Array | None = None
    translation_m: Array | None = None


@dataclass(frozen=True, eq=False, slots=True)
class CalibratedCamera:
    """One camera of a calibration.

    frame: its name. world_frame: the frame that raw.camera.T_camera_world maps from; a camera that nothing is known
    about the place of has its own frame there, and the identity. depth_unit_m: metres of one unit of its depth
    pictures, None where it has none or nothing is said.
    """

    frame: str
    world_frame: str
    raw: RawCamera
    depth_unit_m: float | None = None
    deviations: Deviations | None = None

    @property
    def camera(self) -> Camera:
        """The pinhole, without the lens."""
        return self.raw.camera


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a calibration came from. format, source: what was read, or how it was made. notes: what the source says
    that has no place here. warnings: what looks wrong but may be right."""

    format: str
    source: str
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class Calibration:
    """Cameras with different names, and their provenance."""

    cameras: tuple[CalibratedCamera, ...]
    provenance: Provenance

    def __post_init__(self) -> None:
        frames = [camera.frame for camera in self.cameras]
        if not frames or len(set(frames)) != len(frames) or not all(frames):
            raise CalibrationError(f"Calibration: expected cameras with different names, got {frames}")

    def __iter__(self) -> Iterator[CalibratedCamera]:
        return iter(self.cameras)

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def frames(self) -> tuple[str, ...]:
        """The cameras' names."""
        return tuple(camera.frame for camera in self.cameras)

    def __getitem__(self, frame: str) -> CalibratedCamera:
        for camera in self.cameras:
            if camera.frame == frame:
                return camera
        raise CalibrationError(f"no camera {frame!r} in this calibration; it has {', '.join(self.frames)}")

    def only(self, frame: str) -> Calibration:
        """This calibration with one camera."""
        return replace(self, cameras=(self[frame],))

    def transform(self, to: str, of: str) -> Array:
        """T_to_of (4,4), metres, between two cameras of one world."""
        a, b = self[to], self[of]
        if a.world_frame != b.world_frame:
            raise CalibrationError(
                f"nothing says where {to!r} and {of!r} are to each other: the one is placed in {a.world_frame!r}, the "
                f"other in {b.world_frame!r}; calibrate them together (page-calibrate stereo)"
            )
        return a.camera.T_camera_world @ invert(b.camera.T_camera_world)


def baseline_m(T_a_b: Array) -> float:
    """Distance between the origins of two frames."""
    return float(np.linalg.norm(T_a_b[:3, 3]))
