"""Scenes: an object in its surroundings before a camera.

World frame of a scene: metres, +z up, support at z = 0 (see stage.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.geometry import Array, rotation_about, transform_from
from page_training.scenes.articulated import ArticulatedObject, States
from page_training.scenes.kinds import SceneCategory, scene_category
from page_training.scenes.meshes import Mesh, moved
from page_training.scenes.render import (
    Lighting,
    World,
    labels_seen,
    silhouette,
    silhouette_caster,
    world_from,
)
from page_training.scenes.stage import (
    Footprint,
    beside,
    clutter,
    occluders,
    sample_lighting,
    sample_viewpoint,
    surroundings,
    upright,
)
from page_training.scenes.textures import Generator

CAMERAS = (  # width, height, horizontal focal lengths (px) of common RGB-D cameras
    (640, 480, 380.0, 620.0),
    (848, 480, 420.0, 620.0),
    (1280, 720, 630.0, 940.0),
    (1280, 720, 880.0, 930.0),
    (1280, 800, 560.0, 1000.0),
)
PROBE_SIZE = 72
MIN_VISIBLE_SHARE = 0.1
MIN_BEST_SHARE = 0.3


@dataclass(frozen=True, eq=False, slots=True)
class PlacedPart:
    """T_world_part: (4,4). extents_m: (3,). vertices_world: (V,3)."""

    T_world_part: Array
    extents_m: Array
    vertices_world: NDArray[np.float32]


@dataclass(frozen=True, eq=False, slots=True)
class Coverage:
    """low, high: (2,) px, box of what is visible of the object. visible_px, silhouette_px: per part, its
    pixels and those of its silhouette if nothing hid it; measured on a coarse grid.
    """

    low: Array
    high: Array
    visible_px: tuple[float, ...]
    silhouette_px: tuple[float, ...]

    @property
    def shares(self) -> tuple[float, ...]:
        """Per part, the visible share of its silhouette."""
        return tuple(v / max(s, 1.0) for v, s in zip(self.visible_px, self.silhouette_px, strict=True))


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """One object of `category` in its surroundings. joint_states: rad or m. camera: the whole frame's. coverage:
    in its pixels.
    """

    category: str
    parts: tuple[PlacedPart, ...]
    joint_states: States
    world: World
    lighting: Lighting
    camera: Camera
    coverage: Coverage


@dataclass(frozen=True, eq=False, slots=True)
class _Posed:
    """meshes with their labels, 0 for what is no part, and T_world_part (4,4), of an object at rest, turned by
    yaw_rad."""

    meshes: list[Mesh]
    labels: list[int]
    poses: list[Array]
    yaw_rad: float


def _posed(rng: Generator, kind: SceneCategory, model: ArticulatedObject, states: States) -> _Posed:
    """The object above the origin as things of its kind rest, all of it at or above the support."""
    yaw = float(rng.uniform(0, 2 * np.pi))
    rest = kind.rest(rng)
    rotation = rotation_about(np.array([0.0, 0.0, 1.0]), yaw) @ rest.rotation
    corners = model.parts[0].mesh.vertices @ rotation.T
    T_world_root = transform_from(rotation, np.array([0.0, 0.0, -float(corners[:, 2].min()) + 1e-4]))
    poses = model.poses(T_world_root, states)
    meshes = [moved(part.mesh, pose) for part, pose in zip(model.parts, poses, strict=True)]
    labels = list(range(1, len(meshes) + 1))
    for part, mesh in model.loose:
        meshes.append(moved(mesh, poses[part]))
        labels.append(0)
    # A lid that would go through the table lifts the whole object (it then leans on its lid).
    lift = max(0.0, 1e-4 - float(min(mesh.vertices[:, 2].min() for mesh in meshes))) + rest.height_m
    if not lift:
        return _Posed(meshes, labels, poses, yaw)
    rise = np.array([0, 0, lift])
    lifted = [pose + np.pad(rise[:, None], ((0, 1), (3, 0))) for pose in poses]
    return _Posed([moved(mesh, transform_from(np.eye(3), rise)) for mesh in meshes], labels, lifted, yaw)


def _footprint(meshes: list[Mesh], yaw: float) -> Footprint:
    c, s = np.cos(yaw), np.sin(yaw)
    points = np.concatenate([mesh.vertices[:, :2] for mesh in meshes]) @ np.array([[c, -s], [s, c]])
    return Footprint(yaw, points.min(axis=0).astype(float), points.max(axis=0).astype(float))


def _sample_camera(rng: Generator, T_camera_world: Array) -> Camera:
    width, height, low, high = CAMERAS[int(rng.integers(len(CAMERAS)))]
    focal = float(rng.uniform(low, high))
    aspect = 1 + float(rng.normal(0, 0.001))
    center = np.array([width, height]) / 2 + rng.normal(0, 0.008, 2) * width
    K = np.array([[focal, 0, center[0]], [0, focal * aspect, center[1]], [0, 0, 1.0]])
    return Camera(K=K, width=width, height=height, T_camera_world=T_camera_world)


def sample_scene(category: str, rng: Generator, split: str = "train") -> Scene:
    """A random object of `category`, of those for `split`, in a random place before a random camera; all follows from
    `rng`.

    Raises ValueError for a category there are no scenes of.
    """
    kind = scene_category(category, split)
    model = kind.sample_object(rng)
    states = kind.sample_states(rng, model)
    posed = _posed(rng, kind, model, states)
    meshes, labels = posed.meshes, posed.labels
    footprint = _footprint(meshes, posed.yaw_rad)
    reach = float(np.abs(np.concatenate([footprint.low, footprint.high])).max())
    points = np.concatenate([mesh.vertices for mesh in meshes])
    target = ((points.min(axis=0) + points.max(axis=0)) / 2).astype(float)
    distances = kind.distance_m(model)
    others = surroundings(rng, reach, kind.on_table(model), distances[1]) + clutter(rng, footprint)
    if rng.random() < 0.15:  # another object of the category, which is not the one asked for
        others += _neighbour(rng, kind, footprint)
    everything, everywhere = meshes + others, labels + [0] * len(others)
    parts = tuple(
        PlacedPart(pose, part.extents_m, mesh.vertices)
        for pose, part, mesh in zip(posed.poses, model.parts, meshes, strict=False)
    )
    alone = tuple(silhouette_caster(mesh) for mesh in meshes[: len(parts)])
    lighting = sample_lighting(rng)
    plain_world = world_from(everything, everywhere)

    def look(*, occluded: bool) -> Scene:
        viewpoint = sample_viewpoint(rng, target, distances)
        hidden = occluders(rng, footprint, viewpoint, target) if occluded else []
        world = world_from(everything + hidden, everywhere + [0] * len(hidden)) if hidden else plain_world
        camera = _sample_camera(rng, viewpoint.T_camera_world)
        coverage = _coverage(world, parts, alone, camera)
        return Scene(category, parts, states, world, lighting, camera, coverage)

    for _ in range(kind.camera_tries - 1):
        scene = look(occluded=True)
        shares = scene.coverage.shares
        # Hard views (from behind the lid) stay; an object hardly seen is of no use. Of many parts a third may hide.
        hard = sorted(shares)[(len(shares) - 1) // 3] < MIN_VISIBLE_SHARE
        if max(shares) > MIN_BEST_SHARE and (not hard or rng.random() < kind.hard_views):
            return scene
    scene = look(occluded=False)
    for _ in range(kind.last_tries - 1):
        if any(scene.coverage.visible_px):
            break
        scene = look(occluded=False)
    return scene


def _neighbour(rng: Generator, kind: SceneCategory, footprint: Footprint) -> list[Mesh]:
    model = kind.sample_object(rng)
    posed = _posed(rng, kind, model, kind.sample_states(rng, model))
    own = _footprint(posed.meshes, posed.yaw_rad)
    radius = float(np.abs(np.concatenate([own.low, own.high])).max())
    x, y = beside(rng, footprint, radius, float(rng.exponential(0.05)))
    return [moved(mesh, upright(0.0, x, y, 0.0)) for mesh in posed.meshes]


def _window(parts: tuple[PlacedPart, ...], camera: Camera) -> tuple[float, float, float]:
    """(x, y, side) px of the square of the camera's image that holds the projected object."""
    pixels = np.concatenate([camera.project(part.vertices_world.astype(float)) for part in parts])
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    low, high = pixels.min(axis=0) - 2, pixels.max(axis=0) + 2
    side = float((high - low).max())
    middle = (low + high) / 2
    return float(middle[0] - side / 2), float(middle[1] - side / 2), side


