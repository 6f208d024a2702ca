"""Whether a confidence means what it says: the share of right parts in bins of the confidence they came with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.0)


@dataclass(frozen=True, slots=True)
class ReliabilityBin:
    """Parts whose confidence is in [low, high): how many, their mean confidence, the share of them that is right."""

    low: float
    high: float
    count: int
    confidence: float
    right: float


def reliability(
    confidence: NDArray[np.float64], right: NDArray[np.bool_], edges: tuple[float, ...] = EDGES
) -> list[ReliabilityBin]:
    """The bins that hold any part; the last one includes its upper edge."""
    found = []
    for low, high in pairwise(edges):
        inside = (confidence >= low) & ((confidence < high) | (high == edges[-1]))
        if inside.any():
            found.append(
                ReliabilityBin(
                    low, high, int(inside.sum()), float(confidence[inside].mean()), float(right[inside].mean())
                )
            )
    return found


def calibration_error(bins: Sequence[ReliabilityBin]) -> float:
    """Mean distance of confidence and share over all parts (expected calibration error)."""
    return sum(b.count * abs(b.confidence - b.right) for b in bins) / sum(b.count for b in bins)
