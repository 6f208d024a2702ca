"""By which symmetries errors are counted: the bundle's, none, or others for single parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from page_runtime.category import Category
from page_runtime.symmetry import Symmetry, Triple

NONE = "none"
_AXES: dict[str, Triple] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
EXPECTED = "expected none, or PART=AXIS:FOLD such as lid=z:2, with x, y or z and a fold of any, 1 (none), 2, 3 ..."


@dataclass(frozen=True, slots=True)
class SymmetryChoice:
    """part: None for all, whose symmetries, and interchange, are dropped. fold: 1 for no symmetry, 0 for any turn."""

    part: str | None
    axis: str = "z"
    fold: int = 1


def symmetry_choice(text: str) -> SymmetryChoice:
    """From what a command is given; ValueError says what it takes."""
    if text == NONE:
        return SymmetryChoice(None)
    part, equals, turn = text.rpartition("=")
    axis, colon, fold = turn.partition(":")
    if not (part and equals and colon) or axis not in _AXES or not (fold == "any" or (fold.isdecimal() and int(fold))):
        raise ValueError(f"{EXPECTED}; got {text!r}")
    return SymmetryChoice(part, axis, 0 if fold == "any" else int(fold))


def with_symmetries(category: Category, choices: Sequence[SymmetryChoice]) -> Category:
    """The category with what was chosen in the place of its own; ValueError for a part it does not have."""
    names = [part.name for part in category.parts]
    for choice in choices:
        if choice.part is None:
            plain = tuple(replace(part, symmetry=None) for part in category.parts)
            category = replace(category, parts=plain, interchange=None)
            continue
        if choice.part not in names:
            raise ValueError(f"no part {choice.part!r} in {category.name}; it has {', '.join(names)}")
        symmetry = None if choice.fold == 1 else Symmetry(_AXES[choice.axis], choice.fold)
        parts = tuple(replace(part, symmetry=symmetry) if part.name == choice.part else part for part in category.parts)
        category = replace(category, parts=parts)
    return category
