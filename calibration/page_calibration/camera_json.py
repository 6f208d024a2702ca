"""camera.json: the one form all calibrations are brought to. Metres, radians, pixels; OpenCV axes; closed and
versioned.

    {"format": "page-edge camera", "version": 1,
     "cameras": [{
       "frame": "color",              the camera's name
       "world_frame": "depth",        what T_camera_world maps from
       "size_px": [1280, 720],
       "K": [[fx, s, cx], [0, fy, cy], [0, 0, 1]],
       "distortion": {"model": "none" | "brown-conrady" | "kannala-brandt", "coefficients": [...]},
       "T_camera_world": 4x4 rows, metres,
       "depth_unit_m": 0.001 | null,  of its depth pictures
       "standard_deviations": {...} | null}],
     "provenance": {"format", "source", "notes", "warnings"}}

Pixel centres are integers. M = K [R | t] is not stored: it follows, and alone it would lose the size.
"""

from __future__ import annotations

import json
from dataclasses import fields
from typing import Any

import numpy as np

from page_calibration.calibration import CalibratedCamera, Calibration, CalibrationError, Deviations, Provenance
from page_runtime.camera import Camera
from page_runtime.capture.documents import field, listed, number, numbers
from page_runtime.geometry import Array, require_rigid
from page_runtime.lens import Distortion, RawCamera

FORMAT = "page-edge camera"
VERSION = 1
_CAMERA_FIELDS = (
    "frame", "world_frame", "size_px", "K", "distortion", "T_camera_world", "depth_unit_m", "standard_deviations",
)  # fmt: skip


def to_json(calibration: Calibration) -> str:
    """The document; `from_json` gives back the same numbers, to the bit."""
    provenance = calibration.provenance
    document = {
        "format": FORMAT,
        "version": VERSION,
        "cameras": [_camera_entry(camera) for camera in calibration],
        "provenance": {
            "format": provenance.format,
            "source": provenance.source,
            "notes": list(provenance.notes),
            "warnings": list(provenance.warnings),
        },
    }
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _camera_entry(camera: CalibratedCamera) -> dict[str, Any]:
    deviations = camera.deviations
    return {
        "frame": camera.frame,
        "world_frame": camera.world_frame,
        "size_px": [camera.camera.width, camera.camera.height],
        "K": camera.camera.K.tolist(),
        "distortion": {
            "model": camera.raw.distortion.model,
            "coefficients": camera.raw.distortion.coefficients.tolist(),
        },
        "T_camera_world": camera.camera.T_camera_world.tolist(),
        "depth_unit_m": camera.depth_unit_m,
        "standard_deviations": None
        if deviations is None
        else {
            one.name: None if getattr(deviations, one.name) is None else getattr(deviations, one.name).tolist()
            for one in fields(deviations)
        },
    }


def from_document(document: dict[str, Any], *, where: str) -> Calibration:
    """The calibration of a parsed camera.json; errors name the field."""
    _closed(document, ("format", "version", "cameras", "provenance"), where=where)
    version = field(document, "version", where=where)
    if version != VERSION:
        raise CalibrationError(f"{where}: expected version {VERSION}, got {version}; read it with its own release")
    cameras = listed(field(document, "cameras", where=where), where=f"{where}, cameras")
    provenance = field(document, "provenance", where=where)
    _closed(provenance, ("format", "source", "notes", "warnings"), where=f"{where}, provenance")
    return Calibration(
        tuple(_camera_of(entry, where=f"{where}, camera {i}") for i, entry in enumerate(cameras)),
        Provenance(
            _text(provenance, "format", where=f"{where}, provenance"),
            _text(provenance, "source", where=f"{where}, provenance"),
            tuple(map(str, listed(field(provenance, "notes", where=where), where=f"{where}, notes"))),
            tuple(map(str, listed(field(provenance, "warnings", where=where), where=f"{where}, warnings"))),
        ),
    )


def _camera_of(entry: Any, *, where: str) -> CalibratedCamera:
    _closed(entry, _CAMERA_FIELDS, where=where)
    width, height = numbers(field(entry, "size_px", where=where), 2, where=f"{where}, size_px")
    distortion = field(entry, "distortion", where=where)
    _closed(distortion, ("model", "coefficients"), where=f"{where}, distortion")
    coefficients = listed(field(distortion, "coefficients", where=where), where=f"{where}, coefficients")
    unit = field(entry, "depth_unit_m", where=where)
    try:
        camera = Camera(
            matrix(field(entry, "K", where=where), 3, 3, where=f"{where}, K"),
            round(width),
            round(height),
            matrix(field(entry, "T_camera_world", where=where), 4, 4, where=f"{where}, T_camera_world"),
        )
        lens = Distortion(
            field(distortion, "model", where=where),
            np.array(numbers(coefficients, len(coefficients), where=f"{where}, coefficients")),
        )
    except ValueError as error:
        raise CalibrationError(f"{where}: {error}") from error
    return CalibratedCamera(
        _text(entry, "frame", where=where),
        _text(entry, "world_frame", where=where),
        RawCamera(camera, lens),
        None if unit is None else number(unit, where=f"{where}, depth_unit_m"),
        _deviations(field(entry, "standard_deviations", where=where), len(lens.coefficients), where=where),
    )


def _deviations(entry: Any, coefficients: int, *, where: str) -> Deviations | None:
    if entry is None:
        return None
    where = f"{where}, standard_deviations"
    counts = {"intrinsics_px": 4, "distortion": coefficients, "rotation_rad": 3, "translation_m": 3}
    _closed(entry, tuple(counts), where=where)
    return Deviations(**{
        name: None if entry.get(name) is None else np.array(numbers(entry[name], count, where=f"{where}, {name}"))
        for name, count in counts.items()
    })  # fmt: skip


def matrix(value: Any, rows: int, columns: int, *, where: str) -> Array:
    """A (rows, columns) matrix given as rows, or as all its numbers row by row."""
    if isinstance(value, list) and len(value) == rows and all(isinstance(row, list) for row in value):
        return np.array([numbers(row, columns, where=where) for row in value])
    return np.reshape(numbers(value, rows * columns, where=where), (rows, columns))


def rigid(T: Array, *, where: str) -> Array:
    """T (4,4) unchanged; CalibrationError when it is not a rotation and a translation."""
    try:
        return require_rigid(T, name=where)
    except ValueError as error:
        raise CalibrationError(str(error)) from error


def _text(entry: Any, name: str, *, where: str) -> str:
    value = field(entry, name, where=where)
    if not isinstance(value, str) or not value:
        raise CalibrationError(f"{where}, {name}: expected a name, got {value!r}")
    return value


def _closed(entry: Any, names: tuple[str, ...], *, where: str) -> None:
    if not isinstance(entry, dict):
        raise CalibrationError(f"{where}: expected a JSON object, got {type(entry).__name__}")
    unknown = sorted(set(entry) - set(names))
    if unknown:
        raise CalibrationError(f"{where}: unknown field {unknown[0]!r}; version {VERSION} has {', '.join(names)}")
