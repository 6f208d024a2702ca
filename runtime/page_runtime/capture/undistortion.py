"""Pictures of a camera with lens distortion as an ideal pinhole would have taken them.

Models are OpenCV's, which ROS names plumb_bob, rational_polynomial and equidistant. K stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.image_files import SourceError

FISHEYE = "equidistant"
MODELS = ("plumb_bob", "rational_polynomial", FISHEYE)


@dataclass(frozen=True, slots=True)
class Distortion:
    """model: one of MODELS. coefficients: in OpenCV's order."""

    model: str
    coefficients: tuple[float, ...]


def undistorted(
    color: NDArray[np.uint8], depth_m: NDArray[np.float32], camera: Camera, distortion: Distortion | None
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Colour, and depth registered to it, as the pinhole `camera` sees them; unchanged without distortion.

    Colour is interpolated; depth takes the nearest reading, as a mean of two surfaces is on neither.
    """
    if distortion is None or not any(distortion.coefficients):
        return color, depth_m
    columns, rows = _maps(camera.K.tobytes(), camera.width, camera.height, distortion)
    straight = cv2.remap(color, columns, rows, cv2.INTER_LINEAR)
    nearest = cv2.remap(depth_m, columns, rows, cv2.INTER_NEAREST)
    return np.asarray(straight, np.uint8), np.asarray(nearest, np.float32)


@lru_cache(maxsize=4)
def _maps(K_bytes: bytes, width: int, height: int, distortion: Distortion) -> tuple[np.ndarray, np.ndarray]:
    K = np.frombuffer(K_bytes).reshape(3, 3)
    coefficients = np.array(distortion.coefficients)
    size = width, height
    if distortion.model == FISHEYE:
        return cv2.fisheye.initUndistortRectifyMap(K, coefficients, np.eye(3), K, size, cv2.CV_32FC1)
    if distortion.model not in MODELS:
        known = ", ".join(MODELS)
        raise SourceError(f"lens distortion of the model {distortion.model!r}; understood are {known}")
    return cv2.initUndistortRectifyMap(K, coefficients, np.eye(3), K, size, cv2.CV_32FC1)
