"""A TOML file that names the mesh of each part and says how the joints move them.

unit = "mm"                      # of meshes and points here; metres where not said
up = "y"                         # the axis of the meshes that points up; z where not said

[[part]]                         # the first is the one no joint moves
name = "frame"
mesh = "frame.stl"               # OBJ, STL, PLY, GLB, ...; all in one frame, as they stand at state 0

[[part]]
name = "door"
mesh = ["door.stl", "handle.obj"]

[[joint]]
name = "hinge"
parent = "frame"
child = "door"
kind = "revolute"                # or "prismatic"
axis = [0, 0, 1]
point = [-400, 0, 0]             # any point of the axis
limits_deg = [0, 110]            # limits_m for a prismatic joint
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.category import JointKind
from page_runtime.geometry import Array, transform_from
from page_training.own.model import OwnJoint, OwnModel, OwnPart, require_different, require_known
from page_training.own.surfaces import multiplied, open_mesh, surfaces_of

# Of what points up in the meshes to +z: (3,3) rotations.
TURNS = {
    "x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
}
UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
KINDS: dict[str, tuple[JointKind, str]] = {
    "revolute": ("revolute", "limits_deg"),
    "prismatic": ("prismatic", "limits_m"),
}


def read_joint_file(path: Path, fixed: Sequence[str] = ()) -> OwnModel:
    """The model that a joint file describes; ValueError names what is wrong with it.

    fixed: joints taken for fixed at 0, so that the meshes of what they carry belong to the part that carries them.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: expected TOML, got {error}") from error
    _closed(document, {"part", "joint"}, {"unit", "up"}, str(path))
    unit, up = document.get("unit", "m"), document.get("up", "z")
    for name, value, known in (("unit", unit, tuple(UNITS_M)), ("up", up, tuple(TURNS))):
        if value not in known:
            raise ValueError(f"{path}: {name}: expected one of {', '.join(known)}, got {value!r}")
    T_model_file = transform_from(np.array(TURNS[up], float), np.zeros(3))
    parts, joints = (_tables(document, name, path) for name in ("part", "joint"))
    names = [str(part.get("name")) for part in parts]
    require_different(names, "parts", path)
    meshes = []
    for part in parts:
        _closed(part, {"name", "mesh"}, set(), f"{path}, part {part.get('name')!r}")
        files = [part["mesh"]] if isinstance(part["mesh"], str) else part["mesh"]
        if not isinstance(files, list) or not files or not all(isinstance(file, str) for file in files):
            where = f"{path}, part {part['name']!r}: mesh"
            raise ValueError(f"{where}: expected a file's name or a list of them, got {part['mesh']!r}")
        found = [mesh for file in files for mesh in open_mesh(path.parent / str(file), UNITS_M[unit])]
        meshes.append(multiplied(found, T_model_file))
    all_joints = [_joint(entry, names, UNITS_M[unit], T_model_file[:3, :3], path) for entry in joints]
    require_different([joint.name for joint in all_joints], "joints", path)
    require_known(fixed, [joint.name for joint in all_joints], path)
    _require_tree(all_joints, names, path)
    carrier = _carriers(all_joints, fixed, len(names))
    kept = [k for k in range(len(names)) if carrier[k] == k]
    joined = [[mesh for k, own in enumerate(meshes) if carrier[k] == part for mesh in own] for part in kept]
    own = tuple(
        OwnPart(names[part], surface, {names[k]: T_model_file for k in range(len(names)) if carrier[k] == part})
        for part, surface in zip(kept, surfaces_of(joined), strict=True)
    )
    moving = tuple(
        replace(joint, parent=kept.index(carrier[joint.parent]), child=kept.index(joint.child))
        for joint in all_joints
        if joint.name not in fixed
    )
    return OwnModel(path.as_posix(), own, moving)


def _require_tree(joints: Sequence[OwnJoint], names: Sequence[str], path: Path) -> None:
    """ValueError for a part that not exactly one chain of joints leads to from the first."""
    for k, name in enumerate(names):
        moved_by = [joint.name for joint in joints if joint.child == k]
        if len(moved_by) != min(k, 1):
            expected = "no joint to move the first part" if k == 0 else "one joint to move every part but the first"
            raise ValueError(f"{path}: part {name!r}: expected {expected}, got {', '.join(moved_by) or 'none'}")
    reached = set(_carriers(joints, [joint.name for joint in joints], len(names)))
    if reached != {0}:
        ring = ", ".join(names[k] for k in sorted(reached - {0}))
        raise ValueError(f"{path}: expected joints from the first part to every other, got a ring through {ring}")


def _carriers(joints: Sequence[OwnJoint], fixed: Sequence[str], count: int) -> list[int]:
    """Of every part the one it belongs to: itself, or what a chain of fixed joints joins it to."""
    carrier = list(range(count))
    joining = {joint.child: joint.parent for joint in joints if joint.name in fixed}
    # A chain is no longer than there are parts; in a ring none comes to the first part.
    for _ in range(count):
        carrier = [joining.get(part, part) for part in carrier]
    return carrier


def _joint(entry: dict[str, Any], names: list[str], unit_m: float, R_model_file: Array, path: Path) -> OwnJoint:
    where = f"{path}, joint {entry.get('name')!r}"
    if entry.get("kind") not in KINDS:
        raise ValueError(f"{where}: kind: expected revolute or prismatic, got {entry.get('kind')!r}")
    kind, limits_name = KINDS[entry["kind"]]
    needed = {"name", "parent", "child", "kind", "axis", limits_name} | ({"point"} if kind == "revolute" else set())
    _closed(entry, needed, {"point"}, where)
    for end in ("parent", "child"):
        if entry[end] not in names:
            raise ValueError(f"{where}: {end}: expected one of {', '.join(names)}, got {entry[end]!r}")
    axis = np.array(_numbers(entry, "axis", 3, where))
    if np.linalg.norm(axis) < 1e-9:
        raise ValueError(f"{where}: axis: expected a direction, got {axis.tolist()}")
    x, y, z = (float(value) for value in R_model_file @ axis / np.linalg.norm(axis))
    point = np.array(_numbers(entry, "point", 3, where) if "point" in entry else (0.0,) * 3)
    px, py, pz = (float(value) for value in unit_m * (R_model_file @ point))
    low, high = _numbers(entry, limits_name, 2, where)
    if kind == "revolute":
        low, high = float(np.radians(low)), float(np.radians(high))
    parent, child = (names.index(entry[end]) for end in ("parent", "child"))
    return OwnJoint(str(entry["name"]), parent, child, kind, (x, y, z), (px, py, pz), (low, high))


def _tables(document: dict[str, Any], name: str, path: Path) -> list[dict[str, Any]]:
    entries = document[name]
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise ValueError(f"{path}: expected one or more [[{name}]], got {type(entries).__name__}")
    return entries


def _closed(entry: dict[str, Any], needed: set[str], optional: set[str], where: str) -> None:
    missing, extra = needed - entry.keys(), entry.keys() - needed - optional
    if missing or extra:
        raise ValueError(f"{where}: missing {sorted(missing)}, not understood {sorted(extra)}")


def _numbers(entry: dict[str, Any], name: str, count: int, where: str) -> list[float]:
    values = entry[name]
    if not isinstance(values, list) or len(values) != count or not all(isinstance(v, int | float) for v in values):
        raise ValueError(f"{where}: {name}: expected {count} numbers, got {values!r}")
    return [float(value) for value in values]
