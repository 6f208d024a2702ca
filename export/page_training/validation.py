"""How a network does on validation frames while it trains: losses, and a picture to look at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from page_runtime.category import Category
from page_training.batches import Batch, make_batch
from page_training.losses import own_unit, page_loss
from page_training.network import NetworkOutputs, PageNetwork
from page_training.targets import settled_targets

_SHOWN = 8
# Of parts 0, 1, ..., RGB; background is left as it is.
_COLORS = np.array([(255, 64, 64), (64, 220, 64), (80, 120, 255), (255, 200, 40), (200, 80, 255), (40, 220, 220)])


@torch.no_grad()
def validation_losses(
    network: PageNetwork,
    shards: list[NDArray[Any]],
    category: Category,
    loss: Callable[..., dict[str, Tensor]] = page_loss,
    limit: int = 256,
) -> dict[str, float]:
    """Mean losses on the first `limit` validation frames, not augmented."""
    network.eval()
    generator = torch.Generator().manual_seed(0)
    sums: dict[str, float] = {}
    records = np.concatenate(shards)[:limit]
    for start in range(0, len(records), 16):
        chunk = records[start : start + 16]
        batch = make_batch(chunk, category, dense_points=1024, generator=generator, augmentation=None)
        outputs = network(batch.inputs, batch.dense)
        for name, value in loss(outputs, settled_targets(batch.truth, batch.targets, outputs, category)).items():
            sums[name] = sums.get(name, 0.0) + float(value) * len(chunk)
    network.train()
    return {name: value / len(records) for name, value in sums.items()}


@torch.no_grad()
def validation_picture(network: PageNetwork, shards: list[NDArray[Any]], category: Category) -> NDArray[np.uint8]:
    """(H,W,3) RGB, the first frames in columns: their crops; the points in the colours of the parts they are taken for;
    of a network of radii then in those of their error, from blue at 0 to red at a tenth of the part's diagonal."""
    network.eval()
    records = np.concatenate([np.array(shard[:_SHOWN]) for shard in shards])[:_SHOWN]
    generator = torch.Generator().manual_seed(0)
    batch = make_batch(records, category, dense_points=1024, generator=generator, augmentation=None)
    outputs = network(batch.inputs, batch.dense)
    network.train()
    targets = settled_targets(batch.truth, batch.targets, outputs, category)
    labels = outputs.part_logits.argmax(-1)
    of_part = torch.from_numpy(_COLORS)[labels % len(_COLORS)]
    crops = records["image"]
    rows = [crops, _dotted(crops, batch, of_part, labels < len(category.parts))]
    if isinstance(outputs, NetworkOutputs):
        error = (outputs.radii - targets.radii).abs().mean(-1, keepdim=True)
        share = (error / own_unit(targets)).clamp(0.0, 1.0)
        warm = torch.cat([share, torch.zeros_like(share), 1.0 - share], dim=-1) * 255
        rows.append(_dotted(crops, batch, warm, targets.labels < len(category.parts)))
    return np.vstack([np.hstack(list(row)) for row in rows])


def _dotted(crops: NDArray[np.uint8], batch: Batch, colors: Tensor, shown: Tensor) -> NDArray[np.uint8]:
    """(B,S,S,3): the crops at half their brightness with a dot of 3 x 3 px for each shown dense point."""
    size = crops.shape[1]
    drawn = crops // 2
    pixels = torch.take_along_dim(batch.inputs.pixels, batch.dense.unsqueeze(-1), dim=1)
    columns, rows = pixels.round().clamp(1, size - 2).to(torch.int64).unbind(-1)
    row, point = np.nonzero(shown.numpy())
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            drawn[row, rows.numpy()[row, point] + down, columns.numpy()[row, point] + right] = colors.numpy()[
                row, point
            ].astype(np.uint8)
    return drawn
