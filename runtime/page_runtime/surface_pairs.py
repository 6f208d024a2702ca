"""Which sample of a template's surface each visible point of a part belongs to, for `icp`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.multilateration import FloatArray
from page_runtime.similarity import Similarities
from page_runtime.template import Template

# A sample is compared by distance and, so many times more, by distance from its plane: else every point by an edge may
# choose the other face, whose samples stand further apart than the points are off.
NORMAL_WEIGHT = 15.0
# Sideways: the sine of an overshoot's direction out of its point's surface. Along the normal depth noise overshoots.
_SIDEWAYS = 0.5
# As in scoring: 640 KB of float32 stay in the cache.
_BLOCK = 160_000


@dataclass(frozen=True, eq=False, slots=True)
class Placed:
    """A pose and the log stretches (3,) of the template along its axes."""

    pose: Similarities
    stretch: FloatArray

    @property
    def size_m(self) -> FloatArray:
        """(3,) metres a unit of the template, along its axes."""
        return self.pose.s[0] * np.exp(self.stretch)


@dataclass(frozen=True, eq=False, slots=True)
class Pairs:
    """Points and the planes they should lie in, in the part's axes, metres, origin the part's.

    points, normals: (P,3). residuals: (P,) normal . point - offset of the plane. overshooting: (Q,) of the P rows and
    axis: (Q,) along which they stand out of the box by overshoot (Q,), with its sign.
    """

    points: FloatArray
    normals: FloatArray
    residuals: FloatArray
    overshooting: NDArray[np.intp]
    axis: NDArray[np.intp]
    overshoot: FloatArray


def paired(points: FloatArray, placed: Placed, surface: Template, gate_m: float) -> Pairs | None:
    """Each point within the gate with the plane of its sample; None if no sample faces the camera."""
    R, t, size_m = placed.pose.R[0], placed.pose.t[0], placed.size_m
    places, normals = surface.points_unit * size_m, surface.normals_unit / size_m
    facing = np.flatnonzero(np.einsum("mk,mk->m", normals, places + t @ R) < 0.0)
    if not len(facing):
        return None
    places, normals = places[facing], normals[facing]
    normals /= np.sqrt(np.einsum("mk,mk->m", normals, normals))[:, None]
    own = (points - t) @ R
    nearest = _nearest(own, places, normals)
    offsets, normals = own - places[nearest], normals[nearest]
    near = np.einsum("nk,nk->n", offsets, offsets) <= gate_m * gate_m
    own, offsets, normals = own[near], offsets[near], normals[near]
    beyond = np.abs(own) - 0.5 * surface.extents_unit * size_m
    rows, axis = np.nonzero((beyond > 0.0) & (np.abs(normals) < _SIDEWAYS))
    overshoot = np.copysign(beyond[rows, axis], own[rows, axis])
    return Pairs(own, normals, np.einsum("nk,nk->n", normals, offsets), rows, axis, overshoot)


def distance_features(
    points: FloatArray, places: FloatArray, normals: FloatArray
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(..., N, 10) of points and (10, M) of samples, whose product is |p - q|^2 + w (n . (p - q))^2 less |p|^2.

    That is linear in the products of p with p. In float32, whose rounding is below 0.1 mm for parts of 1 m.
    """
    depth = np.einsum("mk,mk->m", normals, places)
    weighted = NORMAL_WEIGHT * normals
    features = np.empty((10, len(places)), np.float32)
    features[0] = NORMAL_WEIGHT * depth * depth + np.einsum("mk,mk->m", places, places)
    features[1:4] = -2.0 * (places + weighted * depth[:, None]).T
    features[4:7] = (weighted * normals).T
    features[7:10] = 2.0 * (weighted * normals[:, [1, 2, 0]]).T
    products = np.empty((*points.shape[:-1], 10), np.float32)
    products[..., 0] = 1.0
    products[..., 1:4] = points
    products[..., 4:7] = points * points
    products[..., 7:9] = points[..., :2] * points[..., 1:]
    products[..., 9] = points[..., 2] * points[..., 0]
    return products, features


def _nearest(points: FloatArray, places: FloatArray, normals: FloatArray) -> NDArray[np.intp]:
    """(N,) index of the sample least in |p - q|^2 + w (n . (p - q))^2, by `distance_features` in blocks."""
    products, features = distance_features(points, places, normals)
    nearest = np.empty(len(points), np.intp)
    step = max(_BLOCK // len(places), 1)
    for start in range(0, len(points), step):
        nearest[start : start + step] = (products[start : start + step] @ features).argmin(axis=1)
    return nearest
