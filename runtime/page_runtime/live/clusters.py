"""Where objects may stand, by depth alone: large planes are removed, and what is left falls into clusters.

Nothing here knows a category but for its size: which of the clusters is an object of it is for the network to say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.category import Category
from page_runtime.geometry import Array
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import MIN_POINTS, Region
from page_runtime.similarity import FloatArray

# Readings are taken from a grid of about so many columns.
_COLUMNS = 214
_TRIES = 160
_TRIED_ON = 3000
_MOST_PLANES = 4
# Of all readings: what lies in one plane and is less is no table, wall or floor.
_PLANE_SHARE = 0.08
# A plane's readings are this near to it, metres at least and as a share of their own depth, stereo's noise growing.
_NEAR_PLANE_M, _NEAR_PLANE_SHARE = 0.006, 0.008
# Readings side by side farther apart than this in depth are of two things.
_STEP_M = 0.03
# Clusters whose boxes are nearer than this are tried as one as well: an object in two halves.
_TOGETHER_M = 0.03
_MOST_REGIONS = 12
_SEED = 7


@dataclass(frozen=True, slots=True)
class Clusters:
    """Regions of whatever stands out of the large planes of a frame and could be of the size of a category's objects.

    smallest_m, largest_m: diameters (of the visible side) of such objects. most: objects at a time, None for any
    number.
    """

    smallest_m: float
    largest_m: float
    most: int | None = None

    @staticmethod
    def of(category: Category, *, most: int | None = None) -> Clusters:
        """As large as the category's smallest part seen from its worst side, up to its region."""
        smallest_m = 0.4 * min(part.diagonal_range_m[0] for part in category.parts)
        return Clusters(smallest_m, 2.0 * category.region_radius_m, most)

    def locate(self, recorded: RecordedFrame) -> Sequence[Region]:
        """Boxes of the clusters, those with most readings first; those of clusters side by side follow."""
        camera = recorded.frame.camera
        step = max(1, camera.width // _COLUMNS)
        depth_m = recorded.frame.depth_m[step // 2 :: step, step // 2 :: step]
        rows, columns = np.mgrid[: depth_m.shape[0], : depth_m.shape[1]] * step + step // 2
        valid = np.isfinite(depth_m) & (depth_m > 0.0)
        if np.count_nonzero(valid) < MIN_POINTS:
            return ()
        depth_m = np.where(valid, depth_m, np.float32(0.0))
        points = camera.backproject(np.stack([columns, rows], axis=-1), depth_m)
        standing = valid.copy()
        for normal, offset in planes_in(points[valid]):
            standing &= np.abs(points @ normal - offset) > _near_m(depth_m)
            # The plane's far side is beyond a wall or below a table: reflections and errors.
            standing &= (points @ normal - offset) * -np.sign(offset) > 0.0
        boxes = self._boxes(_connected(standing, depth_m), points)
        boxes += [joined for joined in _pairs(boxes) if joined.diameter_m <= self.largest_m]
        fitting = [box for box in boxes if self.smallest_m <= box.diameter_m <= self.largest_m]
        regions = dict.fromkeys(_region(box, step, camera.width, camera.height) for box in fitting)
        return tuple(regions)[:_MOST_REGIONS]

    def _boxes(self, labels: NDArray[np.int32], points: Array) -> list[_Box]:
        counts = np.bincount(labels.ravel())
        counts[0] = 0
        order = [label for label in np.argsort(-counts, kind="stable") if counts[label] >= _least_readings(counts)]
        found = [_box(labels == label, points) for label in order]
        return [box for box in found if box.diameter_m <= self.largest_m]


@dataclass(frozen=True, eq=False, slots=True)
class _Box:
    """Of one cluster: rows and columns of the grid (first, last), and corners (3,) m in the camera's frame."""

    rows: tuple[int, int]
    columns: tuple[int, int]
    low: Array
    high: Array

    @property
    def diameter_m(self) -> float:
        return float(np.linalg.norm(self.high - self.low))


def planes_in(points: Array) -> list[tuple[Array, float]]:
    """The largest planes n . p = d in points (N,3) m, n (3,) unit length: at most _MOST_PLANES, each with at least
    _PLANE_SHARE of the points, the same at every call."""
    rng = np.random.default_rng(_SEED)
    rest, planes = points, []
    for _ in range(_MOST_PLANES):
        if len(rest) < max(_PLANE_SHARE * len(points), MIN_POINTS):
            break
        few = rest[rng.choice(len(rest), min(len(rest), _TRIED_ON), replace=False)]
        corners = few[rng.integers(len(few), size=(_TRIES, 3))]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1)
        # Three readings within some centimetres say little of a plane's direction.
        wide = lengths > 1e-3
        if not wide.any():
            break
        normals, corners = normals[wide] / lengths[wide, None], corners[wide]
        offsets = np.einsum("hk,hk->h", normals, corners[:, 0])
        inside = np.abs(few @ normals.T - offsets) <= _near_m(few[:, 2:])
        best = int(np.count_nonzero(inside, axis=0).argmax())
        normal, offset = normals[best], float(offsets[best])
        for _ in range(3):
            own = few[np.abs(few @ normal - offset) <= _near_m(few[:, 2])]
            normal, offset = _fitted_plane(own)
        near = np.abs(rest @ normal - offset) <= _near_m(rest[:, 2])
        if np.count_nonzero(near) < _PLANE_SHARE * len(points):
            break
        planes.append((normal, offset))
        rest = rest[~near]
    return planes


def _fitted_plane(points: Array) -> tuple[Array, float]:
    middle = points.mean(axis=0)
    normal = np.linalg.eigh((points - middle).T @ (points - middle))[1][:, 0]
    return normal, float(normal @ middle)


def _near_m(depth_m: NDArray[np.floating]) -> FloatArray:
    return np.maximum(_NEAR_PLANE_M, _NEAR_PLANE_SHARE * depth_m.astype(np.float64))


def _connected(standing: NDArray[np.bool_], depth_m: NDArray[np.float32]) -> NDArray[np.int32]:
    """(h,w) number of each reading's cluster, 0 for none: neighbours on the grid, no step in depth between them.

    Readings go to the even cells of a grid twice as fine, ties between neighbours to the cells between: connected
    there is connected here.
    """
    height, width = standing.shape
    fine = np.zeros((2 * height - 1, 2 * width - 1), np.uint8)
    fine[::2, ::2] = standing
    across = standing[:, 1:] & standing[:, :-1] & (np.abs(np.diff(depth_m, axis=1)) < _STEP_M)
    down = standing[1:] & standing[:-1] & (np.abs(np.diff(depth_m, axis=0)) < _STEP_M)
    fine[::2, 1::2], fine[1::2, ::2] = across, down
    _, labels = cv2.connectedComponents(fine, connectivity=4)
    return np.asarray(labels[::2, ::2], np.int32)


def _least_readings(counts: NDArray[np.intp]) -> float:
    return max(12.0, 2e-4 * float(counts.sum()))


def _box(own: NDArray[np.bool_], points: Array) -> _Box:
    rows, columns = np.flatnonzero(own.any(axis=1)), np.flatnonzero(own.any(axis=0))
    # Single readings between an object and what is behind it stretch a box; quantiles leave them out.
    low, high = np.quantile(points[own], [0.02, 0.98], axis=0)
    return _Box((int(rows[0]), int(rows[-1])), (int(columns[0]), int(columns[-1])), low, high)


def _pairs(boxes: Sequence[_Box]) -> list[_Box]:
    """The boxes of every two that are next to each other."""
    joined = []
    for index, one in enumerate(boxes):
        for other in boxes[index + 1 :]:
            if (np.maximum(one.low, other.low) - np.minimum(one.high, other.high)).max() <= _TOGETHER_M:
                joined.append(
                    _Box(
                        (min(one.rows[0], other.rows[0]), max(one.rows[1], other.rows[1])),
                        (min(one.columns[0], other.columns[0]), max(one.columns[1], other.columns[1])),
                        np.minimum(one.low, other.low),
                        np.maximum(one.high, other.high),
                    )
                )
    return joined


def _region(box: _Box, step: int, width: int, height: int) -> Region:
    """In pixels, with the half step of the grid on each side."""
    x, y = box.columns[0] * step, box.rows[0] * step
    right, bottom = min((box.columns[1] + 1) * step, width), min((box.rows[1] + 1) * step, height)
    return x, y, right - x, bottom - y
