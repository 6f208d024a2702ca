"""Raw colour and raw depth of two cameras -> one RgbdFrame: colour undistorted, depth registered to it.

OpenCV's registerDepth sends every depth pixel to the nearest colour pixel and keeps the nearest surface. That decides
what is visible; both roundings, half a pixel of each camera, stay in the depth and cost millimetres on slanted
surfaces. So each registered pixel is then read where its ray really meets the depth picture, between four readings of
one surface. 1/z is linear there on a plane, so planes are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array, invert
from page_runtime.lens import FixedMap, RawCamera, fixed_map, sampled

# Four readings are one surface when their 1/z differ by less than this share: 45 degrees at f = 300 px is 0.5 %, two
# surfaces of an object stand farther apart.
SAME_SURFACE = 0.02
# Below it a sensor has no reading.
NO_READING_M = np.float32(1e-6)
# A third look moves no depth by more than float32 rounding.
LOOKS = 2
# Rows registered at once: 24 to 60 rows of 640 pixels take a sixth less time than a whole picture.
BAND_ROWS = 40


@dataclass(frozen=True, eq=False, slots=True)
class Registration:
    """Everything about a pair of cameras that does not change from frame to frame.

    depth, color: the raw cameras. camera: the pinhole of registered pictures, color's K and place. color_map: raw
    colour pixel of each registered one. depth_map: (h,w,2) float32, raw depth pixel of each pixel of the undistorted
    depth picture. pixel_rays: (3,H,W) float32, direction of each registered pixel's ray in homogeneous pixels of the
    undistorted depth picture.
    """

    depth: RawCamera
    color: RawCamera
    camera: Camera
    color_map: FixedMap
    depth_map: NDArray[np.float32]
    pixel_rays: NDArray[np.float32]

    @property
    def T_color_depth(self) -> Array:
        """(4,4), metres, from the depth camera's frame to the colour camera's."""
        return self.color.camera.T_camera_world @ invert(self.depth.camera.T_camera_world)


def registration_between(depth: RawCamera, color: RawCamera) -> Registration:
    """The registration of `depth` to `color`, whose T_camera_world are of the same world."""
    camera = color.camera
    rows, columns = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays(np.stack([columns, rows], axis=-1).astype(float))
    R_depth_color = depth.camera.T_camera_world[:3, :3] @ camera.T_camera_world[:3, :3].T
    return Registration(
        depth=depth,
        color=color,
        camera=camera,
        color_map=fixed_map(color.pixel_map(camera)),
        depth_map=depth.pixel_map(depth.camera),
        pixel_rays=np.ascontiguousarray(
            np.moveaxis(rays @ (depth.camera.K @ R_depth_color).T, -1, 0), dtype=np.float32
        ),
    )


def register_depth(registration: Registration, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H,W) float32 metres, z-depth of each pixel of registration.camera, 0 = no reading.

    depth_m: (h,w) float32 metres as the depth camera delivers it, 0 = no reading. ValueError for another size or type.
    """
    _require_picture(depth_m, registration.depth.camera, np.float32, "depth_m")
    nearest = (
        depth_m if registration.depth.distortion.is_none else sampled(depth_m, registration.depth_map, nearest=True)
    )
    camera = registration.camera
    registered = cv2.registerDepth(
        registration.depth.camera.K,
        camera.K,
        np.zeros(4),
        registration.T_color_depth,
        nearest,
        (camera.width, camera.height),
        depthDilation=True,
    )
    return _between_readings(registration, depth_m, np.asarray(cv2.patchNaNs(registered, 0.0), dtype=np.float32))


