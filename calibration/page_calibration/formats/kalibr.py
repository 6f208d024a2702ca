"""Kalibr's camchain YAML: cam0, cam1, ... of one rig, with or without an IMU.

T_cn_cnm1 maps from the camera before, T_cam_imu from the IMU; metres. intrinsics are [fu, fv, pu, pv] of a pinhole.
radtan is Brown-Conrady's k1 k2 p1 p2, equidistant Kannala-Brandt's k1 to k4.
Source: Kalibr wiki, yaml formats.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError
from page_calibration.camera_json import matrix
from page_calibration.formats.contract import Format, Read
from page_calibration.formats.document import Document
from page_runtime.camera import Camera
from page_runtime.capture.documents import field, numbers
from page_runtime.geometry import Array, invert, require_rigid, rotation_angle
from page_runtime.lens import Distortion, DistortionModel, RawCamera

MODELS: dict[str, DistortionModel] = {"radtan": "brown-conrady", "equidistant": "kannala-brandt", "none": "none"}
IMU = "imu"
# Between a chain over cameras and the places in the IMU's frame; Kalibr rounds neither.
MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_DEG = 1e-3, 0.1
_KNOWN = {
    "camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "resolution", "T_cn_cnm1", "T_cam_imu",
}  # fmt: skip


def recognises(document: Document) -> bool:
    return document.has("cam0") and isinstance(document.data["cam0"], dict)


def read(document: Document) -> Read:
    """All cameras, placed in the IMU's frame where it is known, else in the first camera's."""
    where = str(document.path)
    names = [name for name in document.data if name.startswith("cam") and name[3:].isdigit()]
    names.sort(key=lambda name: int(name[3:]))
    entries = {name: document.data[name] for name in names}
    has_imu = all("T_cam_imu" in entry for entry in entries.values())
    T_camera_world, world = np.eye(4), names[0]
    cameras: list[CalibratedCamera] = []
    warnings: list[str] = []
    for i, (name, entry) in enumerate(entries.items()):
        here = f"{where}, {name}"
        T_chain = _rigid(entry, "T_cn_cnm1", where=here) if "T_cn_cnm1" in entry else None
        if has_imu:
            T_here, world = _rigid(entry, "T_cam_imu", where=here), IMU
            if T_chain is not None and i:
                warnings += _disagreement(T_here, T_chain @ T_camera_world, name)
            T_camera_world = T_here
        elif i and T_chain is None:
            raise CalibrationError(f"{here}: no T_cn_cnm1 and no T_cam_imu; nothing says where it is")
        elif T_chain is not None and i:
            T_camera_world = T_chain @ T_camera_world
        cameras.append(CalibratedCamera(name, world, _raw(entry, T_camera_world, where=here)))
    notes = tuple(
        f"{name}: {key} {value} is not kept"
        for name, entry in entries.items()
        for key, value in entry.items()
        if key not in _KNOWN and value not in ([], None)
    )
    return Read(tuple(cameras), notes, tuple(warnings))


def _rigid(entry: Any, key: str, *, where: str) -> Array:
    return require_rigid(matrix(field(entry, key, where=where), 4, 4, where=f"{where}, {key}"), name=f"{where}, {key}")


def _raw(entry: Any, T_camera_world: Array, *, where: str) -> RawCamera:
    model = field(entry, "camera_model", where=where)
    if model != "pinhole":
        raise CalibrationError(f"{where}: camera_model {model!r}; only pinhole cameras have a K")
    lens = field(entry, "distortion_model", where=where)
    if lens not in MODELS:
        raise CalibrationError(f"{where}: distortion_model {lens!r} is none of {', '.join(MODELS)}")
    fu, fv, pu, pv = numbers(field(entry, "intrinsics", where=where), 4, where=f"{where}, intrinsics")
    width, height = numbers(field(entry, "resolution", where=where), 2, where=f"{where}, resolution")
    count = 0 if lens == "none" else 4
    coefficients = numbers(entry.get("distortion_coeffs", []), count, where=f"{where}, distortion_coeffs")
    K = np.array([[fu, 0.0, pu], [0.0, fv, pv], [0.0, 0.0, 1.0]])
    camera = Camera(K, int(width), int(height), T_camera_world)
    return RawCamera(camera, Distortion(MODELS[lens], np.array(coefficients)))


def _disagreement(T_a: Array, T_b: Array, name: str) -> list[str]:
    difference = T_a @ invert(T_b)
    metres = float(np.linalg.norm(difference[:3, 3]))
    degrees = float(np.degrees(rotation_angle(T_a[:3, :3], T_b[:3, :3])))
    if metres <= MAX_DISAGREEMENT_M and degrees <= MAX_DISAGREEMENT_DEG:
        return []
    return [
        f"{name}: T_cam_imu and T_cn_cnm1 disagree by {metres * 1e3:.2f} mm and {degrees:.2f} degrees; T_cam_imu used"
    ]


def write(calibration: Calibration) -> str:
    """The chain; places in a world of another name than the IMU's are written as T_cn_cnm1 alone."""
    lines: list[str] = []
    before: CalibratedCamera | None = None
    for i, camera in enumerate(calibration):
        lens, K = camera.raw.distortion, camera.camera.K
        lines.append(f"cam{i}:")
        if camera.world_frame == IMU:
            lines += _rows("T_cam_imu", camera.camera.T_camera_world)
        if before is not None:
            lines += _rows("T_cn_cnm1", calibration.transform(camera.frame, before.frame))
        coefficients = lens.coefficients.tolist()
        if lens.model == "brown-conrady":
            if any(coefficients[4:]):
                raise CalibrationError(
                    f"Kalibr's radtan ends at p2; {camera.frame!r} has {len(coefficients)} coefficients"
                )
            coefficients = coefficients[:4]
        elif lens.model == "none":
            coefficients = [0.0] * 4
        lines += [
            "  camera_model: pinhole",
            f"  distortion_coeffs: {coefficients}",
            f"  distortion_model: {'equidistant' if lens.model == 'kannala-brandt' else 'radtan'}",
            f"  intrinsics: {[K[0, 0].item(), K[1, 1].item(), K[0, 2].item(), K[1, 2].item()]}",
            f"  resolution: [{camera.camera.width}, {camera.camera.height}]",
            f"  rostopic: /{camera.frame.replace(' ', '_')}/image_raw",
        ]
        before = camera
    return "\n".join(lines) + "\n"


def _rows(key: str, T: Array) -> list[str]:
    return [f"  {key}:", *(f"  - {row}" for row in T.tolist())]


KALIBR = Format("kalibr", "Kalibr camchain", ".yaml", recognises, read, write)
