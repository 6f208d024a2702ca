"""The same frames under other settings that a bundle allows: threads, rho, looks, voters, picture size."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from page_runtime.bench import report, time_windows
from page_runtime.estimator import MAX_LOOKS, estimate
from page_runtime.machine import check_threads
from page_runtime.network import Network
from page_runtime.part_poses import MAX_VOTERS
from page_runtime.recorded import FrameEntry, Pixels, Source
from page_runtime.sampling import Region
from page_runtime.validation.comparison import Comparison, compared
from page_runtime.validation.figures import pooled_figures

# What may vary, and its unit. N, S and K are the bundle's: benchmarks/latency_sweeps.py makes bundles of others.
VARIES = {
    "threads": "threads",
    "rho": "voxel size rho, mm",
    "looks": "looks at most",
    "voters": "voting points a part",
    "size": "picture size, share",
}
# A sweep compares settings by their medians, and there are many settings.
MEASUREMENTS = 30


@dataclass(frozen=True, slots=True)
class Sweep:
    """varies: of VARIES; values: in its unit."""

    varies: str
    values: tuple[float, ...]


def sweep_from(text: str) -> Sweep:
    """From what a command is given, such as rho=3,5,10; ValueError says what it takes."""
    varies, equals, listed = text.partition("=")
    try:
        values = tuple(float(one) for one in listed.split(","))
    except ValueError:
        values = ()
    whole = varies in ("threads", "looks", "voters")
    if varies not in VARIES or not equals or not values or min(values) <= 0 or (
        whole and any(one != int(one) for one in values)
    ) or not np.isfinite(values).all():  # fmt: skip
        raise ValueError(f"expected {', '.join(VARIES)} and values above 0, such as rho=3,5,10; got {text!r}")
    if varies == "threads":
        check_threads(int(max(values)))
    return Sweep(varies, values)


def run_sweep(
    sweep: Sweep,
    network: Network,
    source: Source,
    *,
    load: Callable[[int], Network],
    max_looks: int,
    on_step: Callable[[], None] = lambda: None,
) -> list[dict[str, Any]]:
    """Of each value its times, and where the source has truth its errors. load: the bundle with so many threads."""
    found, opencv_threads = [], cv2.getNumThreads()
    for value in sweep.values:
        settings: dict[str, Any] = {"max_looks": max_looks, "max_voters": MAX_VOTERS}
        swept, frames = network, source
        if sweep.varies == "threads":
            cv2.setNumThreads(int(value))
            swept = load(int(value))
        elif sweep.varies == "rho":
            swept = copy(network)
            swept.metadata = replace(network.metadata, voxel_m=value * 1e-3)
        elif sweep.varies == "looks":
            settings["max_looks"] = min(int(value), MAX_LOOKS)
        elif sweep.varies == "voters":
            settings["max_voters"] = int(value)
        else:
            frames = resized(source, value)
        windows = time_windows(swept, frames, min_measurements=MEASUREMENTS, counters=(), **settings)
        times = report(windows, threads=0)
        found.append({
            "value": value,
            **{name: times[name] for name in ("stages", "total", "stability", "measurements")},
            "errors": pooled_errors(swept, frames, settings) if source.has_truth else None,
        })  # fmt: skip
        on_step()
    cv2.setNumThreads(opencv_threads)
    return found


def pooled_errors(network: Network, source: Source, settings: dict[str, Any]) -> dict[str, Any]:
    """Of all visible parts together: medians, and the share of failures. settings: of `estimate`, by name."""
    category, comparisons = network.metadata.category, list[Comparison]()
    for recorded in source:
        for i, instance in enumerate(recorded.instances):
            if instance.region is not None and instance.truths is not None:
                pose = estimate(network, recorded.frame, instance.region, **settings)
                comparisons.append(compared(category, pose, instance.truths, frame=recorded.frame.index, instance=i))
    figures = pooled_figures(comparisons, range(len(comparisons)), None)
    return {
        "visible": figures["visible"],
        "rotation_deg": figures["rotation_deg"]["median"],
        "translation_m": figures["translation_m"]["median"],
        "failure_rate": figures["failure_rate"],
    }


def resized(source: Source, factor: float) -> Source:
    """The source with pictures of so much of their width and height: colour averaged, depth the nearest reading."""
    return replace(source, entries=tuple(_resized(entry, factor) for entry in source.entries))


def _resized(entry: FrameEntry, factor: float) -> FrameEntry:
    camera = entry.camera
    width, height = max(1, round(camera.width * factor)), max(1, round(camera.height * factor))
    across, down = width / camera.width, height / camera.height

    def region(of: Region) -> Region:
        return round(of[0] * across), round(of[1] * down), max(1, round(of[2] * across)), max(1, round(of[3] * down))

    def decode() -> Pixels:
        frame = entry.read().frame
        kind = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
        color = cv2.resize(frame.color, (width, height), interpolation=kind)
        depth_m = cv2.resize(frame.depth_m, (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
        return np.asarray(color, np.uint8), np.asarray(depth_m, np.float32)

    instances = tuple(one if one.region is None else replace(one, region=region(one.region)) for one in entry.instances)
    return replace(entry, camera=camera.resized(width, height), instances=instances, decode=decode)
