"""The settings YAML of ORB-SLAM 2 and 3, which is how TUM RGB-D calibrations travel.

Camera.* (version 1.0 files: Camera1.*), k1 k2 p1 p2 [k3] or KannalaBrandt8, DepthMapFactor units of depth a metre (TUM:
5000). OpenCV's dialect, which YAML parsers refuse.
Source: ORB_SLAM2/Examples, ORB_SLAM3/Examples and its Calibration_Tutorial.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError
from page_calibration.formats.contract import Format, Read
from page_calibration.formats.document import Document
from page_runtime.camera import Camera
from page_runtime.capture.documents import field, number
from page_runtime.lens import Distortion, RawCamera

CAMERA = "camera"
_BROWN, _FISHEYE = ("k1", "k2", "p1", "p2", "k3"), ("k1", "k2", "k3", "k4")
_KANNALA_BRANDT = "KannalaBrandt8"


def recognises(document: Document) -> bool:
    return document.has("Camera.fx") or document.has("Camera1.fx")


def read(document: Document) -> Read:
    """The (first) camera, in its own frame."""
    where, data = str(document.path), document.data
    prefix = "Camera1" if "Camera1.fx" in data else "Camera"

    def value(name: str) -> float:
        return number(field(data, f"{prefix}.{name}", where=where), where=f"{where}, {prefix}.{name}")

    stated = [data.get(f"Camera.{name}") for name in ("width", "height")]
    size = None if None in stated else (int(stated[0] or 0), int(stated[1] or 0))
    K = np.array([[value("fx"), 0.0, value("cx")], [0.0, value("fy"), value("cy")], [0.0, 0.0, 1.0]])
    names = _FISHEYE if data.get("Camera.type") == _KANNALA_BRANDT else _BROWN
    coefficients = np.array([value(name) if f"{prefix}.{name}" in data else 0.0 for name in names])
    if names is _FISHEYE:
        lens = Distortion("kannala-brandt", coefficients)
    else:
        lens = Distortion("brown-conrady", coefficients) if coefficients.any() else Distortion()
    camera = Camera(K, *document.size_of(size))
    return Read((CalibratedCamera(CAMERA, CAMERA, RawCamera(camera, lens), _unit(data, where=where)),))


def _unit(data: dict[str, Any], *, where: str) -> float | None:
    for name in ("DepthMapFactor", "RGBD.DepthMapFactor"):
        if name in data:
            factor = number(data[name], where=f"{where}, {name}")
            if factor <= 0:
                raise CalibrationError(f"{where}, {name}: expected units of depth a metre, got {factor:g}")
            return 1.0 / factor
    return None


def write(calibration: Calibration) -> str:
    """The Camera.* fields and DepthMapFactor; the SLAM's own settings are its user's."""
    camera = calibration.cameras[0]
    lens, K = camera.raw.distortion, camera.camera.K
    names = _FISHEYE if lens.model == "kannala-brandt" else _BROWN
    coefficients = lens.coefficients.tolist()
    if any(coefficients[len(names) :]):
        raise CalibrationError(f"ORB-SLAM's lens ends at k3; {camera.frame!r} has {len(coefficients)} coefficients")
    coefficients = (coefficients + [0.0] * len(names))[: len(names)]
    values: dict[str, Any] = {
        "type": f'"{_KANNALA_BRANDT if names is _FISHEYE else "PinHole"}"',
        "fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2],
        **dict(zip(names, coefficients, strict=True)),
        "width": camera.camera.width, "height": camera.camera.height,
    }  # fmt: skip
    lines = ["%YAML:1.0", "---", *(f"Camera.{name}: {value}" for name, value in values.items())]
    if camera.depth_unit_m is not None:
        lines.append(f"DepthMapFactor: {1.0 / camera.depth_unit_m!r}")
    return "\n".join(lines) + "\n"


ORB_SLAM = Format("tum", "TUM / ORB-SLAM settings", ".yaml", recognises, read, write)
