"""ROS camera_info: the YAML of camera_calibration_parsers, the message as YAML or JSON, and Videre's INI.

K and D are the raw picture's. R turns the camera into the rectified pair's axes, P projects from the pair's common
frame into the rectified picture, and P[3] = -f B for the right one:
X_rectified = R X_camera = X_pair + (P[3] / P[0], 0, 0).
So a camera's place in the pair is exact; P's own focal length belongs to the rectified picture and is only noted.
Sources: sensor_msgs/CameraInfo; image_common, camera_calibration_parsers.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError
from page_calibration.camera_json import matrix
from page_calibration.formats.contract import Format, Read
from page_calibration.formats.document import Document
from page_runtime.camera import Camera
from page_runtime.capture.documents import field, listed, number, numbers
from page_runtime.geometry import Array, invert, require_rigid, transform_from
from page_runtime.lens import ROS_MODELS, Distortion, RawCamera

PAIR = "rectified pair"
_PARSER_FIELDS = {
    "K": "camera_matrix", "D": "distortion_coefficients", "R": "rectification_matrix", "P": "projection_matrix",
}  # fmt: skip


def recognises_yaml(document: Document) -> bool:
    return document.has("image_width", "image_height", "camera_matrix", "projection_matrix")


def recognises_message(document: Document) -> bool:
    return document.has("distortion_model") and (document.has("K", "D") or document.has("k", "d"))


def recognises_ini(document: Document) -> bool:
    return isinstance(document.data, dict) and isinstance(document.data.get("image"), dict) and len(document.data) > 1


def read_yaml(document: Document) -> Read:
    """The one camera; camera_name is its frame."""
    where, data = str(document.path), document.data
    values = {
        name: numbers_of(data.get(key), where=f"{where}, {key}") for name, key in _PARSER_FIELDS.items() if key in data
    }
    size = _size(document, data, "image_width", "image_height")
    model = data.get("distortion_model", "plumb_bob")
    return _read(values, str(data.get("camera_name") or "camera"), str(model), size, where=where)


def read_message(document: Document) -> Read:
    """The one camera; header.frame_id is its frame. Region and binning of the delivered picture are applied to K."""
    where, data = str(document.path), document.data
    values = {
        name: numbers_of(data.get(name, data.get(name.lower(), [])), where=f"{where}, {name}")
        for name in _PARSER_FIELDS
    }
    header = data.get("header")
    frame = header.get("frame_id") if isinstance(header, dict) else None
    size = _size(document, data, "width", "height")
    read = _read(values, str(frame or "camera"), str(data["distortion_model"]), size, where=where)
    return _delivered(read, data, where=where)


def read_ini(document: Document) -> Read:
    """The one camera; the second section's name is its frame."""
    where = str(document.path)
    image = document.data["image"]
    frame = next(name for name in document.data if name not in ("image", "externals"))
    section = document.data[frame]

    def values(name: str, *, of: dict[str, list[str]]) -> list[float]:
        try:
            return [float(value) for line in field(of, name, where=where) for value in line.split()]
        except ValueError as error:
            raise CalibrationError(f"{where}, {name}: expected numbers ({error})") from error

    width, height = values("width", of=image), values("height", of=image)
    if len(width) != 1 or len(height) != 1:
        raise CalibrationError(f"{where}: expected one width and one height, got {width} and {height}")
    coefficients = values("distortion", of=section)
    if len(coefficients) == 8 and coefficients[5:] == [0.0, 0.0, 0.0]:
        coefficients = coefficients[:5]
    return _read(
        {
            "K": values("camera matrix", of=section),
            "D": coefficients,
            "R": values("rectification", of=section),
            "P": values("projection", of=section),
        },
        frame,
        "rational_polynomial" if len(coefficients) == 8 else "plumb_bob",
        document.size_of((int(width[0]), int(height[0]))),
        where=where,
    )


def numbers_of(value: Any, *, where: str) -> list[float]:
    """The numbers of a list, or of a matrix given as rows, cols and data."""
    values = value.get("data") if isinstance(value, dict) else value
    return numbers(values, len(listed(values, where=where)), where=where)


def _size(document: Document, data: dict[str, Any], width: str, height: str) -> tuple[int, int]:
    values = (number(data.get(name), where=f"{document.path}, {name}") for name in (width, height))
    w, h = (int(value) for value in values)
    if (w, h) == (0, 0):
        raise CalibrationError(
            f"{document.path}: the size is 0x0: the driver sent camera_info of an uncalibrated camera"
        )
    return document.size_of((w, h))


def _read(values: dict[str, list[float]], frame: str, model: str, size: tuple[int, int], *, where: str) -> Read:
    K = matrix(values.get("K", []), 3, 3, where=f"{where}, K")
    if not K.any():
        raise CalibrationError(f"{where}: K is all zeros, which in ROS means that the camera is not calibrated")
    coefficients = values.get("D", [])
    if model and model not in ROS_MODELS:
        raise CalibrationError(f"{where}: distortion_model {model!r} is none of {', '.join(ROS_MODELS)}")
    lens = Distortion(ROS_MODELS[model], np.array(coefficients)) if model and coefficients else Distortion()
    T_camera_pair, notes = _place(values, where=where)
    world = frame if T_camera_pair is None else PAIR
    T = np.eye(4) if T_camera_pair is None else T_camera_pair
    camera = Camera(K, *size, T)
    return Read((CalibratedCamera(frame, world, RawCamera(camera, lens)),), notes)


