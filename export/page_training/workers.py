"""Several processes at one training: torchrun starts them, each takes its rows of every batch, gloo adds them up."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray
from torch import distributed, nn
from torch.nn.parallel import DistributedDataParallel


@dataclass(frozen=True, slots=True)
class Workers:
    """This process among those at the same training."""

    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        """Whether this is the one that writes files and reports."""
        return self.rank == 0

    def rows(self, records: NDArray[Any]) -> NDArray[Any]:
        """Its own of a batch's records, as many as each other worker's.

        A loss weighs alike the parts that are seen in its own rows, so the mean over workers differs a little from the
        loss of all rows at once.
        """
        return records[self.rank :: self.count]

    def joined(self, network: nn.Module, *, all_used: bool) -> nn.Module:
        """The network for training: its gradients are the mean over the workers, its buffers the first one's.

        all_used: whether every parameter has a gradient in every step; looking for those without costs time.
        """
        return network if self.count == 1 else DistributedDataParallel(network, find_unused_parameters=not all_used)

    def means(self, values: dict[str, float]) -> dict[str, float]:
        """Each value's mean over the workers."""
        if self.count == 1:
            return values
        together = torch.tensor(list(values.values()), dtype=torch.float64)
        distributed.all_reduce(together)
        return dict(zip(values, (together / self.count).tolist(), strict=True))


def join_workers(batch_size: int) -> Workers:
    """The workers torchrun has started, or this process alone; ValueError where a batch cannot be shared evenly."""
    workers = Workers(int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1")))
    if batch_size % workers.count:
        raise ValueError(
            f"batch_size: expected a multiple of the {workers.count} processes, got {batch_size}; change either"
        )
    if workers.count > 1 and not distributed.is_initialized():
        distributed.init_process_group("gloo")
    return workers


def leave_workers() -> None:
    """Wait for the others and end the group, where there is one: a process that exits while the group's threads still
    run is aborted, now and then. A network that is still joined keeps them running; let go of it first."""
    if distributed.is_initialized():
        distributed.barrier()
        distributed.destroy_process_group()
