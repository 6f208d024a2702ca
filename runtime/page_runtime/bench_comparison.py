"""Whether one benchmark is slower than another, and whether the two can be compared at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

# What must be the same for a comparison to mean anything.
SAME = ("cpu", "threads", "recording_sha256", "looks")
# The same, of documents that have it: null where the recording says where objects are.
SAME_IF_SAID = ("region",)
# Slower by more than this is a regression; windows of a stable run agree within as much.
TOLERANCE = 0.10
# Of a stage: a tenth of half a millisecond is nobody's concern.
LEAST_MS = 0.5
Verdict = Literal["no regression", "regression", "unstable"]


class NotComparable(ValueError):
    """The two were measured on different things; the message says what differs."""


@dataclass(frozen=True, slots=True)
class Change:
    """One figure of both: name such as "total p50"; ratio: other over one; slower: beyond the tolerance."""

    name: str
    one_ms: float
    other_ms: float
    ratio: float
    slower: bool


@dataclass(frozen=True, slots=True)
class BenchComparison:
    """verdict: "unstable" where either run's windows disagree, whatever the figures say."""

    verdict: Verdict
    changes: tuple[Change, ...]


def compare(one: dict[str, Any], other: dict[str, Any]) -> BenchComparison:
    """Two documents of `page-runtime bench`, the earlier first. A regression is a median or 95th percentile of the
    total, or a median of a stage, that is more than TOLERANCE above. NotComparable, with the reason."""
    for document in (one, other):
        missing = [name for name in (*SAME, "stages", "total", "stability") if name not in document]
        if missing:
            raise NotComparable(f"expected figures of page-runtime bench, got none of {', '.join(missing)}")
    said = [(name, one.get(name), other.get(name)) for name in (*SAME, *SAME_IF_SAID)]
    differ = [f"{name} ({ours} and {theirs})" for name, ours, theirs in said if ours != theirs]
    if differ:
        raise NotComparable(f"they differ in {', '.join(differ)}; measure both on the same machine and recording")
    changes = [_change(f"total {p}", one["total"], other["total"], p) for p in ("p50", "p95")]
    changes += [
        _change(f"{name} p50", one["stages"][name], other["stages"][name], "p50", least_ms=LEAST_MS)
        for name in one["stages"]
        if name in other["stages"]
    ]
    if not (one["stability"]["stable"] and other["stability"]["stable"]):
        return BenchComparison("unstable", tuple(changes))
    slower = any(change.slower for change in changes)
    return BenchComparison("regression" if slower else "no regression", tuple(changes))


def _change(name: str, one: dict[str, float], other: dict[str, float], key: str, least_ms: float = 0.0) -> Change:
    before, after = one[f"{key}_ms"], other[f"{key}_ms"]
    ratio = after / before if before > 0 else float("inf") if after > 0 else 1.0
    return Change(name, before, after, ratio, after - before > max(TOLERANCE * before, least_ms))
