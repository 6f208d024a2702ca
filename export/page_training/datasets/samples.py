"""Annotated real pictures as training samples: for a network trained on scenes to go on with (`page-train import`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.category import Category
from page_runtime.geometry import Array, apply, invert
from page_runtime.sampling import RegionSample
from page_training.cache import fill_record
from page_training.datasets.labelled import LabelledInstance
from page_training.focusing import samples_of_region
from page_training.record import jittered
from page_training.records import record_type

# Around the visible box, as the crops of scenes have it.
_MARGINS = (0.05, 0.3)
# Polygons were drawn by hand and depth bleeds at edges: a marked point so far out of the part's box is not of it.
_BEYOND_BOX_M = 0.015
# Pixels to either side that a normal is taken across, and how far apart in depth these may be.
_NORMAL_STEP = 3
_NORMAL_JUMP_M = 0.03


def records_of(instance: LabelledInstance, category: Category, repeats: int, rng: np.random.Generator) -> NDArray[Any]:
    """(R,) training records of `record_type`, of the region cut out and moved at random `repeats` times; two of each
    cut of thin objects (`focusing`).

    Fewer, or none, where the region holds too little depth.
    """
    frame = instance.frame
    normals = normals_camera(frame.depth_m, frame.camera)
    records = np.zeros((1 + category.focused) * repeats, record_type(len(category.parts)))
    filled = 0
    for _ in range(repeats):
        region = jittered(instance.region, rng, frame.camera.width, frame.camera.height)
        margin = float(rng.uniform(*_MARGINS))
        samples = samples_of_region(category, frame, region, margin, lambda one: _labels(instance, one), rng)
        for sample in samples:
            labels = _labels(instance, sample)
            fill_record(records[filled], sample, labels=labels, normals_camera=normals, truths=instance.truths)
            filled += 1
    return records[:filled]


def _labels(instance: LabelledInstance, sample: RegionSample) -> NDArray[np.int64]:
    """(N,) part of each point, the number of parts for background."""
    background = len(instance.truths)
    labels = instance.part_mask.ravel()[sample.source_index].astype(np.int64) - 1
    labels[labels < 0] = background
    for k, truth in enumerate(instance.truths):
        own = np.flatnonzero(labels == k)
        inside = np.abs(apply(invert(truth.T_camera_part), sample.points_camera[own].astype(np.float64)))
        labels[own[(inside > 0.5 * truth.extents_m + _BEYOND_BOX_M).any(axis=1)]] = background
    return labels


def normals_camera(depth_m: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """(H,W,3) unit normals towards the camera, from differences of the points; along the ray where there are none."""
    rows, columns = np.indices(depth_m.shape)
    pixels = np.stack([columns, rows], axis=-1).astype(np.float64)
    rays = camera.rays(pixels)
    points = rays * depth_m[..., None]
    across, known_across = _difference(points, depth_m, axis=1)
    down, known_down = _difference(points, depth_m, axis=0)
    normals = np.cross(down, across)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    flat = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    good = (known_across & known_down & (length[..., 0] > 0.0))[..., None]
    normals = np.where(good, normals / np.where(length > 0.0, length, 1.0), flat)
    facing = np.einsum("hwk,hwk->hw", normals, rays) > 0.0
    normals[facing] = -normals[facing]
    return normals.astype(np.float32)


def _difference(points: Array, depth_m: NDArray[np.float32], *, axis: int) -> tuple[Array, NDArray[np.bool_]]:
    """(H,W,3) m across 2 _NORMAL_STEP pixels, and where both ends are of one surface."""
    ahead, behind = -_NORMAL_STEP, _NORMAL_STEP
    difference = np.roll(points, ahead, axis) - np.roll(points, behind, axis)
    far, near = np.roll(depth_m, ahead, axis), np.roll(depth_m, behind, axis)
    known = (far > 0.0) & (near > 0.0) & (depth_m > 0.0)
    known &= (np.abs(far - depth_m) < _NORMAL_JUMP_M) & (np.abs(near - depth_m) < _NORMAL_JUMP_M)
    edge = [slice(None), slice(None)]
    for end in (slice(0, _NORMAL_STEP), slice(-_NORMAL_STEP, None)):
        edge[axis] = end
        known[tuple(edge)] = False
    return difference, known


def import_samples(
    instances: Iterable[LabelledInstance],
    category: Category,
    repeats: int,
    seed: int,
    on_instance: Callable[[], None] = lambda: None,
) -> NDArray[Any]:
    """(R,) records of all the instances; ValueError if there is nothing to learn from."""
    rng = np.random.default_rng(seed)
    pieces = []
    for instance in instances:
        pieces.append(records_of(instance, category, repeats, rng))
        on_instance()
    records = np.concatenate(pieces) if pieces else np.zeros(0, record_type(len(category.parts)))
    if not len(records):
        raise ValueError(f"category {category.name!r}: no instance that was chosen has depth to learn from")
    return records
