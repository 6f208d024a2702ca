"""Times, medians and shares as JSON holds them.

Wall times are those of a machine that may be busy, CPU times (`time.process_time`) suffer less from that; both are the
least of a few repeats.
"""

import math
from collections.abc import Callable, Sequence
from time import perf_counter, process_time
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


T = TypeVar("T")


def best_of(repeats: int, work: Callable[[], T]) -> tuple[T, float, float]:
    """The result, the least wall time and the least CPU time, ms."""
    walls, processor = [], []
    while True:
        wall, cpu = perf_counter(), process_time()
        result = work()
        processor.append((process_time() - cpu) * 1e3)
        walls.append((perf_counter() - wall) * 1e3)
        if len(walls) >= repeats:
            return result, min(walls), min(processor)


def percentiles(values: Sequence[float]) -> dict[str, float | None]:
    return {"p50": figure(np.percentile(values, 50)), "p95": figure(np.percentile(values, 95))}


def figure(value: float | np.floating) -> float | None:
    """Four significant digits; None for what is not finite, such as the median error of poses mostly missing."""
    return float(f"{float(value):.4g}") if math.isfinite(value) else None


def median(values: Sequence[float] | FloatArray) -> float | None:
    return figure(np.percentile(values, 50, method="lower")) if len(values) else None


def certified_share(gaps: Sequence[int]) -> float | None:
    """Of keypoints whose maximum is certain to be the grid's; of others the evaluation budget ran out."""
    return figure(np.mean(np.array(gaps) == 0))


def distance_mm(one: FloatArray, other: FloatArray) -> float:
    return float(1e3 * np.linalg.norm(one - other))
