"""How the category's part frames lie in a data set's own: what `page-train import` needs beyond reading files."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from page_runtime.geometry import Array
from page_runtime.image_files import SourceError

AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class PartFrame:
    """axes: our x, y and z of the part `part` in the data set's frame, each "x", "y" or "z" of that, with "-" before it
    where it points the other way."""

    part: str
    axes: tuple[str, ...]

    @property
    def R_rest_part(self) -> Array:
        """(3,3) from our axes of the part to the data set's."""
        return signed_permutation(self.axes).T


@dataclass(frozen=True, slots=True)
class ObjectFrames:
    """named: what the data set calls the category `category`. parts: in the order of the data set's links."""

    named: str
    category: str
    parts: tuple[PartFrame, ...]


def signed_orders() -> list[tuple[str, ...]]:
    """The 48 orders of x, y and z with and without "-" before each."""
    return [
        tuple(sign + name for sign, name in zip(signs, order, strict=True))
        for order in itertools.permutations(AXES)
        for signs in itertools.product(("", "-"), repeat=3)
    ]


def signed_permutation(order: Sequence[str]) -> Array:
    """(3,3) of components like ["y", "-z", "x"]."""
    matrix = np.zeros((3, 3))
    for row, name in zip(matrix, order, strict=True):
        row[AXES.index(name.removeprefix("-"))] = -1.0 if name.startswith("-") else 1.0
    return matrix


def require_order(order: Any, *, where: str) -> tuple[str, ...]:
    """`order` when it is x, y and z in some order, each with or without "-"."""
    names = order if isinstance(order, list) else []
    if sorted(str(name).removeprefix("-") for name in names) != list(AXES):
        raise SourceError(f"{where}: expected x, y and z in some order, got {order}")
    return tuple(str(name) for name in names)


def object_frames(entry: Any, *, where: str) -> ObjectFrames:
    """Of a table with named, category and parts = [{part = ..., axes = [...]}, ...]; SourceError says what is wrong."""
    if not isinstance(entry, dict) or set(entry) != {"named", "category", "parts"}:
        raise SourceError(f"{where}: expected a table of named, category and parts, got {entry!r}")
    parts = []
    for i, part in enumerate(entry["parts"] if isinstance(entry["parts"], list) else []):
        here = f"{where}, part {i}"
        if not isinstance(part, dict) or set(part) != {"part", "axes"}:
            raise SourceError(f"{here}: expected {{part = NAME, axes = [X, Y, Z]}}, got {part!r}")
        axes = require_order(part["axes"], where=f"{here}, axes")
        if np.linalg.det(signed_permutation(axes)) < 0:
            raise SourceError(f"{here}, axes: expected a right-handed frame, got {list(axes)}; turn one of them round")
        parts.append(PartFrame(str(part["part"]), axes))
    if not parts or len({part.part for part in parts}) != len(parts):
        raise SourceError(f"{where}, parts: expected parts of different names, got {[part.part for part in parts]}")
    return ObjectFrames(str(entry["named"]), str(entry["category"]), tuple(parts))
