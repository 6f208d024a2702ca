"""Keypoints from an anchor that attention picks, in the manner of 6-PACK (Wang et al., 2020), for every part.

Anchors stand on a grid about where the part is thought to be. Each pools the features of the points around it, says
how likely it is the one nearest the part's origin, and where the part's keypoints lie from it. 6-PACK lays its grid
into the pose of the frame before; here it lies in the part's guessed frame. Its keypoints are found without
supervision over two views; here they are the category's, as those of every other variant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from benchmarks.baselines.shared import Headless, with_total
from torch import Tensor, nn
from torch.nn import functional

from page_runtime.bundle import BundleMetadata
from page_runtime.category import Category
from page_runtime.pose import ArticulatedPose
from page_runtime.sampling import RegionSample
from page_runtime.similarity import umeyama
from page_training.config import Fusion
from page_training.layers import Dense
from page_training.losses import RADIUS_UNIT, Targets, parts_present
from page_training.network import FEATURES, Described, NetworkInputs, ObjectOutputs
from page_training.regressed import members_of, plain_pose

# The grid: so many anchors along each axis, out to REACH of the part's guessed diagonal on either side.
ACROSS = 5
REACH = 0.4
# Of an anchor's neighbourhood: the standard deviation of its weights, in guessed diagonals.
NEAR = 0.15
HIDDEN = 128


@dataclass(frozen=True, slots=True)
class AnchorOutputs(ObjectOutputs):
    """A anchors a part. attention (B,K,A): logits of being the one; anchors (B,K,A,3) and the keypoints each proposes
    (B,K,A,n,3), region radii, centred frame."""

    attention: Tensor
    anchors: Tensor
    proposals: Tensor


class AnchorNetwork(Headless):
    grid: Tensor

    def __init__(self, category: Category, fusion: Fusion = "gated") -> None:
        super().__init__(category, fusion)
        line = torch.linspace(-REACH, REACH, ACROSS)
        self.register_buffer("grid", torch.cartesian_prod(line, line, line), persistent=False)
        self.pooled = nn.Linear(FEATURES, HIDDEN)
        self.placed = nn.Linear(6, HIDDEN, bias=False)
        self.part = nn.Parameter(torch.zeros(self.num_parts, 1, HIDDEN))
        self.anchor = Dense(HIDDEN, HIDDEN)
        self.attention = nn.Linear(HIDDEN, 1)
        self.offsets = nn.Linear(HIDDEN, 3 * self.num_keypoints)
        # At first every anchor proposes the guess: the keypoints where the part's frame puts them.
        nn.init.zeros_(self.offsets.weight)
        nn.init.zeros_(self.offsets.bias)

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, inputs: NetworkInputs, dense: Tensor | None = None
    ) -> AnchorOutputs:
        known = self.described(inputs, dense)
        features = self._anchor_features(known)
        offsets = self.offsets(features).view(*features.shape[:3], self.num_keypoints, 3)
        from_anchor = self.unit_keypoints.unsqueeze(1) - self.grid.view(-1, 1, 3) + offsets
        keypoints = (self.grid.view(-1, 1, 3) + from_anchor).flatten(2, 3)
        common = known.common
        return AnchorOutputs(
            part_logits=common.part_logits,
            log_extents=common.log_extents,
            coarse_logits=common.coarse_logits,
            part_keypoints=common.part_keypoints,
            attention=self.attention(features).squeeze(-1),
            anchors=known.frames.place(self.grid.expand(self.num_parts, -1, 3)),
            proposals=known.frames.place(keypoints).view(*offsets.shape),
        )

    def _anchor_features(self, known: Described) -> Tensor:
        """(B,K,A,HIDDEN): of the part's points near each anchor, and how these lie about it."""
        places = known.frames.coordinates(known.points)
        away = torch.cdist(self.grid.expand(*places.shape[:2], -1, 3), places).square()
        near = -0.5 * away / NEAR**2 + known.owner.squeeze(-1).clamp_min(1e-6).log().unsqueeze(2)
        weights = functional.softmax(near, dim=-1)
        pooled = weights @ self.pooled(known.features).unsqueeze(1)
        grid = self.grid.expand(*places.shape[:2], -1, 3)
        placed = self.placed(torch.cat([grid, weights @ places - grid], dim=-1) / NEAR)
        return self.anchor(functional.relu(pooled + placed + self.part))


def anchor_loss(outputs: AnchorOutputs, targets: Targets, **weights: float) -> dict[str, Tensor]:
    """Attention: the cross-entropy of picking the anchor nearest the part's origin. Proposal: the error of the
    keypoints in tenths of the part's diagonal, of every anchor as much as it is attended to."""
    present = parts_present(targets)
    counted = present.sum().clamp_min(1)
    nearest = (outputs.anchors - targets.origins.unsqueeze(2)).square().sum(-1).argmin(-1)
    missed = functional.cross_entropy(outputs.attention.flatten(0, 1), nearest.flatten(), reduction="none")
    errors = (outputs.proposals - targets.part_keypoints.unsqueeze(2)).abs().mean(dim=(-2, -1))
    attended = (functional.softmax(outputs.attention, dim=-1) * errors).sum(-1) / (RADIUS_UNIT * targets.diagonals)
    own = {
        "attention": (missed.view(present.shape) * present).sum() / counted,
        "proposal": (attended * present).sum() / counted,
    }
    return with_total(outputs, targets, own, **weights)


def anchor_pose(metadata: BundleMetadata, sample: RegionSample, outputs: AnchorOutputs) -> ArticulatedPose:
    """The similarity that places each part's keypoints nearest those the picked anchor proposes (Umeyama 1991)."""
    category = metadata.category
    picked = outputs.attention[0].argmax(-1)
    proposed = outputs.proposals[0, torch.arange(len(picked)), picked].numpy().astype(np.float64)
    unit = np.stack([np.asarray(part.keypoints_unit, np.float64) for part in category.parts])
    placed = umeyama(unit, proposed * category.region_radius_m + sample.center_camera)
    one_each = [placed.take(np.array([k])) for k in range(len(category.parts))]
    return plain_pose(category, members_of(sample, outputs), one_each, outputs)
