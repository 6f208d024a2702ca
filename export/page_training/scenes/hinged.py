"""What all hinged categories share: two rigid parts and the joint between them.

Canonical part frames: the origin is the centre of the part's axis-aligned box (everything rigidly attached
included); +x runs along the hinge, to the right for a user sitting in front of the opening; +y from the
front edge, where the object opens, to the hinge; +z up when closed. State 0 is closed and both frames are
then parallel. A state q turns the lid by q about -x, so that its front edge rises.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime.geometry import Array, rotation_about, transform_from
from page_training.scenes.meshes import Mesh, joined, shifted

JOINT_AXIS = (-1.0, 0.0, 0.0)
BASE, LID = 0, 1


@dataclass(frozen=True, eq=False, slots=True)
class PartModel:
    """mesh: in the part's canonical frame. extents_m: (3,) full sizes of its box."""

    mesh: Mesh
    extents_m: Array


@dataclass(frozen=True, eq=False, slots=True)
class HingedObject:
    """parts: (base, lid). hinge_base, hinge_lid: (3,) the same point of the hinge in either part's frame,
    metres.

    loose: things lying in the base that belong to no part (background), in the base frame.
    """

    parts: tuple[PartModel, PartModel]
    hinge_base: Array
    hinge_lid: Array
    loose: Mesh | None

    def T_base_lid(self, state_rad: float) -> Array:
        """(4,4) pose of the lid in the base frame: T = [R, hinge_base - R hinge_lid], R a turn about
        JOINT_AXIS."""
        rotation = rotation_about(np.array(JOINT_AXIS), state_rad)
        return transform_from(rotation, self.hinge_base - rotation @ self.hinge_lid)


def hinged_object(
    base: Sequence[Mesh], lid: Sequence[Mesh], hinge: tuple[float, float, float], loose: Sequence[Mesh] = ()
) -> HingedObject:
    """Assemble meshes that stand closed in one frame (axes as the canonical ones) about a hinge point
    (x,y,z) metres."""
    models, origins = [], []
    for meshes in (base, lid):
        mesh = joined(meshes)
        low, high = mesh.vertices.min(axis=0).astype(float), mesh.vertices.max(axis=0).astype(float)
        origin = (low + high) / 2
        models.append(PartModel(shifted(mesh, *(-origin)), high - low))
        origins.append(origin)
    point = np.array(hinge, float)
    things = shifted(joined(loose), *(-origins[BASE])) if loose else None
    return HingedObject((models[BASE], models[LID]), point - origins[BASE], point - origins[LID], things)
