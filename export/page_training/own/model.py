"""One articulated model as scenes need it, whatever file it came from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.category import JointKind
from page_runtime.geometry import Array

# Lengths below this are no surface a depth camera sees, and no box has a side of nothing.
LEAST_SIZE_M = 1e-4


def require_different(names: Sequence[str], what: str, source: object) -> None:
    """ValueError names what there is twice of things that are told apart by name."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{source}: expected {what} of different names, got {', '.join(twice)} more than once; rename")


def require_known(fixed: Sequence[str], known: Sequence[str], source: object) -> None:
    """ValueError for joints to be taken for fixed that are not there."""
    unknown = sorted(set(fixed) - set(known))
    if unknown:
        raise ValueError(f"{source}: --fix: expected joints of {', '.join(sorted(known))}, got {', '.join(unknown)}")


@dataclass(frozen=True, eq=False, slots=True)
class Surface:
    """vertices: (V,3) metres, in the frame all parts stand in at state 0. triangles: (F,3). color: (F,) index into
    palette (P,3), RGB in [0,1]."""

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    color: NDArray[np.int32]
    palette: NDArray[np.float32]


@dataclass(frozen=True, eq=False, slots=True)
class OwnPart:
    """links: of the file's rigid bodies that make up this part, with T_model_link (4,4) at state 0."""

    name: str
    surface: Surface
    links: dict[str, Array]


@dataclass(frozen=True, eq=False, slots=True)
class OwnJoint:
    """parent, child: indices of parts. axis: (3,) unit and point (3,) m, in the model's frame at state 0. limits: rad
    or m."""

    name: str
    parent: int
    child: int
    kind: JointKind
    axis: tuple[float, float, float]
    point: tuple[float, float, float]
    limits: tuple[float, float]


@dataclass(frozen=True, eq=False, slots=True)
class OwnModel:
    """parts: the first is the one no joint moves; every other is the child of one joint. joints: parents before their
    children. source: the file's name."""

    source: str
    parts: tuple[OwnPart, ...]
    joints: tuple[OwnJoint, ...]

    def __post_init__(self) -> None:
        if not self.joints:
            raise ValueError(f"{self.source}: expected joints that move, got none; then it is one rigid object")
        require_different([joint.name for joint in self.joints], "joints", self.source)
        children = [joint.child for joint in self.joints]
        if sorted(children) != list(range(1, len(self.parts))):
            raise ValueError(f"{self.source}: expected every part but the first to be the child of one joint")
        known = {0}
        for joint in self.joints:
            if joint.parent not in known:
                raise ValueError(f"{self.source}: joint {joint.name!r}: its parent is moved by no joint before it")
            known.add(joint.child)
            low, high = joint.limits
            if not (np.isfinite([low, high]).all() and low < high):
                raise ValueError(
                    f"{self.source}: joint {joint.name!r}: expected limits low < high, got {low:g} and {high:g}"
                )
        for part in self.parts:
            sizes = np.ptp(part.surface.vertices, axis=0) if len(part.surface.vertices) else np.zeros(3)
            if not np.isfinite(sizes).all() or (sizes < LEAST_SIZE_M).any():
                raise ValueError(
                    f"{self.source}: part {part.name!r}: expected a solid of some size along x, y and z, got "
                    f"{' x '.join(f'{size:g}' for size in sizes)} m; is the unit right?"
                )
