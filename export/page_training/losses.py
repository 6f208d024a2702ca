"""The training loss (Eq. 19-21) and the auxiliary terms a CPU trial showed to be needed (TRAINING 3, 7)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from page_training.config import RADIUS_WEIGHT, SEGMENTATION_WEIGHT
from page_training.network import NetworkOutputs, ObjectOutputs

# Parts are described by the points the coarse head gives them, so nothing is learned of parts before it is right:
# at 0.1 the keypoint error after 250 steps of memorising was two fifths larger.
COARSE_WEIGHT = 0.5
KEYPOINT_WEIGHT = 0.25
PART_KEYPOINT_WEIGHT = 0.25
SIDE_WEIGHT = 0.05
EXTENT_WEIGHT = 0.2
MIN_PART_POINTS = 6
RADIUS_UNIT = 0.1


class Targets(NamedTuple):
    """What the network should have said; D dense points, lengths in region radii but for extents_m (metres).

    labels (B,D), num_parts for background; coarse_labels (B,512); radii (B,D,n) and keypoints (B,D,n,3) of each point's
    own part; sides (B,D,n_voted) 0 or 1; part_keypoints (B,K,n,3); extents_m (B,K,3); diagonals (B,K); R (B,K,3,3) and
    origins (B,K,3) of the parts; points (B,D,3) the dense points.
    """

    labels: Tensor
    coarse_labels: Tensor
    radii: Tensor
    keypoints: Tensor
    sides: Tensor
    part_keypoints: Tensor
    extents_m: Tensor
    diagonals: Tensor
    R: Tensor
    origins: Tensor
    points: Tensor


def part_weights(labels: Tensor, num_parts: int) -> Tensor:
    """(B,D) weights that make a weighted sum the mean over parts of the mean over a part's points (Eq. 21).

    Parts with fewer than MIN_PART_POINTS points say little about themselves and are left out.
    """
    members = functional.one_hot(labels, num_parts + 1)[..., :num_parts].to(torch.float32)
    counts = members.sum(dim=1, keepdim=True)
    members = members * (counts >= MIN_PART_POINTS)
    weights = (members / counts.clamp_min(1.0)).sum(dim=-1)
    return weights / (counts >= MIN_PART_POINTS).sum().clamp_min(1)


def page_loss(
    outputs: NetworkOutputs,
    targets: Targets,
    *,
    segmentation_weight: float = SEGMENTATION_WEIGHT,
    radius_weight: float = RADIUS_WEIGHT,
) -> dict[str, Tensor]:
    """Every term and their weighted sum, "total". Lengths count in tenths of the part's diagonal. The two weights are
    tau 1 and 2 of Eq. 19."""
    weights = part_weights(targets.labels, targets.extents_m.shape[1])
    unit = own_unit(targets)
    radius = ((outputs.radii - targets.radii).abs() / unit).mean(dim=-1)
    keypoint = ((outputs.keypoints - targets.keypoints).abs() / unit.unsqueeze(-1)).mean(dim=(-2, -1))
    side = functional.binary_cross_entropy_with_logits(outputs.side_logits, targets.sides, reduction="none").mean(-1)
    terms = object_terms(outputs, targets) | {
        "radius": (radius * weights).sum(),
        "keypoint": (keypoint * weights).sum(),
        "side": (side * weights).sum(),
    }
    terms["total"] = (
        weighted_object_terms(terms, segmentation_weight)
        + radius_weight * terms["radius"]
        + KEYPOINT_WEIGHT * terms["keypoint"]
        + SIDE_WEIGHT * terms["side"]
    )
    return terms


def own_unit(targets: Targets) -> Tensor:
    """(B,D,1) a tenth of the diagonal of each point's own part, in which lengths count."""
    own_part = targets.labels.clamp_max(targets.extents_m.shape[1] - 1)
    return RADIUS_UNIT * torch.take_along_dim(targets.diagonals, own_part, dim=1).unsqueeze(-1)


def parts_present(targets: Targets) -> Tensor:
    """(B,K) parts with so many dense points that they are learned from."""
    num_parts = targets.extents_m.shape[1]
    return torch.stack([(targets.labels == part).sum(1) >= MIN_PART_POINTS for part in range(num_parts)], dim=1)


def object_terms(outputs: ObjectOutputs, targets: Targets) -> dict[str, Tensor]:
    """The terms of what is said of an object whatever its points say: parts, their first keypoints, sizes."""
    present = parts_present(targets)
    extent = (outputs.log_extents - targets.extents_m.log()).abs().mean(-1)
    guesses = torch.stack(outputs.part_keypoints) - targets.part_keypoints
    part_keypoint = guesses.abs().mean(dim=(-2, -1)).sum(dim=0) / (RADIUS_UNIT * targets.diagonals)
    return {
        "segmentation": functional.cross_entropy(outputs.part_logits.flatten(0, 1), targets.labels.flatten()),
        "coarse": functional.cross_entropy(outputs.coarse_logits.flatten(0, 1), targets.coarse_labels.flatten()),
        "part_keypoint": (part_keypoint * present).sum() / present.sum().clamp_min(1),
        "extent": (extent * present).sum() / present.sum().clamp_min(1),
    }


def weighted_object_terms(terms: dict[str, Tensor], segmentation_weight: float) -> Tensor:
    """Their share of the total."""
    return (
        segmentation_weight * terms["segmentation"]
        + COARSE_WEIGHT * terms["coarse"]
        + PART_KEYPOINT_WEIGHT * terms["part_keypoint"]
        + EXTENT_WEIGHT * terms["extent"]
    )
