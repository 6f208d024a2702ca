"""Rigid transforms as 4x4 matrices.

`T_a_b` maps coordinates in frame b to coordinates in frame a; neighbours cancel:
`T_world_part = T_world_camera @ T_camera_part`. Lengths are metres, angles radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

ORTHONORMAL_TOLERANCE = 1e-4


def transform_from(rotation: Array, translation: Array) -> Array:
    """T_a_b (4,4) from R_a_b (3,3) and the origin of b seen from a (3,), metres."""
    T_a_b = np.eye(4)
    T_a_b[:3, :3] = rotation
    T_a_b[:3, 3] = translation
    return T_a_b


def invert(T_a_b: Array) -> Array:
    """T_b_a (..., 4, 4), the inverse of the rigid T_a_b, without a general matrix inversion."""
    R_b_a = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    T_b_a = np.zeros_like(T_a_b)
    T_b_a[..., :3, :3] = R_b_a
    T_b_a[..., :3, 3] = -(R_b_a @ T_a_b[..., :3, 3:])[..., 0]
    T_b_a[..., 3, 3] = 1.0
    return T_b_a


def apply(T_a_b: Array, points_b: Array) -> Array:
    """points_a (..., 3) = T_a_b applied to points_b (..., 3)."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def rotation_angle(R_a: Array, R_b: Array) -> Array:
    """Geodesic angle (...,) in [0, pi] between rotations (..., 3, 3).

    From sin(angle / 2), by the chord |R_a - R_b|_F = 2 sqrt(2) sin(angle / 2), which keeps its digits near 0 where the
    arc cosine of the trace loses half of them; and cos(angle / 2), beyond a quarter turn by the skew part of
    R = R_a^T R_b, |R - R^T|_F = 2 sqrt(2) sin(angle), as near pi 1 + trace loses half of them too.
    """
    half_chord = np.linalg.norm(R_a - R_b, axis=(-2, -1)) / np.sqrt(8.0)
    trace = np.einsum("...ij,...ij->...", R_a, R_b)
    R = np.swapaxes(R_a, -1, -2) @ R_b
    skew = np.linalg.norm(R - np.swapaxes(R, -1, -2), axis=(-2, -1)) / np.sqrt(8.0)
    is_wide = half_chord > np.sqrt(0.5)
    half_cosine = np.where(
        is_wide, skew / (2.0 * np.where(is_wide, half_chord, 1.0)), np.sqrt(np.clip((trace + 1.0) / 4.0, 0.0, None))
    )
    return 2.0 * np.arctan2(half_chord, half_cosine)


def rotation_about(axis: Array, angle_rad: float) -> Array:
    """R (3,3) turning by `angle_rad` about `axis` (3,), right-hand rule (Rodrigues)."""
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle_rad) * skew + (1.0 - np.cos(angle_rad)) * (skew @ skew)


def orthonormalized(T_a_b: Array) -> Array:
    """T_a_b (4,4) with the rotation nearest to its own (Frobenius norm), as rounded to float32 or text it needs."""
    U, _, Vt = np.linalg.svd(T_a_b[:3, :3])
    return transform_from(U @ Vt, T_a_b[:3, 3])


def require_rigid(T_a_b: Array, *, name: str) -> Array:
    """T_a_b unchanged as float64 (4,4), or a ValueError saying how it is not a rigid transform."""
    T = np.asarray(T_a_b, dtype=float)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise ValueError(f"{name}: expected a finite 4x4 transform, got shape {T.shape}; check the file it is from")
    if np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-9:
        raise ValueError(f"{name}: expected the last row 0 0 0 1, got {T[3].tolist()}; is it stored transposed?")
    R = T[:3, :3]
    determinant = float(np.linalg.det(R))
    if np.abs(R.T @ R - np.eye(3)).max() > ORTHONORMAL_TOLERANCE or determinant < 0:
        raise ValueError(
            f"{name}: expected a rotation (orthonormal, determinant +1), got determinant {determinant:.6g}; "
            "if it carries a scale, divide by the cube root of the determinant first"
        )
    return T
