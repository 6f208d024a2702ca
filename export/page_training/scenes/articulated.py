"""What all categories share: rigid parts, the joints between them, and where the parts are in given states.

A category's module makes meshes that stand assembled at state 0, in one frame whose axes are those of the canonical
part frames, and says where each joint is in it. Canonical part frames: the origin is the centre of the part's
axis-aligned box (everything rigidly attached included); the axes are those of the assembly, so that at state 0 all part
frames are parallel. What the axes are, and which way a joint moves, is the category's (`page_training.categories`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime.category import Joint
from page_runtime.geometry import Array, rotation_about, transform_from
from page_training.scenes.meshes import Mesh, joined, shifted

States = tuple[float, ...]
Limits = tuple[float, float]


@dataclass(frozen=True, eq=False, slots=True)
class PartModel:
    """mesh: in the part's canonical frame. extents_m: (3,) full sizes of its box."""

    mesh: Mesh
    extents_m: Array


@dataclass(frozen=True, eq=False, slots=True)
class JointModel:
    """One joint of one object. pivot_parent, pivot_child: (3,) m, the same point of it at state 0 in either part's
    frame. limits: of this object, within the category's."""

    joint: Joint
    pivot_parent: Array
    pivot_child: Array
    limits: Limits

    def T_parent_child(self, state: float) -> Array:
        """(4,4) pose of the child in the parent's frame; state in rad, or m along a prismatic joint's axis."""
        axis = np.array(self.joint.axis)
        if self.joint.kind == "prismatic":
            return transform_from(np.eye(3), self.pivot_parent - self.pivot_child + state * axis)
        rotation = rotation_about(axis, state)
        return transform_from(rotation, self.pivot_parent - rotation @ self.pivot_child)


@dataclass(frozen=True, eq=False, slots=True)
class ArticulatedObject:
    """parts: in the category's order. joints: in its order, a parent's own joint before its children's. loose: things
    that belong to no part (background), each in the frame of the part it lies in and moves with."""

    parts: tuple[PartModel, ...]
    joints: tuple[JointModel, ...]
    loose: tuple[tuple[int, Mesh], ...] = ()

    def poses(self, T_a_root: Array, states: States) -> list[Array]:
        """T_a_part (4,4) of every part, from that of the part no joint moves."""
        moved_parts = {model.joint.child for model in self.joints}
        poses: dict[int, Array] = {k: T_a_root for k in range(len(self.parts)) if k not in moved_parts}
        for model, state in zip(self.joints, states, strict=True):
            poses[model.joint.child] = poses[model.joint.parent] @ model.T_parent_child(state)
        return [poses[k] for k in range(len(self.parts))]

    @property
    def diagonal_m(self) -> float:
        """Of the box around all parts at state 0."""
        corners = [
            np.stack([T[:3, 3] - part.extents_m / 2, T[:3, 3] + part.extents_m / 2])
            for part, T in zip(self.parts, self.poses(np.eye(4), (0.0,) * len(self.joints)), strict=True)
        ]
        low, high = np.min(corners, axis=(0, 1)), np.max(corners, axis=(0, 1))
        return float(np.linalg.norm(high - low))


def articulated_object(
    joints: Sequence[Joint],
    parts: Sequence[Sequence[Mesh]],
    points: Sequence[Sequence[float]],
    *,
    loose: Sequence[tuple[int, Mesh]] = (),
    limits: Sequence[Limits] | None = None,
) -> ArticulatedObject:
    """Assemble the meshes of each part, which stand at state 0 in one frame with axes as the canonical ones.

    points: of each joint, one point (x,y,z) metres of it in that frame. loose: (part, mesh) in that frame too. limits:
    of each joint of this object, those of the category if None.
    """
    models, origins = [], []
    for meshes in parts:
        mesh = joined(meshes)
        low, high = mesh.vertices.min(axis=0).astype(float), mesh.vertices.max(axis=0).astype(float)
        origin = (low + high) / 2
        models.append(PartModel(shifted(mesh, *(-origin)), high - low))
        origins.append(origin)
    own_limits = [joint.limits for joint in joints] if limits is None else limits
    return ArticulatedObject(
        parts=tuple(models),
        joints=tuple(
            JointModel(
                joint,
                np.array(point, float) - origins[joint.parent],
                np.array(point, float) - origins[joint.child],
                own,
            )
            for joint, point, own in zip(joints, points, own_limits, strict=True)
        ),
        loose=tuple((part, shifted(mesh, *(-origins[part]))) for part, mesh in loose),
    )


def seen_from(model: ArticulatedObject, near: float, far: float) -> tuple[float, float]:
    """Nearest and farthest camera, metres: `near` and `far` diagonals of the object away, as depth cameras allow."""
    diagonal_m = model.diagonal_m
    nearest = float(np.clip(near * diagonal_m, 0.28, 3.0))
    return nearest, float(np.clip(far * diagonal_m, nearest + 0.1, 4.0))
