"""What a part of an object is placed by, many ways to place all of them, and how well each fits a part's points."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.multilateration import thinned
from page_runtime.similarity import FloatArray
from page_runtime.surface_pairs import NORMAL_WEIGHT, distance_features
from page_runtime.template import Template

# Of a part, enough to tell placements apart.
_POINTS = 40
_SAMPLES = 160
# Where a point stops to tell how far off a part is: of the sensor and the network's cut, and of a diagonal.
_NEAR_M = 0.006
_NEAR_UNIT = 0.03
# Radii err in common, and say least where a part's pose is in doubt.
_RADIUS_UNIT = 0.1
_RADIUS_SHARE = 0.3


@dataclass(frozen=True, eq=False, slots=True)
class Piece:
    """What a part is placed by. points (m,3) m, camera; radii_m (m,n) to keypoints_unit (n,3); diagonal_m, and surface,
    stretched to its box."""

    points: FloatArray
    radii_m: FloatArray
    keypoints_unit: FloatArray
    diagonal_m: float
    surface: Template

    @property
    def extents_m(self) -> FloatArray:
        return self.diagonal_m * self.surface.extents_unit

    @property
    def seen(self) -> bool:
        return len(self.points) > 0

    def sketch(self) -> Piece:
        """With as many points and samples as tell placements apart."""
        some = thinned(len(self.points), _POINTS)
        few = thinned(len(self.surface.points_unit), _SAMPLES)
        surface = Template(self.surface.points_unit[few], self.surface.normals_unit[few], self.surface.extents_unit)
        return replace(self, points=self.points[some], radii_m=self.radii_m[some], surface=surface)


@dataclass(frozen=True, eq=False, slots=True)
class Placements:
    """C ways to place the K parts. R (C,K,3,3), t (C,K,3) m; misfit (C,K) of each part, NaN where it is not placed."""

    R: FloatArray
    t: FloatArray
    misfit: FloatArray

    def __len__(self) -> int:
        return len(self.R)

    def take(self, chosen: NDArray[np.intp]) -> Placements:
        return Placements(self.R[chosen], self.t[chosen], self.misfit[chosen])


def misfits(piece: Piece, R: FloatArray, t: FloatArray) -> FloatArray:
    """(C,) in [0, 1] of poses R (C,3,3), t (C,3): how far the part's points are from the side of its surface that faces
    the camera, and its keypoints from where the radii have them; each point counts at most 1. 0 of a part without any.
    """
    if not piece.seen:
        return np.zeros(len(R))
    size = piece.diagonal_m
    near2 = max(_NEAR_M, _NEAR_UNIT * size) ** 2
    own, squares = to_samples(piece, R, t, near2)
    least = squares.min(axis=2) + np.einsum("cnk,cnk->cn", own, own)
    # Samples stand further apart than points are off their surface.
    least = np.maximum(least / (1.0 + NORMAL_WEIGHT), 0.0)
    surface = np.mean(least / (least + near2), axis=1)
    keypoints = size * piece.keypoints_unit
    reach2 = np.einsum("cnk,cnk->cn", own, own)[..., None] + np.einsum("nk,nk->n", keypoints, keypoints)
    reach = np.sqrt(np.maximum(reach2 - 2.0 * (own @ keypoints.T), 0.0))
    ratio2 = ((reach - piece.radii_m) / (_RADIUS_UNIT * size)) ** 2
    radial = np.mean(ratio2 / (1.0 + ratio2), axis=(1, 2))
    total = (1.0 - _RADIUS_SHARE) * surface + _RADIUS_SHARE * radial
    # A place that is no number fits nothing.
    return np.nan_to_num(np.asarray(total, np.float64), nan=1.0)


def to_samples(piece: Piece, R: FloatArray, t: FloatArray, near2: float) -> tuple[FloatArray, NDArray[np.float32]]:
    """(C,N,3) the points in the part's frame, m, and (C,N,M) how far each is from each sample of the surface, by
    `distance_features`: less its own square. near2: m^2 that a side which faces away from the camera is farther."""
    places, normals = piece.diagonal_m * piece.surface.points_unit, piece.surface.normals_unit
    own = (piece.points - t[:, None]) @ R
    camera = -(t[:, None] @ R)[:, 0]
    # A point near a side that faces away is as far off as one that is only just near.
    averted = np.einsum("mk,mk->m", normals, places) - camera @ normals.T > 0.0
    penalty = np.float32((1.0 + NORMAL_WEIGHT) * near2)
    products, features = distance_features(own, places, normals)
    squares = (products.reshape(-1, products.shape[-1]) @ features).reshape(*own.shape[:2], -1)
    squares += penalty * averted[:, None]
    return own, squares
