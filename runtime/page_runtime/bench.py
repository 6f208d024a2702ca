"""How long each stage takes on this computer, over all frames of a source, beside the paper's figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from page_runtime.estimator import MAX_LOOKS, estimate
from page_runtime.machine import EnergyCounter, cpu_name, energy_counters, peak_rss_mb, versions
from page_runtime.network import Network
from page_runtime.part_poses import MAX_VOTERS
from page_runtime.pose import ArticulatedPose
from page_runtime.recorded import Source

# Section VII of the paper, on a desktop computer with a GPU; its alignment is our registration.
PAPER_MS = {"scoring": 115.0, "registration": 15.0, "total": 160.0}
PERCENTILES = (50, 90, 95, 99)
WARM_UP = 5
MIN_MEASUREMENTS = 100
WINDOWS = 3
# Medians of the windows farther apart than this are of a machine that does something else beside.
AGREEMENT = 0.10


@dataclass(frozen=True, slots=True)
class Timing:
    """One estimate: stage_ms by stage, total_ms measured around all of it, the looks it took."""

    stage_ms: dict[str, float]
    total_ms: float
    looks: int = 1


@dataclass(frozen=True, slots=True)
class Window:
    """Timings one after the other. left_out: estimates that ended before the network. energy_j: of the processor's
    packages while it lasted, reading pictures included; None where no counter may be read."""

    timings: tuple[Timing, ...]
    left_out: int
    energy_j: float | None = None


def time_windows(
    network: Network,
    source: Source,
    *,
    windows: int = WINDOWS,
    min_measurements: int = MIN_MEASUREMENTS,
    max_looks: int = MAX_LOOKS,
    max_voters: int = MAX_VOTERS,
    counters: Sequence[EnergyCounter] | None = None,
    on_frame: Callable[[int], None] = lambda _: None,
) -> list[Window]:
    """So many windows of `time_estimates`, warmed up before the first; one where no estimate reaches the network.

    counters: of energy, None for those of this machine. on_frame is told the number of frames in all windows.
    """
    measured = energy_counters() if counters is None else counters
    found: list[Window] = []
    in_a_window = 0

    def told(frames: int) -> None:
        # The first pass of a later window knows less than what the first window has found out.
        nonlocal in_a_window
        in_a_window = max(in_a_window, frames)
        on_frame(windows * in_a_window)

    for number in range(windows):
        before = [counter.read_uj() for counter in measured]
        timings, left_out = time_estimates(
            network,
            source,
            min_measurements=min_measurements,
            max_looks=max_looks,
            max_voters=max_voters,
            warm_up=WARM_UP if number == 0 else 0,
            on_frame=told,
        )
        used = [counter.used_j(old, counter.read_uj()) for counter, old in zip(measured, before, strict=True)]
        found.append(Window(tuple(timings), left_out, sum(used) if measured else None))
        if not timings:
            break
    return found


def time_estimates(
    network: Network,
    source: Source,
    *,
    min_measurements: int = MIN_MEASUREMENTS,
    max_looks: int = MAX_LOOKS,
    max_voters: int = MAX_VOTERS,
    warm_up: int = WARM_UP,
    on_frame: Callable[[int], None] = lambda _: None,
) -> tuple[list[Timing], int]:
    """At least so many timings, or none if no estimate reaches the network, and how many estimates were left out.

    Whole passes over the source, so that every frame counts alike. Reading frames is not timed, one frame is in memory
    at a time, and `warm_up` estimates that reached the network come before the first timing. Left out are estimates
    that ended before it: their few microseconds would only flatter the rest. on_frame is told the number of frames in
    all passes, which is known from the second pass on.
    """
    timings: list[Timing] = []
    left_out, to_warm_up, passes = 0, warm_up, 1
    while len(timings) < min_measurements:
        for recorded in source:
            for region in (i.region for i in recorded.instances if i.region is not None):

                def once(frame: Any = recorded.frame, region: Any = region) -> ArticulatedPose:
                    return estimate(network, frame, region, max_looks=max_looks, max_voters=max_voters)

                while to_warm_up and _reached_network(once()):
                    to_warm_up -= 1
                begin = perf_counter()
                pose = once()
                total_ms = (perf_counter() - begin) * 1e3
                if _reached_network(pose):
                    timings.append(Timing(pose.stage_ms, total_ms, pose.looks))
                else:
                    left_out += 1
            on_frame(passes * len(source))
        if not timings:
            break
        if passes == 1:
            passes = -(-min_measurements // len(timings))
    return timings, left_out


def _reached_network(pose: ArticulatedPose) -> bool:
    return pose.stage_ms.get("network", 0.0) > 0


def report(windows: Sequence[Window], *, threads: int, budgets_ms: Sequence[float] = ()) -> dict[str, Any]:
    """The figures of at least one timing as `page-runtime bench` writes them. budgets_ms: beside the paper's time."""
    timings = [timing for window in windows for timing in window.timings]
    names = list(timings[0].stage_ms)
    totals = np.array([timing.total_ms for timing in timings])
    return {
        "stages": {name: _percentiles([timing.stage_ms.get(name, 0.0) for timing in timings]) for name in names},
        "total": _percentiles(totals),
        "jitter": jitter(windows),
        "deadlines": [deadline(totals, budget) for budget in dict.fromkeys((PAPER_MS["total"], *budgets_ms))],
        "stability": stability(windows),
        "mean_looks": round(float(np.mean([timing.looks for timing in timings])), 3),
        "energy": energy(windows),
        "peak_rss_mb": peak_rss_mb(),
        "threads": threads,
        "versions": versions(),
        "cpu": cpu_name(),
        "measurements": len(timings),
        "warm_up": WARM_UP,
        "paper_ms": PAPER_MS,
    }


