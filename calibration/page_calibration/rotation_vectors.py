"""Rotations as vectors: the axis, as long as the angle in radians (Rodrigues, theta-u)."""

from __future__ import annotations

import cv2
import numpy as np

from page_runtime.geometry import Array


def rotation_of(vector: Array) -> Array:
    """R (3,3) of a rotation vector (3,), radians."""
    return np.asarray(cv2.Rodrigues(np.asarray(vector, dtype=float).ravel())[0], dtype=float)


def vector_of(R: Array) -> Array:
    """Rotation vector (3,), radians, of R (3,3)."""
    return np.asarray(cv2.Rodrigues(np.ascontiguousarray(R, dtype=float))[0], dtype=float).ravel()
