"""What the network should say, and which of it where several poses look the same (`page_runtime.symmetry`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from page_runtime.category import Category, Part
from page_runtime.symmetry import Interchange, Symmetry, nearest_turn, turn_of
from page_training.losses import Targets
from page_training.network import ObjectOutputs


class Truth(NamedTuple):
    """R (B,K,3,3), t (B,K,3) and extents_m (B,K,3) of the parts; labels (B,D), points and normals (B,D,3) of the dense
    points and coarse_labels (B,P) of the coarse ones; metres, centred frame."""

    R: Tensor
    t: Tensor
    extents_m: Tensor
    labels: Tensor
    coarse_labels: Tensor
    points: Tensor
    normals: Tensor


def renamed(
    chosen: Tensor, order: tuple[int, ...], R: Tensor, t: Tensor, extents_m: Tensor, labels: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """R (B,K,3,3), t and extents_m (B,K,3) and labels (B,N) with part k described as part order[k], a swap, where
    `chosen` (B,) is true."""
    swap = torch.tensor([*order, len(order)])
    parts = swap[:-1]
    wide = chosen.view(-1, 1, 1)
    return (
        torch.where(wide.unsqueeze(-1), R[:, parts], R),
        torch.where(wide, t[:, parts], t),
        torch.where(wide, extents_m[:, parts], extents_m),
        torch.where(chosen.unsqueeze(1), swap[labels], labels),
    )


def targets_of(truth: Truth, category: Category) -> Targets:
    """What the network should have said of a batch with this truth."""
    batch, num_parts = len(truth.labels), len(category.parts)
    diagonals_m = truth.extents_m.norm(dim=-1)
    keypoints_unit = torch.from_numpy(np.stack([part.keypoints_unit for part in category.parts])).float()
    keypoints = (diagonals_m[..., None, None] * keypoints_unit) @ truth.R.transpose(-1, -2) + truth.t.unsqueeze(-2)
    own = truth.labels.clamp_max(num_parts - 1)
    dense_keypoints = keypoints[torch.arange(batch).unsqueeze(1), own]
    offset = dense_keypoints - truth.points.unsqueeze(2)
    facing = (offset[:, :, : category.num_voted] * truth.normals.unsqueeze(2)).sum(-1)
    unit = category.region_radius_m
    return Targets(
        labels=truth.labels,
        coarse_labels=truth.coarse_labels,
        radii=offset.norm(dim=-1) / unit,
        keypoints=dense_keypoints / unit,
        sides=(facing > 0).float(),
        part_keypoints=keypoints / unit,
        extents_m=truth.extents_m,
        diagonals=diagonals_m / unit,
        R=truth.R,
        origins=truth.t / unit,
        points=truth.points / unit,
    )


def settled_targets(truth: Truth, targets: Targets, outputs: ObjectOutputs, category: Category) -> Targets:
    """The targets made of a truth or, where other poses look the same, those nearest to what the network said.

    Demanding one of several that look alike would teach their mean.
    """
    if category.interchange is None and not any(part.symmetry for part in category.parts):
        return targets
    with torch.no_grad():
        if category.interchange is not None:
            everywhere = torch.ones(len(truth.labels), dtype=torch.bool)
            other = _interchanged(truth, category.interchange, everywhere)
            costs = [_costs(outputs, one) for one in (targets, targets_of(other, category))]
            truth = _interchanged(truth, category.interchange, costs[1] < costs[0])
        guesses = outputs.part_keypoints[-1] * category.region_radius_m
        R = truth.R.clone()
        for k, part in enumerate(category.parts):
            if part.symmetry is not None:
                R[:, k] = _turned(part, part.symmetry, R[:, k], guesses[:, k] - truth.t[:, k : k + 1])
        return targets_of(truth._replace(R=R), category)


def _interchanged(truth: Truth, rule: Interchange, chosen: Tensor) -> Truth:
    """The other description of the same objects where `chosen` (B,) is true."""
    R, t, extents_m, labels = renamed(chosen, rule.parts, truth.R, truth.t, truth.extents_m, truth.labels)
    coarse = renamed(chosen, rule.parts, truth.R, truth.t, truth.extents_m, truth.coarse_labels)[3]
    turn = torch.from_numpy(rule.turn).float()
    R = torch.where(chosen.view(-1, 1, 1, 1), R @ turn, R)
    return truth._replace(R=R, t=t, extents_m=extents_m, labels=labels, coarse_labels=coarse)


def _costs(outputs: ObjectOutputs, targets: Targets) -> Tensor:
    """(B,) how far what was said is from the targets: mean cross-entropy of the labels and mean error of the parts'
    keypoints in diagonals."""
    entropy = functional.cross_entropy(outputs.part_logits.transpose(1, 2), targets.labels, reduction="none").mean(1)
    errors = (outputs.part_keypoints[-1] - targets.part_keypoints).abs().mean(dim=(-2, -1)) / targets.diagonals
    present = torch.stack([(targets.labels == k).any(1) for k in range(errors.shape[1])], dim=1)
    return entropy + (errors * present).sum(1) / present.sum(1).clamp_min(1)


def _turned(part: Part, symmetry: Symmetry, R: Tensor, offsets: Tensor) -> Tensor:
    """R (B,3,3) turned about the symmetry's axis towards guessed keypoints: offsets (B,n,3) from the origin."""
    moments = R.transpose(1, 2) @ offsets.transpose(1, 2) @ torch.from_numpy(part.keypoints_unit).float()
    turns = [turn_of(symmetry, nearest_turn(symmetry, one)) for one in moments.double().numpy()]
    return R @ torch.from_numpy(np.stack(turns)).float()
