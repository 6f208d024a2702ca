"""URDF into parts and joints: links joined by fixed joints are one part."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.category import JointKind
from page_runtime.geometry import Array
from page_training.own.model import OwnJoint, OwnModel, OwnPart, require_known
from page_training.own.surfaces import link_meshes, multiplied, open_urdf, surfaces_of
from page_training.own.urdf_structure import require_urdf

KINDS: dict[str, JointKind] = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}


def read_urdf(path: Path, fixed: Sequence[str] = ()) -> OwnModel:
    """The model of a URDF file in the frame of its root link, all joints at 0.

    fixed: joints taken for fixed at 0, so that what they carry belongs to the part that carries them. ValueError for
    joints that are neither fixed, revolute, continuous nor prismatic, for names that are not in the file, and for
    moving links without geometry.
    """
    if not path.is_file():
        raise ValueError(f"{path}: expected a URDF file, got nothing there")
    require_urdf(path)
    robot = open_urdf(path)
    require_known(fixed, list(robot.joint_map), path)
    for joint in robot.robot.joints:
        # One that follows another would stand at its offset, which is no state 0 of its own.
        joint.mimic = None
    robot.update_cfg(dict.fromkeys(robot.joint_map, 0.0))
    moving = [joint for joint in _in_order(robot) if joint.type != "fixed" and joint.name not in fixed]
    strange = [joint for joint in moving if joint.type not in KINDS]
    if strange:
        raise ValueError(
            f"{path}: joint {strange[0].name!r}: expected fixed, revolute, continuous or prismatic, got "
            f"{strange[0].type}; --fix {strange[0].name} takes it for fixed"
        )
    part_of = dict.fromkeys([robot.base_link], 0)
    names = [robot.base_link]
    for joint in _in_order(robot):
        if joint in moving:
            part_of[joint.child] = len(names)
            names.append(joint.child)
        else:
            part_of[joint.child] = part_of[joint.parent]
    T_model = {link: np.asarray(robot.get_transform(link, robot.base_link), float) for link in part_of}
    meshes: list[list[Any]] = [[] for _ in names]
    for link, own in link_meshes(robot).items():
        meshes[part_of[link]] += multiplied(own, T_model[link])
    for name, own in zip(names, meshes, strict=True):
        if not own:
            carrier = next((joint.name for joint in moving if joint.child == name), None)
            way_out = f"; --fix {carrier} joins it to what carries it" if carrier else "; give it a visual"
            raise ValueError(f"{path}: link {name!r}: expected visual geometry on every moving part, got none{way_out}")
    parts = tuple(
        OwnPart(name, surface, {link: T_model[link] for link, part in part_of.items() if part == k})
        for k, (name, surface) in enumerate(zip(names, surfaces_of(meshes), strict=True))
    )
    return OwnModel(path.as_posix(), parts, tuple(_joint(path, joint, part_of, T_model) for joint in moving))


def _in_order(robot: Any) -> list[Any]:
    """The joints, those nearer to the root first."""
    found, links = [], [robot.base_link]
    while links:
        link = links.pop(0)
        for joint in robot.robot.joints:
            if joint.parent == link:
                found.append(joint)
                links.append(joint.child)
    return found


def _joint(path: Path, joint: Any, part_of: dict[str, int], T_model: dict[str, Array]) -> OwnJoint:
    T = T_model[joint.child]
    axis = T[:3, :3] @ np.asarray([1.0, 0.0, 0.0] if joint.axis is None else joint.axis, float)
    x, y, z = axis / np.linalg.norm(axis)
    limits = (-np.pi, np.pi)
    if joint.type != "continuous":
        if joint.limit is None or joint.limit.lower is None or joint.limit.upper is None:
            raise ValueError(f"{path}: joint {joint.name!r}: expected a <limit> with lower and upper, got none")
        limits = (joint.limit.lower, joint.limit.upper)
    px, py, pz = (float(value) for value in T[:3, 3])
    low, high = (float(limit) for limit in limits)
    return OwnJoint(
        name=joint.name,
        parent=part_of[joint.parent],
        child=part_of[joint.child],
        kind=KINDS[joint.type],
        axis=(float(x), float(y), float(z)),
        point=(px, py, pz),
        limits=(low, high),
    )
