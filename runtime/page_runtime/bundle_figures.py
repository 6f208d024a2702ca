"""How well a bundle did on data that neither its training nor its calibration saw, kept inside it for people."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

_PAIRS = ("rotation_deg", "translation_m", "translation_share")
_SHARES = ("acc_5deg5cm", "failure_rate")
_FIELDS = {"data", "instances", "part", *_PAIRS, *_SHARES}


@dataclass(frozen=True, slots=True)
class PartFigures:
    """One part on one set of data, as `page-runtime validate` counts (`evaluation`).

    data: what was measured on, in words; instances: how many objects. rotation_deg, translation_m, translation_share
    (of the part's diagonal): mean and median over the visible parts that have a pose, None where none has.
    acc_5deg5cm, failure_rate: shares of the visible parts, None where none is visible.
    """

    data: str
    instances: int
    part: str
    rotation_deg: tuple[float | None, float | None]
    translation_m: tuple[float | None, float | None]
    translation_share: tuple[float | None, float | None]
    acc_5deg5cm: float | None
    failure_rate: float | None


def figures_document(figures: PartFigures) -> dict[str, Any]:
    """In JSON's types; `figures_from` gives it back."""
    return {
        "data": figures.data,
        "instances": figures.instances,
        "part": figures.part,
        **{name: dict(zip(("mean", "median"), getattr(figures, name), strict=True)) for name in _PAIRS},
        **{name: getattr(figures, name) for name in _SHARES},
    }


def figures_from(entry: Any) -> PartFigures:
    """The figures of `figures_document`; ValueError names what is wrong, missing or one too many."""
    if not isinstance(entry, dict) or set(entry) != _FIELDS:
        got = sorted(entry) if isinstance(entry, dict) else type(entry).__name__
        raise ValueError(f"figures: expected the fields {sorted(_FIELDS)}, got {got}")
    for name in ("data", "part"):
        if not isinstance(entry[name], str) or not entry[name].isprintable():
            raise ValueError(f"figures, {name}: expected printable text, got {entry[name]!r}")
    if not isinstance(entry["instances"], int) or isinstance(entry["instances"], bool) or entry["instances"] < 0:
        raise ValueError(f"figures, instances: expected a count, got {entry['instances']!r}")
    return PartFigures(
        data=entry["data"],
        instances=entry["instances"],
        part=entry["part"],
        rotation_deg=_pair(entry, "rotation_deg"),
        translation_m=_pair(entry, "translation_m"),
        translation_share=_pair(entry, "translation_share"),
        acc_5deg5cm=_value(entry["acc_5deg5cm"], "acc_5deg5cm"),
        failure_rate=_value(entry["failure_rate"], "failure_rate"),
    )


def _pair(entry: dict[str, Any], name: str) -> tuple[float | None, float | None]:
    pair = entry[name]
    if not isinstance(pair, dict) or set(pair) != {"mean", "median"}:
        raise ValueError(f"figures, {name}: expected mean and median, got {pair!r}")
    return _value(pair["mean"], name), _value(pair["median"], name)


def _value(value: Any, name: str) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < math.inf:
        raise ValueError(f"figures, {name}: expected a number of at least 0 or null, got {value!r}")
    return float(value)