def square_camera(camera: Camera, x: float, y: float, side: float, size: int) -> Camera:
    """The camera of the square at (x,y) of `side` px, rounded as a crop of a frame is, resized to `size`."""
    whole = max(2, round(side))
    return camera.cropped(round(x), round(y), whole, whole).resized(size, size)


def _coverage(world: World, parts: tuple[PlacedPart, ...], alone: tuple[Any, ...], camera: Camera) -> Coverage:
    """How much of the object `camera` sees; alone: a caster of each part."""
    x, y, side = _window(parts, camera)
    probe = square_camera(camera, x, y, side, PROBE_SIZE)
    seen = labels_seen(world, probe)
    step = max(2, round(side)) / PROBE_SIZE
    rows, columns = np.nonzero(seen) if seen.any() else np.indices(seen.shape).reshape(2, -1)
    corner = np.array([round(x), round(y)], float)
    return Coverage(
        low=corner + np.array([columns.min(), rows.min()]) * step,
        high=corner + np.array([columns.max() + 1, rows.max() + 1]) * step,
        visible_px=tuple(float(np.count_nonzero(seen == k + 1)) * step**2 for k in range(len(parts))),
        silhouette_px=tuple(float(np.count_nonzero(silhouette(caster, probe))) * step**2 for caster in alone),
    )
