"""What leaves an object as it is: turns of a part, parts that take each other's place, and the mirror.

A pose is known only up to these, so errors are counted to the nearest of the true poses that look the same
(`evaluation`), and a network is taught the one nearest to what it says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_runtime.geometry import Array, rotation_about

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Symmetry:
    """A part looks the same after a turn about an axis through its frame's origin. axis: (3,) unit vector in the part's
    frame. fold: the turn is a full one divided by it, 2 for half a turn; 0 where any turn will do.
    """

    axis: Triple
    fold: int

    def __post_init__(self) -> None:
        _require_unit(self.axis, "Symmetry.axis")
        if self.fold < 0 or self.fold == 1:
            raise ValueError(f"Symmetry.fold: expected 0 for any turn, or at least 2, got {self.fold}")


@dataclass(frozen=True, slots=True)
class Interchange:
    """The object is as well described with its parts renamed: part k as part parts[k], and the other way round, each
    part's frame given half a turn about `axis` (one of its own axes). Joint states stay as they are.
    """

    parts: tuple[int, ...]
    axis: Triple

    def __post_init__(self) -> None:
        _require_unit(self.axis, "Interchange.axis")
        _require_swaps(self.parts, "Interchange.parts")

    @property
    def turn(self) -> Array:
        """(3,3) the half turn, its own inverse."""
        return 2.0 * np.outer(self.axis, self.axis) - np.eye(3)


@dataclass(frozen=True, slots=True)
class Mirror:
    """What a mirror shows of an object is one of its category again: part k in the mirror is part parts[k] before it,
    () where each is its own, and x, y or z (axis 0, 1, 2) of every part frame is reversed.
    """

    axis: int = 0
    parts: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.axis not in (0, 1, 2):
            raise ValueError(f"Mirror.axis: expected 0, 1 or 2 for x, y or z, got {self.axis}")
        _require_swaps(self.parts, "Mirror.parts")

    @property
    def reversal(self) -> Array:
        """(3,) -1 for the axis that is reversed."""
        return 1.0 - 2.0 * np.eye(3)[self.axis]

    def order(self, count: int) -> tuple[int, ...]:
        """parts, written out for `count` of them."""
        return self.parts or tuple(range(count))


def nearest_turn(symmetry: Symmetry, wanted: Array) -> float:
    """Of the turns about the axis that change nothing the one [rad] nearest to `wanted` (3,3).

    It maximises trace(wanted^T R(axis, turn)), so `wanted` may be a rotation or any moment matrix.
    """
    axis = np.array(symmetry.axis)
    skew = np.array([wanted[2, 1] - wanted[1, 2], wanted[0, 2] - wanted[2, 0], wanted[1, 0] - wanted[0, 1]])
    turn = float(np.arctan2(axis @ skew, np.trace(wanted) - axis @ wanted @ axis))
    if symmetry.fold == 0:
        return turn
    step = 2.0 * np.pi / symmetry.fold
    return step * round(turn / step)


def turn_of(symmetry: Symmetry, turn_rad: float) -> Array:
    """(3,3) rotation about the symmetry's axis."""
    return rotation_about(np.array(symmetry.axis), turn_rad)


def _require_unit(axis: Triple, name: str) -> None:
    if len(axis) != 3 or not abs(float(np.linalg.norm(axis)) - 1.0) < 1e-6:
        raise ValueError(f"{name}: expected a unit vector of three numbers, got {axis}")


def _require_swaps(parts: tuple[int, ...], name: str) -> None:
    if sorted(parts) != list(range(len(parts))) or any(parts[parts[k]] != k for k in range(len(parts))):
        raise ValueError(f"{name}: expected every part once, swapped in pairs, got {parts}")
