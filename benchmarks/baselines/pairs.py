"""Poses voted by pairs of points, in the manner of CPPF (You et al., 2022), for every part: head and loss.

A pair of a part's points says, each as a distribution over bins: how far along the pair's line and how far off it the
part's centre lies, the angles between that line and two of the part's axes, and the part's size; and for the axes on
which side of the picture plane they point. `pair_votes` makes a pose of it. CPPF takes pairs of features that no turn
of the camera changes; here the features are those that all variants share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from benchmarks.baselines.bins import Bins, cross_entropy
from benchmarks.baselines.shared import Headless, with_total
from torch import Tensor, nn
from torch.nn import functional

from page_runtime.category import Category
from page_training.config import Fusion
from page_training.layers import Dense, gather_rows
from page_training.losses import Targets, part_weights
from page_training.network import FEATURES, NetworkInputs, ObjectOutputs

# Lengths in the part's guessed diagonals, angles in radians, sizes as the logarithm of true over guessed diagonal.
ALONG = Bins(-1.0, 1.0, 32)
OFF = Bins(0.0, 1.0, 32)
TURN = Bins(0.0, float(np.pi), 36)
SIZE = Bins(-0.7, 0.7, 15)
WIDTHS = (ALONG.count, OFF.count, 2 * TURN.count, 2, SIZE.count)
# Pairs that a point begins, in training and after.
TRAINED, ASKED = 2, 8
HIDDEN = 128
# Of the five things said: together they weigh about what a radius does.
WEIGHT = 0.2
LEAST = 1e-6


@dataclass(frozen=True, slots=True)
class PairOutputs(ObjectOutputs):
    """Q pairs. first, second (B,Q): their points among the dense ones; owner (B,Q): the part both are taken for, K for
    background; guessed (B,K): diagonals in region radii. Logits: along and off (B,Q,32), turns (B,Q,2,36), sides
    (B,Q,2), positive where the axis points away from the camera, sizes (B,Q,15)."""

    first: Tensor
    second: Tensor
    owner: Tensor
    guessed: Tensor
    along: Tensor
    off: Tensor
    turns: Tensor
    sides: Tensor
    sizes: Tensor


def voted_axes(category: Category) -> Tensor:
    """(K,2) which two of each part's axes are voted: its longest ones, as seen best, longest first."""
    return torch.from_numpy(np.stack([np.argsort(-part.extents_unit)[:2] for part in category.parts]))


def pairs_within(labels: Tensor, shifts: int, generator: torch.Generator | None = None) -> tuple[Tensor, Tensor]:
    """(B, shifts x D) first and second of pairs with the same label (B,D): each point begins `shifts` of them, with
    the next ones in a random circle of those with its label; with itself where it has no other."""
    batch, count = labels.shape
    order = (labels + torch.rand(batch, count, generator=generator)).argsort(dim=1)
    sizes = functional.one_hot(labels).sum(dim=1)
    begin = sizes.cumsum(dim=1) - sizes
    label = labels.gather(1, order)
    start, size = begin.gather(1, label), sizes.gather(1, label)
    rank = torch.arange(count) - start
    steps = range(1, shifts + 1)
    second = torch.cat([order.gather(1, start + (rank + step) % size) for step in steps], dim=1)
    return order.repeat(1, shifts), second


