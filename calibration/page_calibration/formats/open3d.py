"""Open3D's PinholeCameraIntrinsic and PinholeCameraParameters, and the camera_intrinsic.json of ReArtMix and recorders.

Matrices are lists column by column, so nine numbers read row by row are transposed. extrinsic maps world to camera.
depth_scale, millimetres a unit, is what recorders add (page_runtime/capture/color_depth.py). The pinhole has no lens.
Source: Open3D, PinholeCameraIntrinsic::ConvertToJsonValue.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration
from page_calibration.formats.contract import Format, Read
from page_calibration.formats.document import Document
from page_runtime.camera import Camera
from page_runtime.capture.documents import METRES_PER_MM, field, number, numbers
from page_runtime.geometry import Array, require_rigid
from page_runtime.lens import RawCamera

CAMERA, WORLD = "camera", "world"


def recognises_intrinsic(document: Document) -> bool:
    return document.has("intrinsic_matrix")


def recognises_parameters(document: Document) -> bool:
    return document.has("intrinsic", "extrinsic")


def read_intrinsic(document: Document) -> Read:
    """The one camera, in its own frame."""
    return Read((_camera(document, document.data, np.eye(4), CAMERA),))


def read_parameters(document: Document) -> Read:
    """The one camera, placed in the world."""
    where = f"{document.path}, extrinsic"
    T = require_rigid(np.reshape(numbers(document.data["extrinsic"], 16, where=where), (4, 4)).T, name=where)
    return Read((_camera(document, document.data["intrinsic"], T, WORLD),))


def _camera(document: Document, entry: Any, T_camera_world: Array, world: str) -> CalibratedCamera:
    where = str(document.path)
    stated = (entry.get("width"), entry.get("height")) if isinstance(entry, dict) else (None, None)
    size = None
    if stated != (None, None):
        width, height = numbers(list(stated), 2, where=f"{where}, size")
        size = int(width), int(height)
    size = document.size_of(size)
    K = np.reshape(
        numbers(field(entry, "intrinsic_matrix", where=where), 9, where=f"{where}, intrinsic_matrix"), (3, 3)
    ).T
    scale = entry.get("depth_scale")
    unit = None if scale is None else number(scale, where=f"{where}, depth_scale") * METRES_PER_MM
    return CalibratedCamera(CAMERA, world, RawCamera(Camera(K, *size, T_camera_world)), unit)


def _entry(camera: CalibratedCamera) -> dict[str, Any]:
    entry = {
        "width": camera.camera.width,
        "height": camera.camera.height,
        "intrinsic_matrix": camera.camera.K.T.ravel().tolist(),
    }
    unit = camera.depth_unit_m
    return entry if unit is None else entry | {"depth_scale": unit / METRES_PER_MM}


def write_intrinsic(calibration: Calibration) -> str:
    """camera_intrinsic.json: what Open3D and `page-runtime run` take for a folder of pictures."""
    return json.dumps(_entry(calibration.cameras[0]), indent=1) + "\n"


def write_parameters(calibration: Calibration) -> str:
    """A PinholeCameraParameters document."""
    camera = calibration.cameras[0]
    document = {
        "class_name": "PinholeCameraParameters",
        "extrinsic": camera.camera.T_camera_world.T.ravel().tolist(),
        "intrinsic": _entry(camera),
        "version_major": 1,
        "version_minor": 0,
    }
    return json.dumps(document, indent=1) + "\n"


INTRINSIC = Format(
    "open3d",
    "Open3D intrinsics (camera_intrinsic.json)",
    ".json",
    recognises_intrinsic,
    read_intrinsic,
    write_intrinsic,
)
PARAMETERS = Format(
    "open3d-parameters", "Open3D camera parameters", ".json", recognises_parameters, read_parameters, write_parameters
)
