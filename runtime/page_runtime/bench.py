"""How long each stage takes on this computer, over all frames of a source, beside the paper's figures."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from page_runtime.estimator import estimate
from page_runtime.network import Network
from page_runtime.recorded import Source

# Section VI of the paper, on a desktop computer with a GPU; its alignment is our registration.
PAPER_MS = {"scoring": 115.0, "registration": 15.0, "total": 160.0}
PERCENTILES = (50, 95, 99)
WARM_UP = 5
MIN_MEASUREMENTS = 100
PACKAGES = ("page-edge", "numpy", "onnxruntime", "opencv-python-headless")


@dataclass(frozen=True, slots=True)
class Timing:
    """One estimate: stage_ms by stage, total_ms measured around all of it."""

    stage_ms: dict[str, float]
    total_ms: float


def passes_needed(source: Source, min_measurements: int = MIN_MEASUREMENTS) -> int:
    """Whole passes over the source, so that every frame counts alike, until there are that many regions to estimate."""
    regions = sum(instance.region is not None for entry in source.entries for instance in entry.instances)
    return -(-min_measurements // max(regions, 1))


def time_estimates(
    network: Network, source: Source, *, passes: int, on_frame: Callable[[], None] = lambda: None
) -> tuple[list[Timing], int]:
    """Timings of `passes` passes over the source, and how many estimates were left out.

    Reading frames is not timed, one frame is in memory at a time, and WARM_UP estimates come before the first timing.
    Left out are estimates that ended before the network ran: their few microseconds would only flatter the rest.
    """
    timings: list[Timing] = []
    left_out, to_warm_up = 0, WARM_UP
    for _ in range(passes):
        for recorded in source:
            for region in (i.region for i in recorded.instances if i.region is not None):
                while to_warm_up:
                    estimate(network, recorded.frame, region)
                    to_warm_up -= 1
                begin = perf_counter()
                pose = estimate(network, recorded.frame, region)
                total_ms = (perf_counter() - begin) * 1e3
                if pose.stage_ms.get("network", 0.0) > 0:
                    timings.append(Timing(pose.stage_ms, total_ms))
                else:
                    left_out += 1
            on_frame()
    return timings, left_out


def report(timings: list[Timing], *, threads: int) -> dict[str, Any]:
    """The figures of at least one timing as `page-runtime bench` writes them."""
    names = list(timings[0].stage_ms)
    return {
        "stages": {name: _percentiles([timing.stage_ms.get(name, 0.0) for timing in timings]) for name in names},
        "total": _percentiles([timing.total_ms for timing in timings]),
        "peak_rss_mb": peak_rss_mb(),
        "threads": threads,
        "versions": versions(),
        "cpu": cpu_name(),
        "measurements": len(timings),
        "warm_up": WARM_UP,
        "paper_ms": PAPER_MS,
    }


def _percentiles(values_ms: Iterable[float]) -> dict[str, float]:
    values = np.percentile(list(values_ms), PERCENTILES)
    return {f"p{p}_ms": round(float(value), 3) for p, value in zip(PERCENTILES, values, strict=True)}


def peak_rss_mb() -> float | None:
    """The largest resident memory of this process so far, in 10^6 bytes; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak * (1 if sys.platform == "darwin" else 1024) / 1e6, 1)


def available_threads() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def versions() -> dict[str, str]:
    """Of Python and of what the runtime computes with."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed as a package"
    return found


def cpu_name() -> str:
    """The processor's name as the system gives it."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith(("model name", "Model")):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
