"""Poses from each point's place in its part's normalised frame, in the manner of A-NCSH (Li et al., 2020).

Every point says where in its part it lies, in the part's own axes and diagonals; a similarity between these places and
the points themselves, found part by part by RANSAC over minimal triplets (Umeyama 1991), is the pose. A-NCSH then
optimises the object under its joints, which is left out here: no baseline has the joints' help.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from benchmarks.baselines.shared import Headless, with_total
from numpy.typing import NDArray
from torch import Tensor, nn

from page_runtime.bundle import BundleMetadata
from page_runtime.category import Category
from page_runtime.pose import ArticulatedPose
from page_runtime.sampling import RegionSample
from page_runtime.similarity import Similarities, umeyama
from page_training.config import Fusion
from page_training.losses import RADIUS_UNIT, Targets, part_weights
from page_training.network import FEATURES, NetworkInputs, ObjectOutputs
from page_training.regressed import members_of, plain_pose

HYPOTHESES = 256
# Of the part's diagonal: a point this near to where a hypothesis puts it supports it. A-NCSH: 0.1.
INLIER_SHARE = 0.05
REFITS = 3
# No point of a part is farther from its origin; before a guess has a size its frame puts points anywhere.
FARTHEST = 1.0
# Beyond the category's plausible diagonals: a hypothesis of any size explains points whose coordinates are all alike.
SIZE_MARGIN = 2.0
SEED = 0


@dataclass(frozen=True, slots=True)
class NormalisedOutputs(ObjectOutputs):
    """coordinates (B,D,3): of each point in its own part's frame, in its diagonals."""

    coordinates: Tensor


class NormalisedNetwork(Headless):
    def __init__(self, category: Category, fusion: Fusion = "gated") -> None:
        super().__init__(category, fusion)
        self.correction = nn.Linear(FEATURES, 3)

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, inputs: NetworkInputs, dense: Tensor | None = None
    ) -> NormalisedOutputs:
        known = self.described(inputs, dense)
        common = known.common
        return NormalisedOutputs(
            part_logits=common.part_logits,
            log_extents=common.log_extents,
            coarse_logits=common.coarse_logits,
            part_keypoints=common.part_keypoints,
            coordinates=known.in_part.clamp(-FARTHEST, FARTHEST) + self.correction(known.features),
        )


def normalised_targets(targets: Targets) -> Tensor:
    """(B,D,3) what `NormalisedOutputs.coordinates` should be; without meaning for background."""
    num_parts = targets.extents_m.shape[1]
    own = targets.labels.clamp_max(num_parts - 1)
    rows = torch.arange(len(own)).unsqueeze(1)
    away = targets.points - targets.origins[rows, own]
    in_part = (away.unsqueeze(2) @ targets.R[rows, own]).squeeze(2)
    return in_part / targets.diagonals[rows, own].unsqueeze(-1)


def normalised_loss(outputs: NormalisedOutputs, targets: Targets, **weights: float) -> dict[str, Tensor]:
    """The error of the coordinates in tenths of the part's diagonal."""
    errors = (outputs.coordinates - normalised_targets(targets)).abs().mean(-1) / RADIUS_UNIT
    own = {"coordinate": (errors * part_weights(targets.labels, targets.extents_m.shape[1])).sum()}
    return with_total(outputs, targets, own, **weights)


def normalised_pose(metadata: BundleMetadata, sample: RegionSample, outputs: NormalisedOutputs) -> ArticulatedPose:
    """Each part by `ransac_similarity` of its points."""
    members = members_of(sample, outputs)
    coordinates = outputs.coordinates[0].numpy().astype(np.float64)
    points = sample.points_camera.astype(np.float64)
    rng = np.random.default_rng(SEED)
    placed = [
        ransac_similarity(coordinates[own], points[own], part.diagonal_range_m, rng)
        for own, part in zip(members, metadata.category.parts, strict=True)
    ]
    return plain_pose(metadata.category, members, placed, outputs)


def ransac_similarity(
    coordinates: NDArray[np.float64],
    points_camera: NDArray[np.float64],
    diagonal_range_m: tuple[float, float],
    rng: np.random.Generator,
) -> Similarities | str:
    """The similarity that takes most of the coordinates (P,3), part units, to within INLIER_SHARE of the diagonal it
    gives of their points (P,3) m, fitted to those; a sentence where there is none of a plausible diagonal."""
    if len(points_camera) < 3:
        return f"not seen: {len(points_camera)} points belong to it, a similarity needs 3"
    triplets = np.argsort(rng.random((HYPOTHESES, len(points_camera))), axis=1)[:, :3]
    found = umeyama(coordinates[triplets], points_camera[triplets])
    low, high = diagonal_range_m
    plausible = found.take((found.s > low / SIZE_MARGIN) & (found.s < high * SIZE_MARGIN))
    if not len(plausible):
        return "no pose: no three of its points agree on a plausible size"
    inliers = _inliers(plausible, coordinates, points_camera)
    best = inliers.sum(axis=1).argmax()
    fitted, agreed = plausible.take(np.array([best])), inliers[best]
    for _ in range(REFITS):
        if agreed.sum() < 3:
            break
        fitted = umeyama(coordinates[None, agreed], points_camera[None, agreed])
        before, agreed = agreed, _inliers(fitted, coordinates, points_camera)[0]
        if (agreed == before).all():
            break
    return fitted


def _inliers(
    similarities: Similarities, coordinates: NDArray[np.float64], points_camera: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """(B,P) the points that each similarity explains."""
    away = np.linalg.norm(similarities.place(coordinates) - points_camera, axis=2)
    return away < INLIER_SHARE * similarities.s[:, None]