class PairNetwork(Headless):
    def __init__(self, category: Category, fusion: Fusion = "gated") -> None:
        super().__init__(category, fusion)
        self.alone = nn.Linear(FEATURES + 3, HIDDEN)
        self.other = nn.Linear(FEATURES + 3, HIDDEN, bias=False)
        self.between = nn.Linear(4, HIDDEN, bias=False)
        self.part = nn.Parameter(torch.zeros(self.num_parts + 1, HIDDEN))
        self.pair = Dense(HIDDEN, HIDDEN)
        self.said = nn.Linear(HIDDEN, sum(WIDTHS))

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, inputs: NetworkInputs, dense: Tensor | None = None
    ) -> PairOutputs:
        known = self.described(inputs, dense)
        common = known.common
        labels = common.part_logits.argmax(-1)
        generator = None if self.training else torch.Generator().manual_seed(0)
        first, second = pairs_within(labels, TRAINED if self.training else ASKED, generator)
        owner = labels.gather(1, first)
        scale = known.frames.axes.square().sum(dim=-1).mean(dim=-1).sqrt()
        # Seen from the part's guessed frame, like everything that the heads of radii say.
        apart = gather_rows(known.in_part, second) - gather_rows(known.in_part, first)
        length = apart.norm(dim=-1, keepdim=True)
        one = self.alone(torch.cat([known.features, known.in_part], dim=-1))
        two = self.other(torch.cat([known.features, known.in_part], dim=-1))
        between = self.between(torch.cat([apart / length.clamp_min(LEAST), length], dim=-1))
        joined = gather_rows(one, first) + gather_rows(two, second) + between + self.part[owner]
        along, off, turns, sides, sizes = self.said(self.pair(functional.relu(joined))).split(WIDTHS, dim=-1)
        return PairOutputs(
            part_logits=common.part_logits,
            log_extents=common.log_extents,
            coarse_logits=common.coarse_logits,
            part_keypoints=common.part_keypoints,
            first=first,
            second=second,
            owner=owner,
            guessed=scale,
            along=along,
            off=off,
            turns=turns.unflatten(-1, (2, TURN.count)),
            sides=sides,
            sizes=sizes,
        )


@dataclass(frozen=True, slots=True)
class PairTruth:
    """What the pairs should have said, as numbers: along, off, size (B,Q), turns (B,Q,2) rad, sides (B,Q,2) 0 or 1;
    labels (B,Q): the part where both points are of the one they are taken for, else K."""

    along: Tensor
    off: Tensor
    turns: Tensor
    sides: Tensor
    size: Tensor
    labels: Tensor


def pair_truth(outputs: PairOutputs, targets: Targets, axes: Tensor) -> PairTruth:
    """axes: `voted_axes` of the category."""
    num_parts = targets.extents_m.shape[1]
    true = [targets.labels.gather(1, one) for one in (outputs.first, outputs.second)]
    same = (true[0] == outputs.owner) & (true[1] == outputs.owner) & (outputs.first != outputs.second)
    labels = torch.where(same, outputs.owner, num_parts)
    own = outputs.owner.clamp_max(num_parts - 1)
    rows = torch.arange(len(own)).unsqueeze(1)
    one, two = (gather_rows(targets.points, index) for index in (outputs.first, outputs.second))
    line = functional.normalize(two - one, dim=-1, eps=LEAST)
    to_center = targets.origins[rows, own] - one
    along = (to_center * line).sum(-1)
    off = (to_center - along.unsqueeze(-1) * line).norm(dim=-1)
    # The axes of a part are the columns of its rotation.
    directions = torch.take_along_dim(targets.R, axes.view(1, num_parts, 1, 2), dim=3)[rows, own]
    cosines = (line.unsqueeze(2) @ directions).squeeze(2)
    guessed = outputs.guessed[rows, own]
    return PairTruth(
        along=along / guessed,
        off=off / guessed,
        turns=cosines.clamp(-1.0, 1.0).acos(),
        sides=(directions[:, :, 2] > 0.0).float(),
        size=(targets.diagonals[rows, own] / guessed).log(),
        labels=labels,
    )


def pair_loss(outputs: PairOutputs, targets: Targets, axes: Tensor, **weights: float) -> dict[str, Tensor]:
    """What is said of lengths, angles and sizes as a divergence from the labels, the sides as a cross-entropy; means
    over the parts of means over their pairs. axes: `voted_axes` of the category."""
    truth = pair_truth(outputs, targets, axes)
    counted = WEIGHT * part_weights(truth.labels, targets.extents_m.shape[1])
    sides = functional.binary_cross_entropy_with_logits(outputs.sides, truth.sides, reduction="none").mean(-1)
    said = {
        "along": cross_entropy(outputs.along, ALONG.labels(truth.along)),
        "off": cross_entropy(outputs.off, OFF.labels(truth.off)),
        "turn": cross_entropy(outputs.turns, TURN.labels(truth.turns)).mean(-1),
        "toward": sides,
        "size": cross_entropy(outputs.sizes, SIZE.labels(truth.size)),
    }
    own = {name: (one * counted).sum() for name, one in said.items()}
    return with_total(outputs, targets, own, **weights)
