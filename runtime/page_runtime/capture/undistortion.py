"""Pictures of a camera with a lens as an ideal pinhole of the same K would have taken them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.image_files import SourceError
from page_runtime.lens import ROS_MODELS, Distortion, DistortionModel, FixedMap, RawCamera, fixed_map


def lens_of(model: str, coefficients: Sequence[float], *, where: str) -> Distortion:
    """The lens that a recording names as ROS does; SourceError for a model that is none of lens.ROS_MODELS."""
    if model not in ROS_MODELS:
        raise SourceError(f"{where}: lens distortion of the model {model!r}; understood are {', '.join(ROS_MODELS)}")
    try:
        return Distortion(ROS_MODELS[model], np.array(coefficients, dtype=float))
    except ValueError as error:
        raise SourceError(f"{where}: {error}") from error


def undistorted(
    color: NDArray[np.uint8], depth_m: NDArray[np.float32], camera: Camera, distortion: Distortion
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Colour, and depth registered to it, as the pinhole `camera` sees them; unchanged without distortion.

    Colour is interpolated; depth takes the nearest reading, as a mean of two surfaces is on neither.
    """
    if distortion.is_none:
        return color, depth_m
    fixed, columns, rows = _maps(
        camera.K.tobytes(), camera.width, camera.height, distortion.model, distortion.coefficients.tobytes()
    )
    straight = cv2.remap(color, *fixed, cv2.INTER_LINEAR)
    nearest = cv2.remap(depth_m, columns, rows, cv2.INTER_NEAREST)
    return np.asarray(straight, np.uint8), np.asarray(nearest, np.float32)


@lru_cache(maxsize=4)
def _maps(
    K: bytes, width: int, height: int, model: DistortionModel, coefficients: bytes
) -> tuple[FixedMap, NDArray[np.float32], NDArray[np.float32]]:
    camera = Camera(np.frombuffer(K).reshape(3, 3), width, height)
    place = RawCamera(camera, Distortion(model, np.frombuffer(coefficients))).pixel_map(camera)
    return fixed_map(place), np.ascontiguousarray(place[..., 0]), np.ascontiguousarray(place[..., 1])
