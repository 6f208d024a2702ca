"""Records into augmented network inputs and targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from page_runtime.category import Category
from page_runtime.neighbours import find_neighbours
from page_training.config import Augmentation
from page_training.losses import Targets
from page_training.network import NetworkInputs
from page_training.records import NEIGHBOUR_TABLES
from page_training.targets import Truth, renamed, targets_of


@dataclass(frozen=True, slots=True)
class Batch:
    """truth: what the targets were made of, so that others that look the same can be (`targets`)."""

    inputs: NetworkInputs
    targets: Targets
    dense: Tensor
    truth: Truth


def _turns(generator: torch.Generator, batch: int, sigma: float) -> Tensor:
    """(B,3,3) random rotations of about `sigma` radians."""
    vector = torch.randn(batch, 3, generator=generator) * sigma
    x, y, z = vector.unbind(1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).view(-1, 3, 3)
    return torch.linalg.matrix_exp(skew)


def _jitter(points: Tensor, tables: list[Tensor], generator: torch.Generator, settings: Augmentation) -> None:
    """Noise on the points (B,N,3) of some rows, in place, with the neighbours the runtime would find then."""
    for row in (
        (torch.rand(len(points), generator=generator) < settings.jitter_probability).nonzero().flatten().tolist()
    ):
        sigma_m = settings.jitter_limit_m * torch.rand(1, generator=generator).square()
        points[row] += sigma_m * torch.randn(points.shape[1:], generator=generator)
        found = find_neighbours((points[row] - points[row].mean(dim=0)).numpy(), answered=points.shape[1])
        for name, table in zip(NEIGHBOUR_TABLES, tables, strict=True):
            table[row] = torch.from_numpy(getattr(found, name).astype(np.int64))


def _augment_image(image: Tensor, generator: torch.Generator, settings: Augmentation) -> Tensor:
    """image (B,3,S,S) in [0,1] with other light, tint, hue order and noise; some gray, some blank."""
    batch = len(image)

    def normal(*shape: int) -> Tensor:
        return torch.randn(batch, *shape, generator=generator)

    def chosen(probability: float) -> Tensor:
        return torch.rand(batch, generator=generator) < probability

    for row in chosen(settings.shuffle_probability).nonzero().flatten().tolist():
        image[row] = image[row, torch.randperm(3, generator=generator)]
    gray = chosen(settings.gray_probability)
    image[gray] = image[gray].mean(dim=1, keepdim=True)
    gain = (settings.gain_sigma * normal(1, 1, 1) + settings.tint_sigma * normal(3, 1, 1)).exp()
    image = image * gain + settings.offset_sigma * normal(1, 1, 1)
    grain = torch.randn(image.shape[2:], generator=generator)
    image = (image + settings.noise_sigma * normal(1, 1, 1).abs() * grain).clamp_(0.0, 1.0)
    image[chosen(settings.blank_probability)] = 0.5
    return image


def choose_dense(labels: Tensor, count: int, num_classes: int, generator: torch.Generator) -> Tensor:
    """(B,count) distinct point indices, small parts over-represented by the square root of their rarity."""
    members = torch.nn.functional.one_hot(labels, num_classes).sum(dim=1)
    weight = members.clamp_min(1).to(torch.float32).rsqrt().gather(1, labels)
    exponential = torch.empty(labels.shape).exponential_(generator=generator)
    return (weight / exponential).topk(count, dim=1, sorted=False).indices


def make_batch(
    records: NDArray[Any],
    category: Category,
    *,
    dense_points: int,
    generator: torch.Generator,
    augmentation: Augmentation | None,
) -> Batch:
    """A training batch from records of cache.record_type; no augmentation gives the frames as they are."""
    num_parts = len(category.parts)
    image = torch.from_numpy(records["image"].astype(np.float32) / 255.0).permute(0, 3, 1, 2)
    points = torch.from_numpy(records["points"].copy())
    pixels = torch.from_numpy(records["pixels"].copy())
    normals = torch.from_numpy(records["normals"].astype(np.float32))
    labels = torch.from_numpy(records["labels"].astype(np.int64))
    T_center_part = torch.from_numpy(records["T_center_part"].copy())
    extents_m = torch.from_numpy(records["extents_m"].copy())
    R, t = T_center_part[..., :3, :3], T_center_part[..., :3, 3]
    tables = [torch.from_numpy(records[name].astype(np.int64)) for name in NEIGHBOUR_TABLES]
    batch = len(records)
    mirror_rule = category.mirror if category.joints_mirror else None
    if augmentation is not None:
        image = _augment_image(image, generator, augmentation)
        flip = torch.rand(batch, generator=generator) < augmentation.flip_probability
        flip &= mirror_rule is not None
        image[flip] = image[flip].flip(-1)
        pixels[flip, :, 0] = (image.shape[-1] - 1) - pixels[flip, :, 0]
        sign = torch.where(flip, -1.0, 1.0).view(-1, 1, 1)
        mirror = _reversal(sign, 0)
        # A mirrored object is again one of its category, with an axis of the part frame mirrored too: R' = M R F.
        part_mirror = mirror if mirror_rule is None else _reversal(sign, mirror_rule.axis)
        if mirror_rule is not None and mirror_rule.parts:
            R, t, extents_m, labels = renamed(flip, mirror_rule.parts, R, t, extents_m, labels)
        turn = _turns(generator, batch, augmentation.turn_sigma_rad) @ mirror
        scale = (augmentation.scale_sigma * torch.randn(batch, generator=generator)).exp().view(-1, 1, 1)
        points = scale * (points @ turn.transpose(1, 2))
        _jitter(points, tables, generator, augmentation)
        normals = normals @ turn.transpose(1, 2)
        t = scale * (t @ turn.transpose(1, 2))
        R = turn.unsqueeze(1) @ R @ part_mirror.unsqueeze(1)
        extents_m = scale * extents_m
    dense = choose_dense(labels, dense_points, num_parts + 1, generator)
    truth = Truth(
        R=R,
        t=t,
        extents_m=extents_m,
        labels=labels.gather(1, dense),
        coarse_labels=labels[:, : tables[0].shape[1]],
        points=torch.take_along_dim(points, dense.unsqueeze(-1), dim=1),
        normals=torch.take_along_dim(normals, dense.unsqueeze(-1), dim=1),
    )
    unit = category.region_radius_m
    return Batch(
        inputs=NetworkInputs(image.contiguous(memory_format=torch.channels_last), points / unit, pixels, *tables),
        targets=targets_of(truth, category),
        dense=dense,
        truth=truth,
    )


def _reversal(sign: Tensor, axis: int) -> Tensor:
    """(B,3,3) diagonal of ones but for `sign` (B,1,1) at `axis`."""
    ones = torch.ones(len(sign), 1, 2)
    columns = [ones[..., :1]] * 3
    columns[axis] = sign
    return torch.diag_embed(torch.cat(columns, dim=2).squeeze(1))
