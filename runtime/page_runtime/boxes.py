"""Oriented boxes: corners, edges and the exact volume two of them share.

A box is T_a_box (4,4), its centre and axes, and extents_m (3,), its full sizes along its own axes.
"""

from __future__ import annotations

import numpy as np

from page_runtime.geometry import Array, apply, invert

# Corner i has the signs of i's bits: x bit 0, y bit 1, z bit 2. An edge joins corners that differ in one bit.
CORNER_SIGNS = np.array([[1 if i >> axis & 1 else -1 for axis in range(3)] for i in range(8)], dtype=float)
EDGES = tuple((i, i | 1 << axis) for i in range(8) for axis in range(3) if not i >> axis & 1)

# Faces that coincide would be counted twice or not at all, as rounding has it. One box is made larger by this share of
# the sizes, so that none do: far above rounding, far below anything that matters.
_GROWTH_SHARE = 1e-11


def box_corners(T_a_box: Array, extents_m: Array) -> Array:
    """(8,3) corners in frame a, in the order of CORNER_SIGNS."""
    return apply(T_a_box, CORNER_SIGNS * (np.asarray(extents_m) / 2))


def intersection_volume(T_a_one: Array, extents_one: Array, T_a_other: Array, extents_other: Array) -> float:
    """Volume two oriented boxes share, m^3, exact but for rounding (a share of 1e-10).

    Every face of the common polyhedron is a face of one box cut by the other, so by the divergence theorem
    V = 1/3 sum over faces of (distance of its plane from the origin) x (area), with no polyhedron ever built. The
    origin is the first box's centre, which keeps the terms small.
    """
    T_one_other = invert(T_a_one) @ T_a_other
    T_other_one = invert(T_one_other)
    half_one, half_other = np.asarray(extents_one) / 2, np.asarray(extents_other) / 2
    half_other = half_other + _GROWTH_SHARE * float(half_one.max() + half_other.max())
    six_volumes = 0.0
    for axis in range(3):
        for sign in (-1.0, 1.0):
            polygon_other = _clipped(apply(T_other_one, _face(half_one, axis, sign)), half_other)
            six_volumes += half_one[axis] * _twice_area(polygon_other)
            polygon_one = _clipped(apply(T_one_other, _face(half_other, axis, sign)), half_one)
            distance = sign * float(T_one_other[:3, axis] @ T_one_other[:3, 3]) + half_other[axis]
            six_volumes += distance * _twice_area(polygon_one)
    return max(0.0, six_volumes / 6)


def _face(half: Array, axis: int, sign: float) -> Array:
    """(4,3) corners of a box's face, in order around it."""
    corners = np.empty((4, 3))
    corners[:, axis] = sign * half[axis]
    corners[:, (axis + 1) % 3] = np.array([-1.0, 1.0, 1.0, -1.0]) * half[(axis + 1) % 3]
    corners[:, (axis + 2) % 3] = np.array([-1.0, -1.0, 1.0, 1.0]) * half[(axis + 2) % 3]
    return corners


def _clipped(polygon: Array, half: Array) -> Array:
    """The convex polygon (n,3) as far as it lies in |x| <= half; (0,3) when nothing does (Sutherland-Hodgman)."""
    for axis in range(3):
        for sign in (-1.0, 1.0):
            depth = half[axis] - sign * polygon[:, axis]
            if (depth >= 0).all():
                continue
            following, following_depth = np.roll(polygon, -1, axis=0), np.roll(depth, -1)
            kept = []
            for a, b, depth_a, depth_b in zip(polygon, following, depth, following_depth, strict=True):
                if depth_a >= 0:
                    kept.append(a)
                if (depth_a >= 0) != (depth_b >= 0):
                    kept.append(a + (b - a) * (depth_a / (depth_a - depth_b)))
            polygon = np.array(kept).reshape(-1, 3)
            if len(polygon) < 3:
                return np.empty((0, 3))
    return polygon


def _twice_area(polygon: Array) -> float:
    """Twice the area of a convex planar polygon (n,3)."""
    if len(polygon) < 3:
        return 0.0
    spokes = polygon[1:] - polygon[0]
    return float(np.linalg.norm(np.cross(spokes[:-1], spokes[1:]).sum(axis=0)))


def box_iou(T_a_one: Array, extents_one: Array, T_a_other: Array, extents_other: Array) -> float:
    """Intersection over union of two oriented boxes, in [0, 1]."""
    common = intersection_volume(T_a_one, extents_one, T_a_other, extents_other)
    union = float(np.prod(extents_one)) + float(np.prod(extents_other)) - common
    return float(np.clip(common / union, 0.0, 1.0))
