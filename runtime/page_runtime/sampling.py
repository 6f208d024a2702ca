"""From a frame and a region to what the network takes: a colour crop and N visible points with their pixels.

Training and run time call this same code. Training frames are crops already, of the size the network takes; a crop
of fewer pixels is enlarged there, while on the device only its own pixels are sampled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.focus import Focus
from page_runtime.frame import RgbdFrame

Region = tuple[int, int, int, int]

REGION_MARGIN = 0.1
MIN_POINTS = 64
NEAR_SHARE = 0.15
MAX_REGION_SIDES = 4
GRID_STEP = 16


@dataclass(frozen=True, eq=False, slots=True)
class RegionSample:
    """The visible points of a region.

    image: (S,S,3) uint8 RGB crop. points_camera: (N,3) float32 metres, in progressive order: every prefix covers the
    region evenly (with a focus: what that covers), so the coarser levels of the network are prefixes and no farthest-
    point search is needed. pixels: (N,2) float32 position of each point in the crop, px. center_camera: (3,) their
    mean. camera: the crop's. source_index: (N,) index of each point in the flattened depth image it came from.
    num_distinct: points before repetition (fewer than N valid readings are repeated in order). other_depth_m: of the
    thing that the region is about if it is not about these points, None where depth shows but one. focus: where points
    were taken first, None for everywhere alike.
    """

    image: NDArray[np.uint8]
    points_camera: NDArray[np.float32]
    pixels: NDArray[np.float32]
    center_camera: NDArray[np.float32]
    camera: Camera
    source_index: NDArray[np.int64]
    num_distinct: int
    other_depth_m: float | None = None
    focus: Focus | None = None


@lru_cache(maxsize=32)
def progressive_order(side: int) -> NDArray[np.intp]:
    """(side^2,) flat indices of a side x side grid's pixels such that every prefix is spread evenly over the grid.

    The order in which the R2 sequence (the plastic number's additive recurrence, a low-discrepancy sequence)
    first touches the pixels.
    """
    plastic = 1.32471795724474602596
    n = np.arange(6 * side * side)
    columns = ((0.5 + n / plastic) % 1.0 * side).astype(np.intp)
    rows = ((0.5 + n / plastic**2) % 1.0 * side).astype(np.intp)
    flat = rows * side + columns
    _, first = np.unique(flat, return_index=True)
    order = flat[np.sort(first)]
    untouched = np.setdiff1d(np.arange(side * side), order, assume_unique=True)
    return np.concatenate([order, untouched])


def square_region(region: Region, margin: float = REGION_MARGIN) -> Region:
    """The square around `region` (x, y, w, h) px, widened by `margin` of its longer side on every side."""
    x, y, width, height = region
    side = max(2, round(max(width, height) * (1.0 + 2.0 * margin)))
    return round(x + (width - side) / 2), round(y + (height - side) / 2), side, side


def check_region(region: Region, width: int, height: int) -> Region:
    """`region` unchanged, or a ValueError when it is empty or does not overlap the width x height image."""
    x, y, w, h = region
    if w <= 0 or h <= 0:
        raise ValueError(f"region: expected a positive size x,y,w,h in pixels, got {x},{y},{w},{h}")
    if max(w, h) > MAX_REGION_SIDES * max(width, height):
        raise ValueError(
            f"region: {x},{y},{w},{h} is over {MAX_REGION_SIDES} times the {width}x{height} image; check its unit"
        )
    if x >= width or y >= height or x + w <= 0 or y + h <= 0:
        raise ValueError(
            f"region: {x},{y},{w},{h} lies outside the {width}x{height} image; expected x,y,w,h in pixels of it"
        )
    return region


def crop_color(color: NDArray[np.uint8], square: Region, size: int) -> NDArray[np.uint8]:
    """(size,size,3) uint8: the square resized, black where it reaches outside the image."""
    x, y, side, _ = square
    height, width = color.shape[:2]
    x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + side, width), min(y + side, height)
    crop = color[y0:y1, x0:x1]
    if (x0, y0, x1, y1) != (x, y, x + side, y + side):
        crop = cv2.copyMakeBorder(crop, y0 - y, y + side - y1, x0 - x, x + side - x1, cv2.BORDER_CONSTANT)
    interpolation = cv2.INTER_AREA if side > size else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(crop, (size, size), interpolation=interpolation), dtype=np.uint8)


def sample_region(
    frame: RgbdFrame,
    region: Region,
    *,
    image_size: int,
    num_points: int,
    radius_m: float,
    margin: float = REGION_MARGIN,
    depth_m: float | None = None,
    focus: Focus | None = None,
) -> RegionSample | str:
    """Sample `num_points` visible points of `region` (x, y, w, h px), or say why there are none.

    Depth is read, never interpolated: each point is a real reading at its own pixel. Readings farther than `radius_m`
    from the region's centre are background by distance: its central ray at the median depth of its central half, or,
    where that lies more than `radius_m` behind what fills NEAR_SHARE of the region, at the depth of this nearer thing:
    a box around an open laptop seen from the side holds more wall than laptop. The nearer thing may as well be an arm
    before the object, so the sample has the depth decided against as `other_depth_m`, and `depth_m` asks for it.
    `margin` widens the region as square_region says. With a `focus`, points within its reach come first
    (`Focus.in_order`), others only where those are fewer than `num_points`.
    """
    check_region(region, frame.camera.width, frame.camera.height)
    square = square_region(region, margin)
    x, y, side, _ = square
    # In steps, so that the few orders there are stay in the cache whatever sizes a detector gives.
    grid = min(side, image_size) // GRID_STEP * GRID_STEP or side
    lattice = np.floor((np.arange(grid) + 0.5) * (side / grid)).astype(np.intp)
    u, v = lattice + x, lattice + y
    depth = _readings(frame.depth_m, u, v)
    valid = depth > 0
    found = depth[valid]
    if len(found) < MIN_POINTS:
        return f"not seen: {len(found)} depth readings in the region, at least {MIN_POINTS} are needed"
    middle = np.array([x + (side - 1) / 2, y + (side - 1) / 2])
    central_depth, near_depth = _depths(depth, valid, found)
    two = central_depth - near_depth > radius_m
    anchor_depth = depth_m if depth_m is not None else near_depth if two else central_depth
    anchor = np.asarray(frame.camera.backproject(middle, np.asarray(anchor_depth)), np.float64)
    near = valid & (_squared_distances(frame.camera, u, v, depth, anchor) < radius_m**2)
    order = progressive_order(grid)
    first = order[near.ravel()[order]]
    if focus is not None:
        first = focus.in_order(first, square, grid)
    first = first[:num_points]
    if len(first) < MIN_POINTS:
        return (
            f"not seen: {len(first)} depth readings within {radius_m:.2f} m of the region's centre, "
            f"at least {MIN_POINTS} are needed"
        )
    chosen = np.resize(first, num_points)
    rows, columns = np.divmod(chosen, grid)
    pixels = np.stack([u[columns], v[rows]], axis=-1).astype(np.float32)
    points = frame.camera.backproject(pixels, depth.ravel()[chosen]).astype(np.float32)
    scale = image_size / side
    crop_pixels = (pixels - np.array([x, y], np.float32) + 0.5) * np.float32(scale) - 0.5
    return RegionSample(
        image=crop_color(frame.color, square, image_size),
        points_camera=points,
        pixels=crop_pixels.astype(np.float32),
        center_camera=points[: len(first)].mean(axis=0),
        camera=frame.camera.cropped(x, y, side, side).resized(image_size, image_size),
        source_index=(v[rows] * frame.depth_m.shape[1] + u[columns]).astype(np.int64),
        num_distinct=len(first),
        other_depth_m=central_depth if two and depth_m is None else None,
        focus=focus,
    )


def _readings(depth_m: NDArray[np.float32], u: NDArray[np.intp], v: NDArray[np.intp]) -> NDArray[np.float32]:
    """(grid,grid) depth at rows v and columns u, 0 beyond the image and where a reading is not finite."""
    height, width = depth_m.shape
    top, bottom = np.searchsorted(v, [0, height])
    left, right = np.searchsorted(u, [0, width])
    depth = np.zeros((len(v), len(u)), np.float32)
    depth[top:bottom, left:right] = depth_m[np.ix_(v[top:bottom], u[left:right])]
    depth[~np.isfinite(depth)] = 0.0
    return depth


def _depths(depth: NDArray[np.float32], valid: NDArray[np.bool_], found: NDArray[np.float32]) -> tuple[float, float]:
    """Metres to the middle of a region and to what fills NEAR_SHARE of it, from its depth (grid,grid), where that is
    valid, and these readings."""
    grid = len(depth)
    # Cells within a quarter of the grid of its middle.
    half = slice(grid // 4 + 1, -(-3 * grid // 4))
    central = depth[half, half][valid[half, half]]
    return float(np.median(central if len(central) else found)), float(np.quantile(found, NEAR_SHARE))


def _squared_distances(
    camera: Camera, u: NDArray[np.intp], v: NDArray[np.intp], depth: NDArray[np.float32], anchor: NDArray[np.float64]
) -> NDArray[np.float32]:
    """(grid,grid) m^2 from the point of each reading to the anchor (3,)."""
    y_ray = ((v - camera.K[1, 2]) / camera.K[1, 1]).astype(np.float32)
    x_ray = ((u - camera.K[0, 2]) / camera.K[0, 0]).astype(np.float32)
    slope = np.float32(camera.K[0, 1] / camera.K[0, 0])
    ax, ay, az = anchor.astype(np.float32)
    x = depth * (x_ray - slope * y_ray[:, None]) - ax
    y = depth * y_ray[:, None] - ay
    z = depth - az
    x *= x
    y *= y
    z *= z
    x += y
    x += z
    return x
