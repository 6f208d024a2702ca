"""BOP: camera.json of a data set and scene_camera.json of a scene.

cam_K is row by row, cam_t_w2c millimetres, depth_scale millimetres a unit of depth. A scene's document has a camera for
every frame and no size: that is read from the pictures beside it. Pictures have no distortion.
Source: BOP toolkit, docs/bop_datasets_format.md.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration
from page_calibration.formats.contract import Format, Read
from page_calibration.formats.document import Document, Size
from page_runtime.camera import Camera
from page_runtime.capture.documents import METRES_PER_MM, field, number, numbers
from page_runtime.geometry import require_rigid, transform_from
from page_runtime.image_files import COLOR_SUFFIXES, read_header
from page_runtime.lens import RawCamera

CAMERA, WORLD = "camera", "world"


def recognises_camera(document: Document) -> bool:
    return document.has("fx", "fy", "cx", "cy")


def recognises_scene(document: Document) -> bool:
    data = document.data
    return isinstance(data, dict) and bool(data) and all(isinstance(e, dict) and "cam_K" in e for e in data.values())


def read_camera(document: Document) -> Read:
    """The data set's camera, in its own frame."""
    where, data = str(document.path), document.data
    fx, fy, cx, cy = numbers([data[name] for name in ("fx", "fy", "cx", "cy")], 4, where=where)
    stated = [data.get(name) for name in ("width", "height")]
    size = None
    if None not in stated:
        width, height = numbers(stated, 2, where=f"{where}, size")
        size = int(width), int(height)
    camera = Camera(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), *document.size_of(size))
    return Read((CalibratedCamera(CAMERA, CAMERA, RawCamera(camera), _unit(data, where=where)),))


def read_scene(document: Document) -> Read:
    """A camera for each frame, named by the frame's number; one alone when all are the same."""
    cameras = []
    for key, entry in document.data.items():
        where = f"{document.path}, frame {key}"
        K = np.reshape(numbers(entry["cam_K"], 9, where=f"{where}, cam_K"), (3, 3))
        T, world = np.eye(4), key
        if "cam_R_w2c" in entry:
            R = np.reshape(numbers(entry["cam_R_w2c"], 9, where=f"{where}, cam_R_w2c"), (3, 3))
            t_mm = numbers(field(entry, "cam_t_w2c", where=where), 3, where=f"{where}, cam_t_w2c")
            T, world = require_rigid(transform_from(R, np.array(t_mm) * METRES_PER_MM), name=where), WORLD
        size = document.size_of(_size_beside(document, key), hint=", or keep rgb/ beside it")
        cameras.append(CalibratedCamera(key, world, RawCamera(Camera(K, *size, T)), _unit(entry, where=where)))
    return Read(tuple(cameras))


def _unit(entry: dict[str, Any], *, where: str) -> float | None:
    scale = entry.get("depth_scale")
    return None if scale is None else number(scale, where=f"{where}, depth_scale") * METRES_PER_MM


def _size_beside(document: Document, key: str) -> Size | None:
    """The size of frame `key`'s colour picture in rgb/ beside the document."""
    for suffix in COLOR_SUFFIXES if key.isdigit() else ():
        picture = document.path.parent / "rgb" / f"{int(key):06d}{suffix}"
        if picture.is_file():
            header = read_header(picture)
            return header.width, header.height
    return None


def write_camera(calibration: Calibration) -> str:
    """camera.json of a data set."""
    camera = calibration.cameras[0]
    K = camera.camera.K
    document = {
        "cx": K[0, 2], "cy": K[1, 2], "fx": K[0, 0], "fy": K[1, 1],
        "height": camera.camera.height, "width": camera.camera.width,
    }  # fmt: skip
    return json.dumps(document | _scale(camera), indent=1) + "\n"


def write_scene(calibration: Calibration) -> str:
    """scene_camera.json: a frame for each camera, numbered from 0 unless they have numbers for names."""
    numbered = all(frame.isdigit() for frame in calibration.frames)
    document = {}
    for i, camera in enumerate(calibration):
        entry: dict[str, Any] = {"cam_K": camera.camera.K.ravel().tolist()} | _scale(camera)
        if camera.world_frame != camera.frame:
            T = camera.camera.T_camera_world
            entry["cam_R_w2c"], entry["cam_t_w2c"] = T[:3, :3].ravel().tolist(), (T[:3, 3] / METRES_PER_MM).tolist()
        document[camera.frame if numbered else str(i)] = entry
    return json.dumps(document, indent=1) + "\n"


def _scale(camera: CalibratedCamera) -> dict[str, float]:
    return {} if camera.depth_unit_m is None else {"depth_scale": camera.depth_unit_m / METRES_PER_MM}


DATASET = Format("bop", "BOP camera", ".json", recognises_camera, read_camera, write_camera)
SCENE = Format("bop-scene", "BOP scene cameras", ".json", recognises_scene, read_scene, write_scene)
