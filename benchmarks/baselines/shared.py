"""What the baselines share: this project's layers below the heads, and the loss of what those say of the object.

Each baseline is its own head, loss and solver on them. Like the heads of radii, a baseline's head starts from the
parts' guessed frames: what differs is how a pose is said and solved for, not what is known before.
"""

from __future__ import annotations

import torch
from torch import Tensor

from page_runtime.category import Category
from page_training.config import RADIUS_WEIGHT, SEGMENTATION_WEIGHT, Fusion
from page_training.losses import Targets, object_terms, weighted_object_terms
from page_training.network import ObjectOutputs, PageNetwork, keypoints_of


class Headless(PageNetwork):
    """The network without its heads of radii and sides; a baseline adds its own."""

    def __init__(self, category: Category, fusion: Fusion = "gated") -> None:
        super().__init__(keypoints_of(category), category.num_voted, fusion)
        del self.keypoints, self.sides


def with_total(
    outputs: ObjectOutputs,
    targets: Targets,
    own: dict[str, Tensor],
    *,
    segmentation_weight: float = SEGMENTATION_WEIGHT,
    radius_weight: float = RADIUS_WEIGHT,
) -> dict[str, Tensor]:
    """A baseline's own terms beside those of the object; the sum of its own takes the weight of the radii's."""
    terms = object_terms(outputs, targets) | own
    total = weighted_object_terms(terms, segmentation_weight) + radius_weight * torch.stack([*own.values()]).sum()
    return terms | {"total": total}
