"""Where the time of an estimate goes."""

from __future__ import annotations

from collections.abc import Mapping
from time import perf_counter

STAGES = ("sampling", "network", "scoring", "registration", "icp", "articulation")


class Stopwatch:
    """Adds the wall time since the last call to a stage; `so_far`: what each stage has taken before."""

    def __init__(self, so_far: Mapping[str, float] | None = None) -> None:
        self.stage_ms: dict[str, float] = dict.fromkeys(map(str, STAGES), 0.0) | dict(so_far or {})
        self.since = perf_counter()

    def stage(self, name: str) -> None:
        now = perf_counter()
        self.stage_ms[name] += (now - self.since) * 1e3
        self.since = now


def add_stages(total_ms: dict[str, float], stage_ms: Mapping[str, float]) -> None:
    """Add the times of one estimate to those of all of a frame's."""
    for name, value in stage_ms.items():
        total_ms[name] = total_ms.get(name, 0.0) + value
