"""Where the time of an estimate goes."""

from __future__ import annotations

from time import perf_counter

STAGES = ("sampling", "network", "scoring", "registration", "icp", "articulation")


class Stopwatch:
    """Adds the wall time since the last call to a stage."""

    def __init__(self) -> None:
        self.stage_ms: dict[str, float] = dict.fromkeys(map(str, STAGES), 0.0)
        self.since = perf_counter()

    def stage(self, name: str) -> None:
        now = perf_counter()
        self.stage_ms[name] += (now - self.since) * 1e3
        self.since = now
