"""What a check of a data set has to say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "fine"]

PLACES_SHOWN = 5


@dataclass(frozen=True, slots=True)
class Finding:
    """what: of one kind of check, with the way out; where: the first places, if it has any."""

    severity: Severity
    check: str
    what: str
    where: str = ""


def in_places(places: Sequence[str]) -> str:
    """The first places in words, and how many more there are."""
    more = len(places) - PLACES_SHOWN
    return "; ".join(places[:PLACES_SHOWN]) + (f"; and {more} more" if more > 0 else "")
