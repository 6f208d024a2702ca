"""Numbers said as a distribution over bins, and read from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional


@dataclass(frozen=True, slots=True)
class Bins:
    """count values evenly from low to high, both included."""

    low: float
    high: float
    count: int

    def labels(self, values: Tensor) -> Tensor:
        """(...,count) what a distribution over them should be: each value shared by the two it lies between, values
        beyond by the ends."""
        place = ((values - self.low) / (self.high - self.low)).clamp(0.0, 1.0) * (self.count - 1)
        below = place.floor().clamp_max(self.count - 2).long()
        share = (place - below).unsqueeze(-1)
        first, second = (functional.one_hot(one, self.count) for one in (below, below + 1))
        return first * (1.0 - share) + second * share

    def values(self, logits: NDArray[np.float32]) -> NDArray[np.float64]:
        """(...,) the mean over the likeliest bin and its neighbours: exact for `labels`, and of two peaks one."""
        shape = logits.shape[:-1]
        flat = np.asarray(logits, np.float64).reshape(-1, self.count)
        likelihood = np.exp(flat - flat.max(axis=1, keepdims=True))
        index = np.arange(self.count)
        near = np.abs(index - likelihood.argmax(axis=1)[:, None]) <= 1
        weights = likelihood * near
        place = (weights * index).sum(axis=1) / weights.sum(axis=1)
        return (self.low + place * (self.high - self.low) / (self.count - 1)).reshape(shape)


def cross_entropy(logits: Tensor, labels: Tensor) -> Tensor:
    """(...,) beyond the least there is, which soft labels do not bring to zero: the divergence from labels (...,C)."""
    least = torch.special.entr(labels).sum(-1)
    return -(labels * functional.log_softmax(logits, dim=-1)).sum(-1) - least
