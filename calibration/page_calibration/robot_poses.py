"""Poses of a robot's hand and of a target, from files.

    {"poses": [{"name": "000000", "T_base_hand": [[...], ...]}, ...]}      metres, one entry for each picture
    {"poses": [{"name": "000000", "T_camera_target": [[...], ...]}, ...]}

or a folder of ViSP pose files, one a pose: six numbers, translation in metres and theta-u rotation vector in radians.
Source: ViSP, vpPoseVector::saveYAML.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from page_calibration.calibration import CalibrationError
from page_calibration.camera_json import matrix, rigid
from page_calibration.formats.document import open_document
from page_calibration.rotation_vectors import rotation_of
from page_runtime.capture.documents import field, listed, numbers
from page_runtime.geometry import Array, transform_from

# Robots reach metres; millimetres come out a thousand times farther.
MAX_REACH_M = 20.0


def read_poses(path: Path, key: str) -> dict[str, Array]:
    """T (4,4) by name, in the file's order; key: T_base_hand or T_camera_target."""
    if path.is_dir():
        files = sorted(path.glob("*.yaml"), key=lambda file: _number(file.stem))
        if not files:
            raise CalibrationError(f"{path}: no pose files (.yaml) in this folder")
        return {str(_number(file.stem)): read_visp_pose(file) for file in files}
    document = open_document(path)
    if document.has("rows", "cols", "data"):
        return {str(_number(path.stem)): read_visp_pose(path)}
    poses: dict[str, Array] = {}
    for i, entry in enumerate(listed(field(document.data, "poses", where=str(path)), where=f"{path}, poses")):
        where = f"{path}, pose {i}"
        poses[str(entry.get("name", i))] = _checked(matrix(field(entry, key, where=where), 4, 4, where=where), where)
    return poses


def read_visp_pose(path: Path) -> Array:
    """T (4,4) of a ViSP pose file."""
    document = open_document(path)
    where = str(path)
    rows: Any = listed(field(document.data, "data", where=where), where=f"{where}, data")
    values = [row[0] if isinstance(row, list) and len(row) == 1 else row for row in rows]
    pose = np.array(numbers(values, 6, where=f"{where}, data"))
    return _checked(transform_from(rotation_of(pose[3:]), pose[:3]), where)


def _number(stem: str) -> int:
    digits = re.findall(r"\d+", stem)
    return int(digits[-1]) if digits else 0


def _checked(T: Array, where: str) -> Array:
    T = rigid(T, where=where)
    reach = float(np.linalg.norm(T[:3, 3]))
    if reach > MAX_REACH_M:
        raise CalibrationError(f"{where}: {reach:.4g} m away; expected metres, these are probably millimetres")
    return T
