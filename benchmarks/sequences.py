"""Procedural sequences: an object that moves on its support while its joints move, before a standing camera.

One object, one room, one sensor and one exposure for all frames of a sequence; the noise is new in each. Between two
frames the object moves as a hand would push it; for a while everything stands still, and for a while a board hides all
of it. A frame is a file, and rendering goes on with those that are missing.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.camera import Camera
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array, apply, invert, rotation_about, transform_from
from page_runtime.recorded import Instance, PartTruth, RecordedFrame
from page_training.categories import category_named
from page_training.scenes.articulated import ArticulatedObject
from page_training.scenes.kinds import scene_category
from page_training.scenes.materials import plain
from page_training.scenes.meshes import Mesh, cuboid, moved
from page_training.scenes.photo import develop
from page_training.scenes.render import Lighting, labels_seen, render, world_from
from page_training.scenes.sensor import Composite, Sensor, raster_of, sample_sensor, sense
from page_training.scenes.stage import Footprint, clutter, sample_lighting, sample_viewpoint, surroundings

FRAMES = 300
PERIOD_S = 1 / 30
HIDDEN = range(140, 150)
STILL = range(200, 250)
# Raise it with every change to what is rendered: frames of different versions must not mix.
VERSION = 1

_WIDTH, _HEIGHT, _FOCAL_PX = 640, 480, 560.0
_SLIDE_M = np.array([0.08, 0.05])
_SLIDE_PERIODS_S = np.array([5.0, 3.7])
_TURN_RAD, _TURN_PERIOD_S = 0.6, 6.0
# Of a joint's range to either side of its middle.
_JOINT_SHARE, _JOINT_PERIOD_S = 0.25, 4.5
_BOARD_M, _BOARD_AWAY_M = (0.9, 0.9, 0.01), 0.22
_LEAST_SHARE = 0.05
_VIEWPOINTS = 200


@dataclass(frozen=True, eq=False, slots=True)
class _Stage:
    """What stays the same for all frames of a sequence."""

    model: ArticulatedObject
    rest: Array
    rest_height_m: float
    yaw_rad: float
    others: tuple[Mesh, ...]
    board: Mesh
    lighting: Lighting
    camera: Camera
    sensor: Sensor
    seed: tuple[int, ...]


def path_time_s(index: int) -> float:
    """Seconds the object has been moving when frame `index` is taken: it stands still in STILL."""
    still = min(max(index - STILL.start, 0), len(STILL))
    return (index - still) * PERIOD_S


def sequence(
    category: str, cache: Path, *, seed: int = 0, frames: int = FRAMES, on_frame: Callable[[], None] = lambda: None
) -> Iterator[RecordedFrame]:
    """The frames of one sequence, rendered where the cache does not have them. on_frame: told after each of these."""
    folder = cache / f"{category}-{seed}-v{VERSION}"
    folder.mkdir(parents=True, exist_ok=True)
    stage: _Stage | None = None
    for index in range(frames):
        path = folder / f"{index:06d}.npz"
        if not path.exists():
            stage = stage or _stage(category, seed)
            partial = path.with_suffix(".partial.npz")
            rendered: dict[str, Any] = _rendered(stage, index)
            np.savez_compressed(partial, **rendered)
            partial.replace(path)
            on_frame()
        yield _recorded(category, path, index)


def _stage(category: str, seed: int) -> _Stage:
    numbers = (zlib.crc32(category.encode()), seed)
    rng = np.random.default_rng(numbers)
    kind = scene_category(category)
    model = kind.sample_object(rng)
    rest = kind.rest(rng)
    yaw = float(rng.uniform(0.0, 2.0 * np.pi))
    reach = 0.6 * model.diagonal_m + float(_SLIDE_M.max())
    footprint = Footprint(0.0, np.full(2, -reach), np.full(2, reach))
    distances = kind.distance_m(model)
    others = (*surroundings(rng, reach, kind.on_table(model), distances[1]), *clutter(rng, footprint))
    sensor = sample_sensor(rng)
    while isinstance(sensor, Composite):
        sensor = sample_sensor(rng)
    board = cuboid(_BOARD_M, plain(rng, np.array([0.6, 0.55, 0.5])))
    lighting = sample_lighting(rng)
    target = np.array([0.0, 0.0, 0.15 * model.diagonal_m])
    nearest = distances[0] + 0.25 * (distances[1] - distances[0])
    for _ in range(_VIEWPOINTS):
        viewpoint = sample_viewpoint(rng, target, (nearest, 0.5 * (nearest + distances[1])))
        K = np.array([[_FOCAL_PX, 0.0, (_WIDTH - 1) / 2], [0.0, _FOCAL_PX, (_HEIGHT - 1) / 2], [0.0, 0.0, 1.0]])
        camera = Camera(K, _WIDTH, _HEIGHT, viewpoint.T_camera_world)
        stage = _Stage(model, rest.rotation, rest.height_m, yaw, others, board, lighting, camera, sensor, numbers)
        if _well_seen(stage):
            return stage
    raise ValueError(f"{category}, seed {seed}: no viewpoint sees every part all the way; take another seed")


def _well_seen(stage: _Stage) -> bool:
    """Whether every part fills a share of its own box in the picture in frames all along the way, and nothing is cut
    off."""
    probe = stage.camera.resized(_WIDTH // 8, _HEIGHT // 8)
    for index in range(0, FRAMES, FRAMES // 8):
        meshes, labels, poses = _placed(stage, index)
        seen = labels_seen(world_from([*meshes, *stage.others], [*labels, *[0] * len(stage.others)]), probe)
        counts = [int(np.count_nonzero(seen == k + 1)) for k in range(len(poses))]
        rows, columns = np.nonzero(seen)
        if min(counts) < 12 or min(counts) < _LEAST_SHARE * sum(counts):
            return False
        if rows.min() < 2 or columns.min() < 2 or rows.max() > seen.shape[0] - 3 or columns.max() > seen.shape[1] - 3:
            return False
    return True


def _placed(stage: _Stage, index: int) -> tuple[list[Mesh], list[int], list[Array]]:
    """Meshes and labels of the object, and T_world_part of its parts, in frame `index`."""
    time_s = path_time_s(index)
    x, y = _SLIDE_M * np.sin(2.0 * np.pi * time_s / _SLIDE_PERIODS_S)
    yaw = stage.yaw_rad + _TURN_RAD * float(np.sin(2.0 * np.pi * time_s / _TURN_PERIOD_S))
    rotation = rotation_about(np.array([0.0, 0.0, 1.0]), yaw) @ stage.rest
    poses = stage.model.poses(transform_from(rotation, np.array([x, y, 0.0])), _states(stage, index))
    lowest = min(
        float(apply(pose, part.mesh.vertices.astype(float))[:, 2].min())
        for part, pose in zip(stage.model.parts, poses, strict=True)
    )
    rise = transform_from(np.eye(3), np.array([0.0, 0.0, 1e-4 - lowest + stage.rest_height_m]))
    poses: list[Array] = [rise @ pose for pose in poses]
    meshes = [moved(part.mesh, pose) for part, pose in zip(stage.model.parts, poses, strict=True)]
    labels = list(range(1, len(meshes) + 1))
    for part, mesh in stage.model.loose:
        meshes.append(moved(mesh, poses[part]))
        labels.append(0)
    return meshes, labels, poses


def _rendered(stage: _Stage, index: int) -> dict[str, Any]:
    meshes, labels, poses = _placed(stage, index)
    everything, everywhere = [*meshes, *stage.others], [*labels, *[0] * len(stage.others)]
    if index in HIDDEN:
        T_camera_board = transform_from(np.eye(3), np.array([0.0, 0.0, _BOARD_AWAY_M]))
        everything.append(moved(stage.board, invert(stage.camera.T_camera_world) @ T_camera_board))
        everywhere.append(0)
    rendering = render(world_from(everything, everywhere), stage.camera, stage.lighting)
    fresh = np.random.default_rng([*stage.seed, index])
    depth_m = sense(fresh, raster_of(rendering, _FOCAL_PX, _HEIGHT), stage.sensor)
    # The same random numbers in every frame: one exposure, one lens. Grain of its own comes on top.
    color = develop(np.random.default_rng(stage.seed), rendering.color, _HEIGHT, None)
    color = np.clip(color + fresh.normal(0.0, 2.0, color.shape), 0, 255).astype(np.uint8)
    rows, columns = np.nonzero(rendering.label)
    tight = (columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1) if len(rows) else (0, 0, 0, 0)
    return {
        "color": color,
        "depth_mm": np.round(depth_m * 1e3).astype(np.uint16),
        "K": stage.camera.K,
        "T_camera_part": np.stack([stage.camera.T_camera_world @ pose for pose in poses]),
        "extents_m": np.stack([part.extents_m for part in stage.model.parts]),
        "region": np.array(tight),
        "visible_px": np.array([np.count_nonzero(rendering.label == k + 1) for k in range(len(poses))]),
        "states": np.array(_states(stage, index)),
    }


def _states(stage: _Stage, index: int) -> tuple[float, ...]:
    """Of every joint in frame `index`."""
    time_s = path_time_s(index)
    return tuple(
        0.5 * (low + high)
        + _JOINT_SHARE * (high - low) * float(np.sin(2.0 * np.pi * time_s / _JOINT_PERIOD_S + 1.3 * k))
        for k, (low, high) in enumerate(model.limits for model in stage.model.joints)
    )


def _recorded(category: str, path: Path, index: int) -> RecordedFrame:
    data = np.load(path)
    camera = Camera(data["K"], data["color"].shape[1], data["color"].shape[0])
    depth_m = data["depth_mm"].astype(np.float32) * np.float32(1e-3)
    described = category_named(category)
    states = {joint.child: float(state) for joint, state in zip(described.joints, data["states"], strict=True)}
    x, y, w, h = (int(value) for value in data["region"])
    truths = tuple(
        PartTruth(part.name, T, extents, None if w else 0.0, states.get(k))
        for k, (part, T, extents) in enumerate(
            zip(described.parts, data["T_camera_part"], data["extents_m"], strict=True)
        )
    )
    frame = RgbdFrame(data["color"], depth_m, camera, index * PERIOD_S, index)
    return RecordedFrame(frame, (Instance((x, y, w, h) if w else None, truths),))
