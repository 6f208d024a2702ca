"""The ways to a pose that are compared, by name: heads and loss to train with, and what makes poses of the outputs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

from benchmarks.baselines.anchors import AnchorNetwork, anchor_loss, anchor_pose
from benchmarks.baselines.normalised import NormalisedNetwork, normalised_loss, normalised_pose
from benchmarks.baselines.pair_votes import pair_pose
from benchmarks.baselines.pairs import PairNetwork, pair_loss, voted_axes

from page_runtime.category import Category
from page_training.approach import SCORING, Approach
from page_training.evaluate import scored_pose
from page_training.regressed import regressed_pose

Way = Literal["scoring", "regression", "anchors", "normalised", "pairs"]


def trained_by(way: Way, category: Category) -> Approach:
    """Regression is of the network that is trained for scoring."""
    if way == "anchors":
        return Approach(AnchorNetwork, anchor_loss)
    if way == "normalised":
        return Approach(NormalisedNetwork, normalised_loss)
    if way == "pairs":
        return Approach(PairNetwork, partial(pair_loss, axes=voted_axes(category)))
    return SCORING


# What `page_training.evaluate` is given, each for the outputs of its own network.
POSE_OF: dict[Way, Callable[..., Any]] = {
    "scoring": scored_pose,
    "regression": regressed_pose,
    "anchors": anchor_pose,
    "normalised": normalised_pose,
    "pairs": pair_pose,
}