def jitter(windows: Sequence[Window]) -> dict[str, float]:
    """std_ms: standard deviation of the totals. successive_ms: mean size of the difference between one estimate's total
    and the next one's in the same window, what a loop sees from frame to frame."""
    totals = [np.array([timing.total_ms for timing in window.timings]) for window in windows]
    steps = np.concatenate([np.abs(np.diff(one)) for one in totals])
    return {
        "std_ms": round(float(np.concatenate(totals).std()), 3),
        "successive_ms": round(float(steps.mean()), 3) if len(steps) else 0.0,
    }


def deadline(totals_ms: Sequence[float] | np.ndarray, budget_ms: float) -> dict[str, float | int]:
    """How many estimates took longer than the budget."""
    missed = int((np.asarray(totals_ms) > budget_ms).sum())
    return {"budget_ms": budget_ms, "missed": missed, "missed_share": round(missed / len(totals_ms), 5)}


def stability(windows: Sequence[Window]) -> dict[str, Any]:
    """Whether the windows' medians of the total agree: spread is the largest over the smallest, less one. Fewer than
    two windows say nothing, which counts as unstable."""
    medians = [float(np.median([timing.total_ms for timing in window.timings])) for window in windows]
    spread = max(medians) / min(medians) - 1.0
    return {
        "windows_p50_ms": [round(one, 3) for one in medians],
        "spread": round(spread, 4),
        "agreement": AGREEMENT,
        "stable": len(medians) > 1 and spread <= AGREEMENT,
    }


def energy(windows: Sequence[Window]) -> dict[str, float] | None:
    """Joules of the processor's packages, all that ran on them included; None where no counter may be read."""
    used = [window.energy_j for window in windows if window.energy_j is not None]
    if len(used) < len(windows):
        return None
    estimates = sum(len(window.timings) for window in windows)
    return {"total_j": round(sum(used), 3), "per_estimate_j": round(sum(used) / estimates, 4)}


def _percentiles(values_ms: Iterable[float]) -> dict[str, float]:
    values = np.percentile(list(values_ms), PERCENTILES)
    return {f"p{p}_ms": round(float(value), 3) for p, value in zip(PERCENTILES, values, strict=True)}
