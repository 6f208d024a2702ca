"""How long each stage takes on this computer, over all frames of a source, beside the paper's figures."""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from page_runtime.estimator import MAX_LOOKS, estimate
from page_runtime.network import Network
from page_runtime.pose import ArticulatedPose
from page_runtime.recorded import Source

# Section VI of the paper, on a desktop computer with a GPU; its alignment is our registration.
PAPER_MS = {"scoring": 115.0, "registration": 15.0, "total": 160.0}
PERCENTILES = (50, 95, 99)
WARM_UP = 5
MIN_MEASUREMENTS = 100
PACKAGES = ("page-edge", "numpy", "onnxruntime", "opencv-python-headless")


@dataclass(frozen=True, slots=True)
class Timing:
    """One estimate: stage_ms by stage, total_ms measured around all of it, the looks it took."""

    stage_ms: dict[str, float]
    total_ms: float
    looks: int = 1


def time_estimates(
    network: Network,
    source: Source,
    *,
    min_measurements: int = MIN_MEASUREMENTS,
    max_looks: int = MAX_LOOKS,
    on_frame: Callable[[int], None] = lambda _: None,
) -> tuple[list[Timing], int]:
    """At least so many timings, or none if no estimate reaches the network, and how many estimates were left out.

    Whole passes over the source, so that every frame counts alike. Reading frames is not timed, one frame is in memory
    at a time, and WARM_UP estimates that reached the network come before the first timing. Left out are estimates that
    ended before it: their few microseconds would only flatter the rest. on_frame is told the number of frames in all
    passes, which is known from the second pass on.
    """
    timings: list[Timing] = []
    left_out, to_warm_up, passes = 0, WARM_UP, 1
    while len(timings) < min_measurements:
        for recorded in source:
            for region in (i.region for i in recorded.instances if i.region is not None):
                while to_warm_up and _reached_network(estimate(network, recorded.frame, region, max_looks=max_looks)):
                    to_warm_up -= 1
                begin = perf_counter()
                pose = estimate(network, recorded.frame, region, max_looks=max_looks)
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


def report(timings: list[Timing], *, threads: int) -> dict[str, Any]:
    """The figures of at least one timing as `page-runtime bench` writes them."""
    names = list(timings[0].stage_ms)
    return {
        "stages": {name: _percentiles([timing.stage_ms.get(name, 0.0) for timing in timings]) for name in names},
        "total": _percentiles([timing.total_ms for timing in timings]),
        "mean_looks": round(float(np.mean([timing.looks for timing in timings])), 3),
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


def versions(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Of Python and of packages; by default those the runtime computes with."""
    found = {"python": platform.python_version()}
    for package in packages:
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
