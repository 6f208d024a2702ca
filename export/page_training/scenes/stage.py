"""Where an object stands: support, room, clutter, occluders, lights and viewpoint.

World frame: metres, +z up, the object's support at z = 0, the object near the origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_runtime.geometry import Array, rotation_about, transform_from
from page_training.scenes.materials import Material, hsv_color, patterned, plain, printed, random_color
from page_training.scenes.meshes import (
    Mesh,
    ball,
    cuboid,
    moved,
    plate,
    rectangle,
    revolved,
    rounded_rectangle,
    shifted,
)
from page_training.scenes.render import Light, Lighting
from page_training.scenes.textures import Generator

Z_AXIS = np.array([0.0, 0.0, 1.0])
ROOM_M = 12.0
# From up to here rooms of any size will do.
MOST_VIEW_M = 1.8


@dataclass(frozen=True, eq=False, slots=True)
class Viewpoint:
    """T_camera_world: (4,4). azimuth_rad: where the camera stands about +z. distance_m: to the object."""

    T_camera_world: Array
    azimuth_rad: float
    distance_m: float


@dataclass(frozen=True, eq=False, slots=True)
class Footprint:
    """Where the object already stands: yaw of its frame in the world, rad; low, high: (2,) its extent in
    that frame."""

    yaw_rad: float
    low: Array
    high: Array


def upright(yaw_rad: float, x: float, y: float, z: float) -> Array:
    """T_world_thing (4,4) of a thing standing at (x,y,z) turned by `yaw_rad`."""
    return transform_from(rotation_about(Z_AXIS, yaw_rad), np.array([x, y, z]))


def sample_viewpoint(rng: Generator, target_world: Array, distances_m: tuple[float, float]) -> Viewpoint:
    """A camera anywhere around and above the object, which it sees away from its image centre."""
    azimuth = rng.uniform(0, 2 * np.pi)
    elevation = np.arcsin(rng.uniform(np.sin(np.radians(8)), np.sin(np.radians(80))))
    distance = float(rng.uniform(*distances_m))
    ray = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    eye = target_world + distance * ray
    right = np.cross(-ray, Z_AXIS)
    right /= np.linalg.norm(right)
    forward = -ray
    # The camera looks past the object by up to 18 degrees, as objects are rarely in the middle of a frame.
    down = np.cross(forward, right)
    aside = np.tan(np.radians(rng.normal(0, 8, 2).clip(-18, 18)))
    forward = forward + aside[0] * right + aside[1] * down
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, Z_AXIS)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    roll = np.radians(rng.uniform(-15, 15))
    rotation = rotation_about(Z_AXIS, float(roll)) @ rotation
    return Viewpoint(transform_from(rotation, -rotation @ eye), float(azimuth), distance)


def sample_lighting(rng: Generator) -> Lighting:
    """Ambient light and one or two lamps or windows, of one colour temperature with slight differences."""
    warmth = rng.normal(0, 0.10)
    tint = np.array([1 + warmth, 1 + rng.normal(0, 0.03), 1 - warmth])
    ambient = rng.uniform(0.25, 0.75)
    lights = []
    for index in range(int(rng.integers(1, 3))):
        azimuth, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.35, 1.0)
        flat = np.sqrt(1 - height**2)
        direction = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), height], np.float32)
        color = tint * (1 + rng.normal(0, 0.04, 3)) * (1.05 - ambient) * rng.uniform(0.4, 1.1)
        casts = index == 0 and rng.random() < 0.6
        lights.append(Light(direction, color.astype(np.float32), casts))
    slope = float(rng.uniform(0.0, 0.4))
    return Lighting((tint * ambient).astype(np.float32), slope, tuple(lights), float(rng.uniform(0.0, 0.6)))


def _support_skin(rng: Generator) -> Material:
    draw = rng.random()
    if draw < 0.35:
        return patterned(rng, "wood", float(rng.uniform(0.25, 1.2)))
    if draw < 0.7:  # plain office tables are mostly light
        value = float(rng.uniform(0.55, 1.0) if rng.random() < 0.6 else rng.uniform(0.08, 0.8))
        grey = hsv_color(rng.random(), rng.uniform(0, 0.15), value)
        return plain(rng, grey, contrast=float(rng.uniform(0.01, 0.1)))
    kinds = ["marble", "cloth", "noise", "tiles", "stripes", "speckle", "photo", "grain", "print"]
    return patterned(rng, str(rng.choice(kinds)), float(rng.uniform(0.15, 1.0)))


def _wall_skin(rng: Generator) -> Material:
    if rng.random() < 0.5:
        color = hsv_color(rng.random(), rng.uniform(0, 0.3), rng.uniform(0.3, 1.0))
        return plain(rng, color, contrast=float(rng.uniform(0, 0.1)))
    kinds = ["stripes", "noise", "wood", "tiles", "photo", "print", "cloth"]
    return patterned(rng, str(rng.choice(kinds)), float(rng.uniform(0.3, 2.5)))


def surroundings(rng: Generator, reach_m: float, on_table: float, view_m: float) -> list[Mesh]:
    """Support (table with edges, or the floor), floor and walls; `reach_m`: radius the object needs on the support;
    `on_table`: how often that is a table; `view_m`: how far away a camera may stand, for which most rooms have room."""
    yaw = rng.uniform(0, 2 * np.pi)
    skin = _support_skin(rng)
    meshes: list[Mesh] = []
    floor_z = -0.0005
    if rng.random() < on_table:
        half = rng.uniform([0.35, 0.25], [1.2, 0.6]) + 0.7 * reach_m
        slack = half - 0.7 * reach_m
        middle = rng.uniform(-1, 1, 2) * slack
        thick = float(rng.uniform(0.015, 0.06))
        top = cuboid((2 * half[0], 2 * half[1], thick), skin)
        place = rotation_about(Z_AXIS, yaw) @ np.array([middle[0], middle[1], -thick])
        meshes.append(moved(top, upright(yaw, place[0], place[1], place[2])))
        floor_z = float(-rng.uniform(0.25, 0.8))
    ground = rectangle(ROOM_M, ROOM_M, skin if floor_z > -0.01 else _support_skin(rng))
    ceiling = rectangle(ROOM_M, ROOM_M, _wall_skin(rng))
    meshes += [shifted(ground, 0, 0, floor_z), shifted(ceiling, 0, 0, 2.5)]
    room = max(1.0, view_m / MOST_VIEW_M)
    # Walls lie along the world's axes and are two triangles each: anything slanted and large slows every
    # ray. Some are near, as the panels of a desk; two near ones make a corner.
    for side in range(4):
        away = float(rng.uniform(0.45, 1.2) if rng.random() < 0.25 else room * rng.uniform(1.2, 5.0)) + reach_m
        stand = rotation_about(np.array([1.0, 0.0, 0.0]), np.pi / 2)
        turn = rotation_about(Z_AXIS, side * np.pi / 2)
        wall = rectangle(ROOM_M, 6.0, _wall_skin(rng))
        meshes.append(moved(wall, transform_from(turn @ stand, turn @ np.array([0.0, away, 0.0]))))
    return meshes


def _thing(rng: Generator) -> tuple[Mesh, float]:
    """Some object standing on z = 0 and the radius it needs."""
    skin = (
        plain(rng, random_color(rng)) if rng.random() < 0.6 else patterned(rng, "print", float(rng.uniform(0.05, 0.3)))
    )
    draw = rng.random()
    if draw < 0.3:
        size = rng.uniform([0.03, 0.03, 0.02], [0.22, 0.2, 0.2]).tolist()
        return cuboid(size, skin, bevel=float(rng.uniform(0.0005, 0.01))), float(np.hypot(size[0], size[1]) / 2)
    if draw < 0.5:
        radius, height = rng.uniform(0.02, 0.07), rng.uniform(0.04, 0.25)
        waist = rng.uniform(0.6, 1.1)
        profile = [(radius, 0), (radius * waist, height / 2), (radius * rng.uniform(0.6, 1.1), height)]
        return revolved(profile, skin), float(radius * 1.1)
    if draw < 0.58:
        radius = float(rng.uniform(0.015, 0.08))
        return ball(radius, skin), radius
    if draw < 0.8:  # book, paper, phone
        size = rng.uniform([0.05, 0.08, 0.0005], [0.22, 0.3, 0.04])
        rect = (-size[0] / 2, -size[1] / 2, size[0], size[1])
        cover = printed(rng, random_color(rng), rect, str(rng.choice(["print", "leaflet", "screen"])))
        mesh = plate(rounded_rectangle(size[0], size[1], 0.004, 1), 0, size[2], 0.0004, [skin, skin, skin, skin, cover])
        return mesh, float(np.hypot(size[0], size[1]) / 2)
    if draw < 0.92:  # plate leaning on something unseen
        size = (rng.uniform(0.08, 0.3), rng.uniform(0.002, 0.02), rng.uniform(0.06, 0.25))
        turn = rotation_about(np.array([1.0, 0.0, 0.0]), float(rng.uniform(-1.3, 1.3)))
        return moved(cuboid(size, skin), transform_from(turn, np.zeros(3))), float(size[0] / 2)
    length = float(rng.uniform(0.1, 0.2))
    lie = rotation_about(np.array([0.0, 1.0, 0.0]), np.pi / 2)
    pen = revolved([(0.004, -length / 2), (0.004, length / 2)], skin, 8)
    return moved(pen, transform_from(lie, np.array([0, 0, 0.004]))), length / 2


def beside(rng: Generator, footprint: Footprint, radius_m: float, gap_m: float) -> Array:
    """(2,) a place whose circle of `radius_m` stays `gap_m` away from the footprint (touching if it is 0)."""
    side = int(rng.integers(4))
    low, high = footprint.low - radius_m - gap_m, footprint.high + radius_m + gap_m
    place = rng.uniform(low, high)
    place[side % 2] = low[side % 2] if side < 2 else high[side % 2]
    c, s = np.cos(footprint.yaw_rad), np.sin(footprint.yaw_rad)
    return np.array([c * place[0] - s * place[1], s * place[0] + c * place[1]])


def clutter(rng: Generator, footprint: Footprint) -> list[Mesh]:
    """Things around the object, some touching it."""
    meshes = []
    for _ in range(int(rng.choice([0, 0, 1, 1, 2, 3, 4, 6]))):
        mesh, radius = _thing(rng)
        gap = 0.0 if rng.random() < 0.2 else float(rng.exponential(0.12))
        x, y = beside(rng, footprint, radius * float(rng.uniform(0.7, 1.0)), gap)
        meshes.append(moved(mesh, upright(rng.uniform(0, 2 * np.pi), x, y, 0)))
    return meshes


def occluders(rng: Generator, footprint: Footprint, viewpoint: Viewpoint, target_world: Array) -> list[Mesh]:
    """In a quarter of scenes something between camera and object: a thing on the table, or an arm reaching
    in."""
    if rng.random() > 0.25:
        return []
    toward = np.array([np.cos(viewpoint.azimuth_rad), np.sin(viewpoint.azimuth_rad)])
    if rng.random() < 0.6:
        mesh, radius = _thing(rng)
        near = float(np.linalg.norm((footprint.high - footprint.low) / 2)) + radius
        side = rng.normal(0, 0.06) * np.array([-toward[1], toward[0]])
        place = target_world[:2] + toward * near * float(rng.uniform(0.8, 1.2)) + side
        return [moved(mesh, upright(rng.uniform(0, 2 * np.pi), place[0], place[1], 0))]
    radius = float(rng.uniform(0.012, 0.045))
    skin = plain(rng, hsv_color(rng.uniform(0.02, 0.09), rng.uniform(0.2, 0.7), rng.uniform(0.3, 0.95)))
    if rng.random() < 0.4:
        skin = plain(rng, random_color(rng))
    arm = revolved([(radius * 0.6, 0), (radius, 0.02), (radius * 1.1, 0.5)], skin, 12)
    tilt = rotation_about(np.array([0.0, 1.0, 0.0]), float(rng.uniform(0.5, 1.4)))
    yaw = viewpoint.azimuth_rad + rng.normal(0, 0.8)
    turn = rotation_about(Z_AXIS, float(yaw)) @ tilt
    tip = target_world + np.array([*(toward * rng.uniform(0.0, 0.12)), rng.uniform(0.02, 0.10)])
    tip += rng.normal(0, 0.04, 3)
    return [moved(arm, transform_from(turn, tip))]
