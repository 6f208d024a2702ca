"""Means, medians and percentiles with 95 % intervals from a seeded bootstrap over frames; shares with Wilson's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

PERCENTILES = (75, 90, 95, 99)
REPLICATES = 1000
SEED = 0
# Of the standard normal distribution: 95 % lie within.
_Z = 1.959963984540054
# Entries of one block of replicates: 32 MB as float64.
_BLOCK = 1 << 22


@dataclass(frozen=True, eq=False, slots=True)
class Resampling:
    """How often each frame was drawn in each replicate: counts (B,F). Frames are drawn whole, because objects in one
    picture are wrong together."""

    counts: NDArray[np.int32]

    @staticmethod
    def of(frames: int, *, seed: int = SEED, replicates: int = REPLICATES) -> Resampling:
        """The same draws for the same number of frames and seed."""
        rng = np.random.default_rng([seed, frames])
        counts = np.stack([
            np.bincount(rng.integers(0, frames, frames), minlength=frames) for _ in range(replicates)
        ]) if frames else np.zeros((replicates, 0))  # fmt: skip
        return Resampling(counts.astype(np.int32))


@dataclass(frozen=True, eq=False, slots=True)
class Sample:
    """Values (n,), and the frame each is of (n,), by its place in a Resampling."""

    values: NDArray[np.float64]
    frames: NDArray[np.intp]


def distribution(values: Sequence[float], frames: Sequence[int], resampling: Resampling | None) -> dict[str, Any]:
    """mean, median, percentiles, and under "ci95" their intervals; all None where there are no values, no "ci95"
    without a resampling."""
    names = ["mean", "median", *(f"p{p}" for p in PERCENTILES)]
    if not len(values):
        return dict.fromkeys(names, None) | ({} if resampling is None else {"ci95": dict.fromkeys(names, None)})
    known = np.asarray(values, float)
    figures = [float(known.mean()), *(float(np.percentile(known, p)) for p in (50, *PERCENTILES))]
    found: dict[str, Any] = dict(zip(names, figures, strict=True))
    if resampling is not None:
        found["ci95"] = dict(zip(names, _intervals(Sample(known, np.asarray(frames)), resampling), strict=True))
    return found


def _intervals(sample: Sample, resampling: Resampling) -> list[list[float]]:
    """[low, high] of the mean and of every percentile; replicates in which no value was drawn do not count."""
    order = np.argsort(sample.values, kind="stable")
    values, frames = sample.values[order], sample.frames[order]
    rows = max(1, _BLOCK // len(values))
    blocks = [
        _replicated(values, resampling.counts[begin : begin + rows][:, frames])
        for begin in range(0, len(resampling.counts), rows)
    ]
    replicated = np.concatenate(blocks)
    low, high = np.nanpercentile(replicated, (2.5, 97.5), axis=0)
    return [[float(a), float(b)] for a, b in zip(low, high, strict=True)]


def _replicated(values: NDArray[np.float64], drawn: NDArray[np.int32]) -> NDArray[np.float64]:
    """(B,Q) mean, median and percentiles of `values` (n,), ascending, each counted `drawn` (B,n) times: what numpy
    gives for the values written out so many times."""
    total = drawn.sum(axis=1)
    cumulative = np.cumsum(drawn, axis=1)
    some = total > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        columns = [np.where(some, drawn @ values / total, np.nan)]
    for percent in (50, *PERCENTILES):
        place = np.maximum(total - 1, 0) * (percent / 100.0)
        below = np.floor(place).astype(np.int64)
        low = _at(values, cumulative, below)
        high = _at(values, cumulative, np.minimum(below + 1, total - 1))
        columns.append(np.where(some, low + (high - low) * (place - below), np.nan))
    return np.stack(columns, axis=1)


def _at(
    values: NDArray[np.float64], cumulative: NDArray[np.integer], place: NDArray[np.integer]
) -> NDArray[np.float64]:
    """The value at a place of each row's written-out, ascending list."""
    index = (cumulative <= place[:, None]).sum(axis=1)
    return values[np.minimum(index, len(values) - 1)]


def share(hits: Sequence[bool]) -> float | None:
    """Of hits, None where there was nothing to hit."""
    return float(np.mean(hits)) if len(hits) else None


def share_interval(hits: Sequence[bool]) -> list[float] | None:
    """Wilson's 95 % interval [low, high] of a share, which is honest where none or all are hits; the bootstrap gives no
    width there."""
    count = len(hits)
    if not count:
        return None
    p = float(np.mean(hits))
    middle = (p + _Z**2 / (2 * count)) / (1 + _Z**2 / count)
    half = _Z * np.sqrt(p * (1 - p) / count + _Z**2 / (4 * count**2)) / (1 + _Z**2 / count)
    # Rounding may leave the share itself outside where all or none are hits.
    return [float(np.clip(middle - half, 0.0, p)), float(np.clip(middle + half, p, 1.0))]
