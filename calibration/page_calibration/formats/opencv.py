"""cv2.FileStorage as OpenCV's calibration sample writes it: camera_matrix, distortion_coefficients, image_width ...

The sample's extrinsic_parameters are the board's places in each view, in units of square_size, and no property of the
camera. FileStorage holds any name, so a camera's own place is written as T_camera_world beside camera_name,
world_frame and depth_unit_m.
Source: OpenCV, samples/cpp/tutorial_code/calib3d/camera_calibration.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration
from page_calibration.camera_json import matrix
from page_calibration.formats.contract import Format, Read
from page_calibration.formats.document import Document
from page_calibration.formats.ros import numbers_of
from page_runtime.camera import Camera
from page_runtime.capture.documents import number
from page_runtime.geometry import Array, require_rigid
from page_runtime.lens import Distortion, RawCamera

CAMERA = "camera"
K_NAMES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "M1")
D_NAMES = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "Distortion_Coefficients", "D", "D1")
_USED = {"image_width", "image_height", "fisheye_model", "camera_name", "world_frame", "depth_unit_m", "T_camera_world"}


def recognises(document: Document) -> bool:
    matrices = (document.data.get(name) for name in K_NAMES) if isinstance(document.data, dict) else ()
    return any(isinstance(value, dict) and "data" in value for value in matrices)


def read(document: Document) -> Read:
    """The one camera."""
    where, data = str(document.path), document.data
    name = next(name for name in K_NAMES if name in data)
    K = matrix(numbers_of(data[name], where=f"{where}, {name}"), 3, 3, where=f"{where}, {name}")
    lens_name = next((name for name in D_NAMES if name in data), None)
    coefficients = [] if lens_name is None else numbers_of(data[lens_name], where=f"{where}, {lens_name}")
    if data.get("fisheye_model"):
        lens = Distortion("kannala-brandt", np.array(coefficients))
    else:
        lens = Distortion("brown-conrady", np.array(coefficients)) if any(coefficients) else Distortion()
    stated = [data.get(name) for name in ("image_width", "image_height")]
    size = document.size_of(None if None in stated else (int(stated[0] or 0), int(stated[1] or 0)))
    frame = str(data.get("camera_name", CAMERA))
    T = np.eye(4)
    if "T_camera_world" in data:
        here = f"{where}, T_camera_world"
        T = require_rigid(matrix(numbers_of(data["T_camera_world"], where=here), 4, 4, where=here), name=here)
    unit = data.get("depth_unit_m")
    camera = CalibratedCamera(
        frame,
        str(data.get("world_frame", frame)),
        RawCamera(Camera(K, *size, T), lens),
        None if unit is None else number(unit, where=f"{where}, depth_unit_m"),
    )
    notes = tuple(f"{key} is not kept" for key in data if key not in {name, lens_name} | _USED)
    return Read((camera,), notes)


def write(calibration: Calibration) -> str:
    """The sample's names, so that programs written after it read K, distortion and size."""
    camera = calibration.cameras[0]
    lens = camera.raw.distortion
    lines = [
        "%YAML:1.0",
        "---",
        f"camera_name: {json.dumps(camera.frame)}",
        f"world_frame: {json.dumps(camera.world_frame)}",
        f"image_width: {camera.camera.width}",
        f"image_height: {camera.camera.height}",
        f"fisheye_model: {int(lens.model == 'kannala-brandt')}",
        *_matrix("camera_matrix", camera.camera.K),
        *_matrix("distortion_coefficients", lens.coefficients[:, None] if len(lens.coefficients) else np.zeros((5, 1))),
        *_matrix("T_camera_world", camera.camera.T_camera_world),
    ]
    if camera.depth_unit_m is not None:
        lines.append(f"depth_unit_m: {camera.depth_unit_m!r}")
    return "\n".join(lines) + "\n"


def _matrix(name: str, values: Array) -> list[str]:
    rows, columns = values.shape
    data: list[Any] = values.ravel().tolist()
    # One line of text holds at most some thousand characters in OpenCV's own parser.
    text = ", ".join(map(repr, data))
    return [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d", f"   data: [ {text} ]"]


OPENCV = Format("opencv", "OpenCV FileStorage", ".yaml", recognises, read, write)
