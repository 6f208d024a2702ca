"""What each form of a bundle costs and gives on this computer, and which one to take."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from page_export.parity import Inputs, pose_of
from page_runtime.evaluation import part_errors
from page_runtime.network import Network
from page_runtime.recorded import PartTruth

MAX_POSE_ERROR = 1.1
# Differences below this come and go between two measurements.
AS_QUICK = 1.03
LOADS = 5
THREADS = (1, 2)


@dataclass(frozen=True, slots=True)
class Latency:
    """Of a forward pass, the neighbour search not included."""

    p50_ms: float
    p95_ms: float


@dataclass(frozen=True, slots=True)
class Measured:
    """A form of a bundle. rotation_deg, translation_mm: medians over visible parts against the truth. error: the larger
    of their ratios to the original's. failures: share of visible parts that `evaluation` calls so."""

    name: str
    size_bytes: int
    load_ms: float
    latency: dict[int, Latency]
    rotation_deg: float
    translation_mm: float
    failures: float
    error: float

    def refused(self, bound: float, failures: float) -> bool:
        """Whether its poses are worse than `bound` times the original's, or one part in a hundred more fails."""
        return not self.error <= bound or self.failures > failures + 0.01

    def document(self) -> dict[str, Any]:
        """In JSON's types."""
        return {
            "name": self.name,
            "size_bytes": self.size_bytes,
            "load_ms": round(self.load_ms, 1),
            "latency": {
                str(threads): {"p50_ms": round(one.p50_ms, 2), "p95_ms": round(one.p95_ms, 2)}
                for threads, one in self.latency.items()
            },
            "rotation_deg": round(self.rotation_deg, 3),
            "translation_mm": round(self.translation_mm, 3),
            "failures": round(self.failures, 4),
            "error": round(self.error, 3),
        }


TrueSample = tuple[Inputs, tuple[PartTruth, ...]]


def measure(
    bundles: dict[str, Path],
    samples: Sequence[TrueSample],
    *,
    rounds: int = 3,
    on_sample: Callable[[], None] = lambda: None,
) -> list[Measured]:
    """The first bundle is the original. All are timed in turns, so that what else the computer does meets all alike."""
    loads = {name: sorted(_load_ms(path) for _ in range(LOADS))[LOADS // 2] for name, path in bundles.items()}
    times: dict[str, dict[int, list[float]]] = {name: {threads: [] for threads in THREADS} for name in bundles}
    errors: dict[str, list[tuple[float, float, bool]]] = {name: [] for name in bundles}
    for threads in THREADS:
        networks = {name: Network(path, threads=threads) for name, path in bundles.items()}
        for network in networks.values():
            network.warm_up()
        for turn in range(rounds):
            for (sample, neighbours), truths in samples:
                for name, network in networks.items():
                    # Twice, as the one before left the caches full of its own weights.
                    network.run_raw(sample, neighbours)
                    begin = time.perf_counter()
                    values = network.run_raw(sample, neighbours)
                    times[name][threads].append(1e3 * (time.perf_counter() - begin))
                    if turn == 0 and threads == THREADS[0]:
                        category = network.metadata.category
                        found = part_errors(category, pose_of(network.metadata, sample, values), truths)
                        errors[name] += [
                            (
                                np.inf if one.rotation_rad is None else float(np.degrees(one.rotation_rad)),
                                np.inf if one.translation_m is None else 1e3 * one.translation_m,
                                one.failed,
                            )
                            for one in found
                        ]
                on_sample()
    return _measured(bundles, loads, times, errors)


def _load_ms(path: Path) -> float:
    begin = time.perf_counter()
    Network(path, threads=1)
    return 1e3 * (time.perf_counter() - begin)


def _measured(
    bundles: dict[str, Path],
    loads: dict[str, float],
    times: dict[str, dict[int, list[float]]],
    errors: dict[str, list[tuple[float, float, bool]]],
) -> list[Measured]:
    results: list[Measured] = []
    for name, path in bundles.items():
        columns = list(zip(*errors[name], strict=True))
        rotation, translation = float(np.median(columns[0])), float(np.median(columns[1]))
        failures = np.mean(columns[2])
        first = results[0] if results else None
        ratio = (
            1.0 if first is None else max(rotation / first.rotation_deg, translation / max(first.translation_mm, 1e-9))
        )
        latency = {
            threads: Latency(float(np.median(values)), float(np.percentile(values, 95)))
            for threads, values in times[name].items()
        }
        results.append(
            Measured(name, path.stat().st_size, loads[name], latency, rotation, translation, float(failures), ratio)
        )
    return results


def recommended(results: Sequence[Measured], bound: float = MAX_POSE_ERROR) -> Measured:
    """Of those that are not refused, the smallest among the quickest on two threads; the original is never refused."""
    first, *others = results
    allowed = [first, *(one for one in others if not one.refused(bound, first.failures))]
    least = min(one.latency[THREADS[-1]].p50_ms for one in allowed)
    quick = [one for one in allowed if one.latency[THREADS[-1]].p50_ms <= AS_QUICK * least]
    return min(quick, key=lambda one: one.size_bytes)
