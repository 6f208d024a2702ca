"""Views of a scene: the object's crop or the whole frame, as a depth camera records it, with its truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array
from page_runtime.sampling import Region
from page_training.scenes.photo import develop
from page_training.scenes.render import render
from page_training.scenes.scene import Scene, square_camera
from page_training.scenes.sensor import Composite, raster_of, sample_sensor, sense
from page_training.scenes.textures import Generator

SENSOR_TRIES = 3
MAX_MISSING = 0.5


@dataclass(frozen=True, eq=False, slots=True)
class PartTruth:
    """T_camera_part: (4,4). extents_m: (3,) full sizes. visible_px: pixels of the part in the view's mask.
    visible_share: visible_px over the pixels its silhouette would have in this view's camera if nothing hid
    or cut it.
    """

    T_camera_part: Array
    extents_m: Array
    visible_px: int
    visible_share: float


@dataclass(frozen=True, eq=False, slots=True)
class SceneView:
    """frame: sensor-like colour and depth. part_mask: (H,W) uint8, 0 = background, k + 1 = part k.
    normals_camera: (H,W,3) float32 unit, towards the camera, 0 where nothing is. noiseless_depth_m: (H,W)
    float32. truths: per part. joint_states: rad or m. region: (x,y,w,h) px, tight box of the object's visible
    pixels (0,0,0,0 if there are none).
    """

    frame: RgbdFrame
    part_mask: NDArray[np.uint8]
    normals_camera: NDArray[np.float32]
    noiseless_depth_m: NDArray[np.float32]
    truths: tuple[PartTruth, ...]
    joint_states: tuple[float, ...]
    region: Region


def training_view(scene: Scene, rng: Generator, size: int = 224) -> SceneView:
    """The object's crop alone, size x size: its visible box, padded 5-30 % a side, jittered, squared.

    What lies beyond the image of the scene's camera is black and without depth, as in a crop of a real frame.
    """
    low, high = scene.coverage.low, scene.coverage.high
    extent = high - low
    padding = rng.uniform(0.05, 0.30, 4) if rng.random() < 0.9 else rng.uniform(-0.10, 0.15, 4)
    low, high = low - padding[:2] * extent.max(), high + padding[2:] * extent.max()
    square = float((high - low).max())
    middle = (low + high) / 2
    left, top = middle - square / 2
    camera = square_camera(scene.camera, left, top, square, size)
    native = max(8, round(square))
    offsets = (np.arange(size) + 0.5) * (max(2, round(square)) / size) - 0.5
    columns, rows = round(left) + offsets, round(top) + offsets
    inside = np.outer(_within(rows, scene.camera.height), _within(columns, scene.camera.width))
    return _view(scene, rng, camera, native, inside)


def _within(positions: NDArray[np.float64], size: int) -> NDArray[np.bool_]:
    """Which pixel positions lie on an image `size` pixels long."""
    return (positions >= -0.5) & (positions < size - 0.5)


def full_view(scene: Scene, rng: Generator, width: int | None = None) -> SceneView:
    """The whole frame as the scene's camera records it; `width` px wide where another width is asked for.

    A narrower frame is that of a coarser camera, not a clean picture made smaller: noise and blur keep their size in
    pixels.
    """
    camera = scene.camera
    if width is not None:
        camera = camera.resized(width, round(camera.height * width / camera.width))
    return _view(scene, rng, camera, camera.height, np.ones((camera.height, camera.width), dtype=bool))


def _view(scene: Scene, rng: Generator, camera: Camera, native: int, inside: NDArray[np.bool_]) -> SceneView:
    """inside: (H,W), pixels that the scene's camera has."""
    rendering = render(scene.world, camera, scene.lighting)
    raster = raster_of(rendering, float(camera.K[0, 0]), native)
    on_object = raster.label > 0
    sensor = sample_sensor(rng)
    depth = sense(rng, raster, sensor)
    for _ in range(SENSOR_TRIES - 1):
        if not on_object.any() or np.mean(depth[on_object] == 0) < MAX_MISSING:
            break
        sensor = sample_sensor(rng)
        depth = sense(rng, raster, sensor)
    shape = rendering.depth_m.shape
    if depth.shape != shape:
        rows = ((2 * np.arange(shape[0]) + 1) * depth.shape[0]) // (2 * shape[0])
        columns = ((2 * np.arange(shape[1]) + 1) * depth.shape[1]) // (2 * shape[1])
        depth = np.ascontiguousarray(depth[np.ix_(rows, columns)])
    pasted = rendering.label > 0 if isinstance(sensor, Composite) else None
    color = develop(rng, rendering.color, native, pasted)
    color[~inside] = 0
    label = np.where(inside, rendering.label, 0).astype(np.uint8)
    return SceneView(
        frame=RgbdFrame(color=color, depth_m=np.where(inside, depth, np.float32(0)), camera=camera),
        part_mask=label,
        normals_camera=rendering.normals_camera,
        noiseless_depth_m=rendering.depth_m,
        truths=_truths(scene, camera, label),
        joint_states=scene.joint_states,
        region=_tight_box(label > 0),
    )


def _truths(scene: Scene, camera: Camera, label: NDArray[np.uint8]) -> tuple[PartTruth, ...]:
    # A crop or a resized frame has the scene's own rays, so silhouettes only scale.
    scale = float(camera.K[0, 0] * camera.K[1, 1] / (scene.camera.K[0, 0] * scene.camera.K[1, 1]))
    truths = []
    for k, part in enumerate(scene.parts):
        visible = int(np.count_nonzero(label == k + 1))
        alone = scene.coverage.silhouette_px[k] * scale
        share = min(1.0, visible / alone) if alone > 0 else 0.0
        truths.append(PartTruth(camera.T_camera_world @ part.T_world_part, part.extents_m, visible, share))
    return tuple(truths)


def _tight_box(mask: NDArray[np.bool_]) -> Region:
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not len(columns):
        return 0, 0, 0, 0
    return int(columns[0]), int(rows[0]), int(columns[-1] - columns[0] + 1), int(rows[-1] - rows[0] + 1)
