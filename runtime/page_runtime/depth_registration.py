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
from page_runtime.lens import RawCamera, sampled

# Four readings are one surface when their 1/z differ by less than this share: 45 degrees at f = 300 px is 0.5 %, two
# surfaces of an object stand farther apart.
SAME_SURFACE = 0.02
# A third look moves no depth by more than float32 rounding.
LOOKS = 2


@dataclass(frozen=True, eq=False, slots=True)
class Registration:
    """Everything about a pair of cameras that does not change from frame to frame.

    depth, color: the raw cameras. camera: the pinhole of registered pictures, color's K and place. color_map: (H,W,2)
    float32, raw colour pixel of each registered one. depth_map: (h,w,2) float32, raw depth pixel of each pixel of the
    undistorted depth picture. rays_depth: (3,H,W) float32, ray of each registered pixel in the depth camera's frame.
    """

    depth: RawCamera
    color: RawCamera
    camera: Camera
    color_map: NDArray[np.float32]
    depth_map: NDArray[np.float32]
    rays_depth: NDArray[np.float32]

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
        color_map=color.pixel_map(camera),
        depth_map=depth.pixel_map(depth.camera),
        rays_depth=np.ascontiguousarray(np.moveaxis(rays @ R_depth_color.T, -1, 0), dtype=np.float32),
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
        np.where(nearest > 0, nearest, np.nan).astype(np.float32),
        (camera.width, camera.height),
        depthDilation=True,
    )
    z = np.nan_to_num(np.asarray(registered, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    return _between_readings(registration, depth_m, z)


def _between_readings(
    registration: Registration, depth_m: NDArray[np.float32], z: NDArray[np.float32]
) -> NDArray[np.float32]:
    """`z` with the roundings taken out, where four readings of one surface surround the ray."""
    with np.errstate(divide="ignore"):
        inverse = np.where(depth_m > 0, np.float32(1) / depth_m, np.float32(0))
    corners = (inverse[:-1, :-1], inverse[:-1, 1:], inverse[1:, :-1], inverse[1:, 1:])
    low, high = np.minimum.reduce(corners), np.maximum.reduce(corners)
    one_surface = np.zeros(inverse.shape, np.uint8)
    one_surface[:-1, :-1] = (low > 0) & (high - low <= SAME_SURFACE * high)
    raw, K = registration.depth, registration.depth.camera.K.astype(np.float32)
    T_depth_color = invert(registration.T_color_depth).astype(np.float32)
    row = registration.T_color_depth[2].astype(np.float32)
    ray_x, ray_y, ray_z = registration.rays_depth
    x0, y0, z0 = T_depth_color[:3, 3]
    found = z
    for _ in range(LOOKS):
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / (found * ray_z + z0)
            x, y = (found * ray_x + x0) * scale, (found * ray_y + y0) * scale
            u, v = K[0, 0] * x + K[0, 1] * y + K[0, 2], K[1, 1] * y + K[1, 2]
        if not raw.distortion.is_none:
            pixels = sampled(registration.depth_map, np.stack([u, v], axis=-1), outside=-1.0)
            u, v = pixels[..., 0], pixels[..., 1]
        at = np.nan_to_num(np.stack([u, v], axis=-1), nan=-1.0)
        read = sampled(inverse, at)
        inside = sampled(one_surface, np.floor(at), nearest=True) > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            moved = (row[0] * x + row[1] * y + row[2]) / read + row[3]
            accepted = inside & (found > 0) & (np.abs(moved - z) <= SAME_SURFACE * z)
        found = np.where(accepted, moved, found)
    return found


def undistort_color(registration: Registration, color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H,W,3) uint8 as registration.camera sees it, black where the raw picture (H,W,3) uint8 does not reach."""
    _require_picture(color, registration.color.camera, np.uint8, "color")
    if registration.color.distortion.is_none:
        return color
    return sampled(color, registration.color_map)


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