def _between_readings(
    registration: Registration, depth_m: NDArray[np.float32], z: NDArray[np.float32]
) -> NDArray[np.float32]:
    """`z` with the roundings taken out, where four readings of one surface surround the ray."""
    inverse = np.asarray(np.float32(1) / np.maximum(depth_m, NO_READING_M), np.float32)
    cell = np.ones((2, 2), np.uint8)
    low = cv2.erode(inverse, cell, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT, borderValue=0.0)
    high = cv2.dilate(inverse, cell, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT, borderValue=np.inf)
    # Four pixels without a reading are one surface too, so near that no ray's depth agrees with it.
    one_surface = np.asarray(cv2.compare(low, high * np.float32(1 - SAME_SURFACE), cv2.CMP_GE), np.uint8)
    depth_map = None if registration.depth.distortion.is_none else registration.depth_map
    T_color_depth = registration.T_color_depth
    origin = (registration.depth.camera.K @ invert(T_color_depth)[:3, 3]).astype(np.float32)
    shift = np.float32(T_color_depth[2, 3])
    registered = np.empty_like(z)
    with np.errstate(divide="ignore", invalid="ignore"):
        for first in range(0, len(z), BAND_ROWS):
            band = slice(first, first + BAND_ROWS)
            rays = registration.pixel_rays[:, band]
            registered[band] = _band_between(z[band], rays, origin, shift, depth_map, inverse, one_surface)
    return registered


def _band_between(
    z: NDArray[np.float32],
    rays: NDArray[np.float32],
    origin: NDArray[np.float32],
    shift: np.float32,
    depth_map: NDArray[np.float32] | None,
    inverse: NDArray[np.float32],
    one_surface: NDArray[np.uint8],
) -> NDArray[np.float32]:
    """`_between_readings` of some rows, few enough that a core's cache holds what is computed of them.

    z (h,W); rays (3,h,W) and origin (3,), colour's place, in homogeneous pixels of the undistorted depth picture;
    shift: the depth camera's place along colour's axis.
    """
    (ray_x, ray_y, ray_z), (x0, y0, z0) = rays, origin
    # Without a reading the ray's point is the depth camera's own place, as far as that: nowhere in its picture.
    found, allowed = z.copy(), np.float32(SAME_SURFACE) * z
    for _ in range(LOOKS):
        scale = found * ray_z
        scale += z0
        np.divide(1, scale, out=scale)
        u, v = found * ray_x, found * ray_y
        u += x0
        u *= scale
        v += y0
        v *= scale
        if depth_map is not None:
            pixels = _remapped(depth_map, u, v, outside=-9.0)
            u, v = (np.ascontiguousarray(pixels[..., i]) for i in (0, 1))
        read = _remapped(inverse, u, v)
        # Rounding half a pixel less finds the upper left of the four.
        u -= np.float32(0.5)
        v -= np.float32(0.5)
        inside = cv2.remap(one_surface, u, v, cv2.INTER_NEAREST)
        # A point's depth along colour's axis less the cameras' distance along it goes as its depth along the other's.
        moved = found - shift
        moved *= scale
        moved /= read
        moved += shift
        accepted = cv2.bitwise_and(cv2.compare(cv2.absdiff(moved, z), allowed, cv2.CMP_LE), inside)
        cv2.copyTo(moved, accepted, found)
    return found


def _remapped(
    picture: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32], *, outside: float = 0.0
) -> NDArray[np.float32]:
    value = (outside,) * 4
    read = cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=value)
    return np.asarray(read, np.float32)


def undistort_color(registration: Registration, color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H,W,3) uint8 as registration.camera sees it, black where the raw picture (H,W,3) uint8 does not reach."""
    _require_picture(color, registration.color.camera, np.uint8, "color")
    if registration.color.distortion.is_none:
        return color
    return np.asarray(cv2.remap(color, *registration.color_map, cv2.INTER_LINEAR), np.uint8)


def registered_frame(
    registration: Registration,
    color: NDArray[np.uint8],
    depth_m: NDArray[np.float32],
    *,
    timestamp_s: float = 0.0,
    index: int = 0,
) -> RgbdFrame:
    """The frame of one raw colour picture (H,W,3) uint8 RGB and one raw depth picture (h,w) float32 metres."""
    return RgbdFrame(
        undistort_color(registration, color),
        register_depth(registration, depth_m),
        registration.camera,
        timestamp_s,
        index,
    )


def _require_picture(picture: NDArray[np.generic], camera: Camera, dtype: type, name: str) -> None:
    if picture.shape[:2] != (camera.height, camera.width) or picture.dtype != dtype:
        raise ValueError(
            f"{name}: expected {camera.width}x{camera.height} {np.dtype(dtype).name}, the size its camera is for, got "
            f"{picture.shape[1]}x{picture.shape[0]} {picture.dtype}; use the calibration of this resolution or "
            "RawCamera.resized"
        )
