"""Boxes before a wall, seen by two raw cameras: what a rig with a right calibration would record."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from page_runtime.camera import Camera
from page_runtime.geometry import Array, invert, rotation_about, transform_from
from page_runtime.lens import Distortion, RawCamera

T_COLOR_DEPTH = transform_from(rotation_about(np.array([0.3, 1.0, 0.2]), 0.05), np.array([-0.09, 0.008, 0.015]))


def rig() -> tuple[RawCamera, RawCamera]:
    """(depth, color): unequal sizes, lenses, turned."""
    depth = Camera(np.array([[330.0, 0, 242.0], [0, 331.0, 148.0], [0, 0, 1]]), 480, 300)
    color = Camera(np.array([[455.0, 0, 322.0], [0, 456.0, 198.0], [0, 0, 1]]), 640, 400, T_COLOR_DEPTH)
    return (
        RawCamera(depth, Distortion("brown-conrady", np.array([-0.08, 0.03, 0.0004, -0.0006, 0.0]))),
        RawCamera(color, Distortion("brown-conrady", np.array([0.07, -0.12, 0.0006, 0.0003, 0.02]))),
    )


def random_room(rng: np.random.Generator, boxes: int = 14) -> list[tuple[Array, Array, Array]]:
    """(T_world_box, half sizes, colours of its six sides) of each box; the world is the depth camera's frame."""
    room = []
    for _ in range(boxes):
        z = rng.uniform(0.6, 2.0)
        place = np.array([rng.uniform(-0.7, 0.7) * z, rng.uniform(-0.42, 0.42) * z, z])
        T = transform_from(rotation_about(rng.normal(size=3), rng.uniform(0, 3.0)), place)
        room.append((T, rng.uniform(0.04, 0.16, 3), rng.uniform(30, 225, (6, 3))))
    return room


def look(
    room: Sequence[tuple[Array, Array, Array]], raw: RawCamera, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(color (H,W,3) uint8, depth_m (H,W) float32) as `raw` sees the room; a soft pattern is on everything."""
    height, width = raw.camera.height, raw.camera.width
    rows, columns = np.mgrid[:height, :width]
    rays = raw.rays(np.stack([columns, rows], axis=-1).astype(float))
    T_world_camera = invert(raw.camera.T_camera_world)
    directions, origin = rays @ T_world_camera[:3, :3].T, T_world_camera[:3, 3]
    depth = (2.6 - origin[2]) / directions[..., 2]
    hit = origin + depth[..., None] * directions
    color = 120 + 25 * np.sin(9 * hit[..., :1]) * np.cos(7 * hit[..., 1:2]) * np.ones(3)
    for T_world_box, half, sides in room:
        T = invert(T_world_box)
        start, direction = T[:3, :3] @ origin + T[:3, 3], directions @ T[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (-half - start) / direction, (half - start) / direction
        near, far = np.minimum(a, b), np.maximum(a, b)
        enter = near.max(axis=-1)
        seen = (enter < far.min(axis=-1)) & (enter > 0) & (enter < depth)
        axis = near.argmax(axis=-1)
        side = 2 * axis + (np.take_along_axis(direction, axis[..., None], axis=-1)[..., 0] > 0)
        depth = np.where(seen, enter, depth)
        color = np.where(seen[..., None], sides[side], color)
    noisy = np.clip(color + rng.normal(0, 3.0, color.shape), 0, 255).astype(np.uint8)
    measured = np.round(depth * 1e3) * 1e-3 * (rng.random(depth.shape) > 0.02)
    return noisy, measured.astype(np.float32)