def _place(values: dict[str, list[float]], *, where: str) -> tuple[Array | None, tuple[str, ...]]:
    """(T_camera_pair, None for a camera that is no part of one; what is not kept) of R and P."""
    R = matrix(values["R"], 3, 3, where=f"{where}, R") if any(values.get("R", ())) else np.eye(3)
    P = matrix(values["P"], 3, 4, where=f"{where}, P") if any(values.get("P", ())) else None
    if P is not None and np.array_equal(P, np.eye(3, 4)):
        return None, ("P is the identity and was not used",)
    offset = 0.0 if P is None else P[0, 3] / P[0, 0]
    notes = ()
    if P is not None and not np.allclose(P[:, :3], matrix(values["K"], 3, 3, where=where), atol=1e-6):
        notes = (f"P of the rectified picture (f {P[0, 0]:.6g} px, centre {P[0, 2]:.6g}, {P[1, 2]:.6g}) is not kept",)
    if np.array_equal(R, np.eye(3)) and offset == 0.0:
        return None, notes
    T_rectified_camera = require_rigid(transform_from(R, np.array([-offset, 0.0, 0.0])), name=f"{where}, R")
    return invert(T_rectified_camera), notes


def _delivered(read: Read, data: dict[str, Any], *, where: str) -> Read:
    roi = data.get("roi") or {}
    x, y, width, height = (
        int(number(roi.get(name, 0), where=f"{where}, roi.{name}"))
        for name in ("x_offset", "y_offset", "width", "height")
    )
    binning = [max(1, int(number(data.get(f"binning_{axis}", 0), where=f"{where}, binning_{axis}"))) for axis in "xy"]
    if not any((x, y, width, height)) and binning == [1, 1]:
        return read
    calibrated = read.cameras[0]
    raw = calibrated.raw.cropped(x, y, width or calibrated.camera.width, height or calibrated.camera.height)
    raw = raw.resized(raw.camera.width // binning[0], raw.camera.height // binning[1])
    camera = CalibratedCamera(calibrated.frame, calibrated.world_frame, raw)
    note = f"K is that of the delivered picture: region {x},{y} {width}x{height}, binning {binning[0]}x{binning[1]}"
    return Read((camera,), (*read.notes, note))


def _fields(camera: CalibratedCamera) -> tuple[dict[str, list[float]], str]:
    """(K, D, R, P row by row; distortion model) of a camera."""
    lens, K = camera.raw.distortion, camera.camera.K
    model = "equidistant" if lens.model == "kannala-brandt" else "plumb_bob"
    coefficients = lens.coefficients.tolist()
    if lens.model == "brown-conrady":
        if len(coefficients) > 8 and any(coefficients[8:]):
            raise CalibrationError(
                f"ROS has no thin prisms and tilts; {camera.frame!r} has {len(coefficients)} coefficients"
            )
        kept = 5 if not any(coefficients[5:]) else 8
        coefficients = (coefficients + [0.0] * kept)[:kept]
        model = "rational_polynomial" if kept == 8 else "plumb_bob"
    T_pair_camera = invert(camera.camera.T_camera_world)
    P = np.hstack([K, np.zeros((3, 1))])
    P[0, 3] = -K[0, 0] * T_pair_camera[0, 3]
    R = T_pair_camera[:3, :3]
    fields = {"K": K.ravel(), "R": R.ravel(), "P": P.ravel()}
    return {name: value.tolist() for name, value in fields.items()} | {"D": coefficients or [0.0] * 5}, model


def write_yaml(calibration: Calibration) -> str:
    """The YAML that camera_info_manager loads."""
    camera = calibration.cameras[0]
    values, model = _fields(camera)
    shapes = {"K": (3, 3), "D": (1, len(values["D"])), "R": (3, 3), "P": (3, 4)}
    lines = [
        f"image_width: {camera.camera.width}",
        f"image_height: {camera.camera.height}",
        f"camera_name: {json.dumps(camera.frame)}",
    ]
    for name in ("K", "D", "R", "P"):
        if name == "D":
            lines.append(f"distortion_model: {model}")
        rows, columns = shapes[name]
        lines += [f"{_PARSER_FIELDS[name]}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: {values[name]}"]
    return "\n".join(lines) + "\n"


def write_message(calibration: Calibration) -> str:
    """The fields of sensor_msgs/CameraInfo as JSON, named as in ROS 1 and in Isaac ROS."""
    camera = calibration.cameras[0]
    values, model = _fields(camera)
    document = {
        "header": {"frame_id": camera.frame},
        "width": camera.camera.width,
        "height": camera.camera.height,
        "distortion_model": model,
        **{name: values[name] for name in ("D", "K", "R", "P")},
    }
    return json.dumps(document, indent=1) + "\n"


def write_ini(calibration: Calibration) -> str:
    """Videre's INI. It knows no fisheye."""
    camera = calibration.cameras[0]
    values, model = _fields(camera)
    if model == "equidistant":
        raise CalibrationError(f"Videre's INI has no fisheye lens, which {camera.frame!r} has; choose ros")

    def rows(name: str, columns: int) -> list[str]:
        return [" ".join(map(repr, row)) for row in np.reshape(values[name], (-1, columns)).tolist()]

    lines = ["[image]", "", "width", str(camera.camera.width), "", "height", str(camera.camera.height), ""]
    lines += [f"[{camera.frame}]", "", "camera matrix", *rows("K", 3), "", "distortion", *rows("D", len(values["D"]))]
    lines += ["", "rectification", *rows("R", 3), "", "projection", *rows("P", 4)]
    return "\n".join(lines) + "\n"


ROS_YAML = Format("ros", "ROS camera_info YAML", ".yaml", recognises_yaml, read_yaml, write_yaml)
ROS_MESSAGE = Format("ros-json", "ROS camera_info message", ".json", recognises_message, read_message, write_message)
ROS_INI = Format("ros-ini", "Videre INI", ".ini", recognises_ini, read_ini, write_ini)
