"""Depth cameras: from noiseless depth to what a stereo, a time-of-flight or a composited recording would
hold.

All lengths called `_px` are pixels of the sensor itself; `Raster.px` says how many pixels of the processed
image one of them is (at most 1: where the image is finer than the sensor, it is first reduced to the
sensor's own pixels).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from page_training.scenes.render import Rendering
from page_training.scenes.textures import Generator

# float32 in fact; NumPy's stubs widen the results of mixed arithmetic.
Floats = NDArray[np.floating]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class Raster:
    """The noiseless picture on the sensor's pixels. depth_m: (H,W), 0 = nothing. label: (H,W). opacity:
    (H,W). grazing: (H,W), 0 where the surface faces the camera, 1 where it is seen edge-on. focal_px: of
    this image. px: pixels of this image per pixel of the sensor.
    """

    depth_m: Floats
    label: NDArray[np.uint8]
    opacity: Floats
    grazing: Floats
    focal_px: float
    px: float


@dataclass(frozen=True, eq=False, slots=True)
class Stereo:
    """A stereo camera. disparity_step_px: quantisation. noise_px: disparity noise, with cells of
    noise_cell_px. smooth_px: spatial filter. fatten_px: growth of near surfaces. band_px: missing rim at
    depth steps. step_m: what counts as a depth step. shadow: side the other eye cannot see, -1 left, +1
    right. scale_error: of z.
    """

    baseline_m: float
    disparity_step_px: float
    noise_px: float
    noise_cell_px: float
    smooth_px: float
    fatten_px: float
    band_px: float
    step_m: float
    shadow: int
    scale_error: float


@dataclass(frozen=True, eq=False, slots=True)
class TimeOfFlight:
    """noise_m at 1 m; mixed_px: width over which edges mix; wiggle_m: slow error over the picture."""

    noise_m: float
    mixed_px: float
    wiggle_m: float


@dataclass(frozen=True, eq=False, slots=True)
class Composite:
    """A clean rendered object before the noisy depth of a real room (the mixed-reality recordings)."""

    background_noise_m: float
    background_cell_px: float
    object_noise_m: float


Sensor = Stereo | TimeOfFlight | Composite


def sample_sensor(rng: Generator) -> Sensor:
    """RealSense-like and OAK-like stereo, time of flight, mixed reality."""
    draw = rng.random()
    if draw < 0.45:  # RealSense-like
        return Stereo(
            baseline_m=float(rng.choice([0.050, 0.055, 0.095])),
            disparity_step_px=1 / 32,
            noise_px=float(rng.uniform(0.02, 0.22)),
            noise_cell_px=float(rng.uniform(5, 28)),
            smooth_px=float(rng.choice([0.0, rng.uniform(0.7, 2.5), rng.uniform(2.0, 7.0)])),
            fatten_px=float(rng.choice([0.0, rng.uniform(1, 4)])),
            band_px=float(rng.choice([0.0, rng.uniform(1, 5), rng.uniform(3, 11)])),
            step_m=float(rng.uniform(0.012, 0.05)),
            shadow=int(rng.choice([-1, 1])),
            scale_error=float(rng.normal(0, 0.003)),
        )
    if draw < 0.62:  # OAK-like
        return Stereo(
            baseline_m=0.075,
            disparity_step_px=float(rng.choice([1.0, 1 / 8, 1 / 8, 1 / 32])) * 0.5,
            noise_px=float(rng.uniform(0.03, 0.3)),
            noise_cell_px=float(rng.uniform(4, 20)),
            smooth_px=float(rng.uniform(0.5, 4)),
            fatten_px=float(rng.uniform(1, 6)),
            band_px=float(rng.choice([0.0, rng.uniform(1, 4)])),
            step_m=float(rng.uniform(0.02, 0.06)),
            shadow=int(rng.choice([-1, 1])),
            scale_error=float(rng.normal(0, 0.004)),
        )
    if draw < 0.75:
        return TimeOfFlight(
            noise_m=float(rng.uniform(0.0005, 0.004)),
            mixed_px=float(rng.uniform(0.3, 1.5)),
            wiggle_m=float(rng.uniform(0, 0.005)),
        )
    return Composite(
        background_noise_m=float(rng.uniform(0.002, 0.02)),
        background_cell_px=float(rng.uniform(6, 50)),
        object_noise_m=float(rng.choice([0.0, rng.uniform(0.0, 0.0015)])),
    )


def smooth_field(rng: Generator, shape: tuple[int, int], cell: float) -> Floats:
    """(H,W) noise of about unit deviation whose values change over `cell` pixels."""
    cell = max(cell, 1.0)
    height, width = shape
    grid = (int(height / cell) + 3, int(width / cell) + 3)
    coarse = rng.standard_normal(grid, dtype=np.float32)
    if cell <= 1.0:
        return coarse[:height, :width]
    size = (round(grid[1] * cell), round(grid[0] * cell))
    # Cubic interpolation between independent values keeps about 0.6 of their variance.
    field = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)[int(cell) :, int(cell) :]
    return np.asarray(field[:height, :width] * np.float32(1.3), np.float32)


def raster_of(rendering: Rendering, focal_px: float, native: int) -> Raster:
    """The noiseless picture sampled by a sensor of `native` rows, or on its own pixels if those are fewer."""
    size = rendering.depth_m.shape[0]
    normal = rendering.normals_camera
    grazing = 1 - np.abs(normal[..., 2])
    depth, label, opacity = rendering.depth_m, rendering.label, rendering.opacity
    if native < size:
        lattice = np.floor((np.arange(native) + 0.5) * (size / native)).astype(np.intp)
        grid = np.ix_(lattice, lattice)
        depth, label, opacity, grazing = depth[grid], label[grid], opacity[grid], grazing[grid]
    small = min(native, size)
    return Raster(depth, label, opacity, grazing, focal_px=focal_px * small / size, px=small / native)


def sense(rng: Generator, raster: Raster, sensor: Sensor) -> Floats:
    """(H,W) float32 depth in metres as `sensor` reports it, in whole millimetres, 0 = no reading."""
    match sensor:
        case Stereo():
            depth, valid = _stereo(rng, raster, sensor)
        case TimeOfFlight():
            depth, valid = _time_of_flight(rng, raster, sensor)
        case Composite():
            depth, valid = _composite(rng, raster, sensor)
    valid &= raster.depth_m > 0
    return np.where(valid, np.round(depth * 1000) / 1000, 0).clip(0).astype(np.float32)


def _kernel(length: float) -> NDArray[np.uint8]:
    side = 2 * round(length) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)


def _holes(rng: Generator, raster: Raster, *, object_rates: tuple[float, float]) -> Mask:
    """(H,W) True where blobs of readings are missing: where surfaces are glossy, dark, clear or seen edge-on.

    object_rates: smallest and largest share of a part's pixels that go, in the parts that have any holes.
    """
    shape = raster.depth_m.shape
    # Blobs come in all sizes, up to a third of the picture; their rims are slightly ragged.
    cell = max(shape) * float(np.exp(rng.uniform(np.log(0.03), np.log(0.35))))
    field = smooth_field(rng, shape, cell) + rng.uniform(0, 0.35) * smooth_field(
        rng, shape, max(3 * raster.px, cell / 5)
    )
    field = field + 3 * (1 - raster.opacity) + rng.uniform(0, 2) * raster.grazing
    holes = np.zeros(shape, bool)
    for label in range(int(raster.label.max()) + 1):
        here = raster.label == label
        rate = float(rng.choice([0.0, rng.uniform(0, 0.02), rng.uniform(0, 0.08)]))
        if label > 0:
            rate = float(rng.uniform(*object_rates)) if rng.random() < 0.45 else 0.0
        count = int(np.count_nonzero(here))
        if rate * count < 1:
            continue
        threshold = np.partition(field[here], count - 1 - int(rate * (count - 1)))[count - 1 - int(rate * (count - 1))]
        holes |= here & (field > threshold)
    return holes


def _stereo(rng: Generator, raster: Raster, sensor: Stereo) -> tuple[Floats, Mask]:
    depth, px = raster.depth_m, raster.px
    depth = np.where(depth > 0, depth, 10.0).astype(np.float32)
    shape = depth.shape
    if sensor.fatten_px * px >= 0.5:
        depth = cv2.erode(depth, _kernel(sensor.fatten_px * px / 2))
    reach = _kernel(max(sensor.band_px, 1.0) * px)
    near, far = cv2.erode(depth, reach), cv2.dilate(depth, reach)
    # A step is judged against a threshold that itself wanders, so the missing rim has the ragged width of
    # real ones.
    wander = 1 + 0.4 * smooth_field(rng, shape, 8 * px)
    behind = depth - near
    valid = np.ones(shape, bool)
    if sensor.band_px > 0:
        valid &= behind < sensor.step_m * np.maximum(wander, 0.3)
    focal = raster.focal_px
    disparity = focal * sensor.baseline_m / depth
    valid &= ~_unseen_by_other_eye(disparity, sensor.shadow)
    if sensor.smooth_px > 0:
        blurred = cv2.GaussianBlur(depth, (0, 0), max(sensor.smooth_px * px, 0.3))
        flat = (far - near) < sensor.step_m
        flying = rng.random() < 0.3
        depth = np.where(flat | flying, blurred, depth)
    constant = sensor.baseline_m * focal / px
    noise = smooth_field(rng, shape, sensor.noise_cell_px * px) * sensor.noise_px
    noise = noise + smooth_field(rng, shape, 2 * px) * (sensor.noise_px * float(rng.uniform(0, 0.4)))
    measured = constant / (depth * (1 + sensor.scale_error)) + noise
    step = sensor.disparity_step_px
    measured = np.maximum(np.round(measured / step), 1) * step
    valid &= ~_holes(rng, raster, object_rates=(0.02, 0.5))
    return constant / measured, valid


def _unseen_by_other_eye(disparity: NDArray[Any], side: int) -> Mask:
    """(H,W) True where a nearer surface hides the point from the second camera, left (-1) or right (+1) of
    it.

    Along a row the match of pixel x is x - disparity; a point is hidden when one further inwards matches at
    or before it.
    """
    columns = np.arange(disparity.shape[1], dtype=np.float32)
    ordered = disparity if side < 0 else disparity[:, ::-1]
    match = columns - ordered
    first_inwards = np.minimum.accumulate(match[:, ::-1], axis=1)[:, ::-1]
    hidden = match > first_inwards + 1.0
    return hidden if side < 0 else hidden[:, ::-1]


def _time_of_flight(rng: Generator, raster: Raster, sensor: TimeOfFlight) -> tuple[Floats, Mask]:
    depth, px, shape = raster.depth_m, raster.px, raster.depth_m.shape
    mixed = cv2.GaussianBlur(depth, (0, 0), max(sensor.mixed_px * px, 0.3))
    noise = smooth_field(rng, shape, 1.5) * sensor.noise_m * depth**2 * (1 + raster.grazing)
    wiggle = smooth_field(rng, shape, 60 * px) * sensor.wiggle_m
    steep = np.abs(mixed - depth) > 0.01
    dropped = steep & (rng.random(shape, dtype=np.float32) < rng.uniform(0, 0.9))
    return mixed + noise + wiggle, ~_holes(rng, raster, object_rates=(0.02, 0.4)) & ~dropped


def _composite(rng: Generator, raster: Raster, sensor: Composite) -> tuple[Floats, Mask]:
    depth, px, shape = raster.depth_m, raster.px, raster.depth_m.shape
    cell = sensor.background_cell_px * px
    lumps = smooth_field(rng, shape, cell) + 0.4 * smooth_field(rng, shape, cell / 4)
    room = cv2.GaussianBlur(depth, (0, 0), max(2.5 * px, 0.3)) + lumps * sensor.background_noise_m * depth**2
    thing = depth + smooth_field(rng, shape, 3 * px) * sensor.object_noise_m
    # Missing readings of the room are short horizontal streaks.
    streaks = smooth_field(rng, (shape[0], max(shape[1] // 4, 1)), max(2.5 * px, 1.0))
    missing = cv2.resize(streaks, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST) > rng.uniform(2.0, 3.2)
    on_object = raster.label > 0
    flaws = _holes(rng, raster, object_rates=(0.0, 0.06)) if rng.random() < 0.3 else np.zeros(shape, bool)
    return np.where(on_object, thing, room), np.where(on_object, ~flaws, ~missing)
