"""Of poses that look the same, training teaches the one nearest to what the network said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from page_runtime.category import Category
from page_runtime.geometry import rotation_about
from page_training.categories import category_named
from page_training.losses import page_loss
from page_training.network import NetworkOutputs
from page_training.targets import Truth, settled_targets, targets_of
from symmetric_scenes import scene_pose


def truth_of(category: Category, rng: np.random.Generator) -> Truth:
    """Two random objects with labelled points on them."""
    batch, K, D = 2, len(category.parts), 256
    R, t, extents = np.empty((batch, K, 3, 3)), np.empty((batch, K, 3)), np.empty((batch, K, 3))
    labels = rng.integers(0, K + 1, (batch, D))
    points = np.empty((batch, D, 3))
    for b in range(batch):
        truths, poses = scene_pose(category, rng)
        for k, (one, T) in enumerate(zip(truths, poses, strict=True)):
            R[b, k], t[b, k], extents[b, k] = T[:3, :3], T[:3, 3] - [0.1, -0.1, 1.0], one.extents_m
        own = np.minimum(labels[b], K - 1)
        points[b] = t[b, own] + rng.normal(0, 0.05, (D, 3))
    normals = rng.normal(size=(batch, D, 3))
    return Truth(
        R=torch.from_numpy(R).float(),
        t=torch.from_numpy(t).float(),
        extents_m=torch.from_numpy(extents).float(),
        labels=torch.from_numpy(labels),
        coarse_labels=torch.from_numpy(labels[:, :16]),
        points=torch.from_numpy(points).float(),
        normals=torch.from_numpy(normals).float(),
    )


def exact_outputs(truth: Truth, category: Category) -> NetworkOutputs:
    """What a network says that knows this description."""
    targets = targets_of(truth, category)
    K = len(category.parts)

    def sure(labels: torch.Tensor) -> torch.Tensor:
        return 40.0 * torch.nn.functional.one_hot(labels, K + 1).float()

    return NetworkOutputs(
        part_logits=sure(targets.labels),
        coarse_logits=sure(targets.coarse_labels),
        radii=targets.radii,
        keypoints=targets.keypoints,
        side_logits=80.0 * (targets.sides - 0.5),
        part_keypoints=(targets.part_keypoints,) * 3,
        log_extents=targets.extents_m.log(),
    )


@pytest.mark.parametrize("name", ["scissors", "arm"])
def test_training_asks_for_the_description_nearest_to_what_was_said(name: str) -> None:
    """A network that knows one object of the batch by its other description loses nothing, and a wrong one does."""
    category = category_named(name)
    truth = truth_of(category, np.random.default_rng(4))
    other = Truth(*(value.clone() for value in truth))
    if category.interchange is not None:
        turn = torch.from_numpy(category.interchange.turn).float()
        swap = torch.tensor([1, 0, 2])
        for field in ("t", "extents_m"):
            getattr(other, field)[0] = getattr(truth, field)[0].flip(0)
        other.R[0] = truth.R[0].flip(0) @ turn
        for field in ("labels", "coarse_labels"):
            getattr(other, field)[0] = swap[getattr(truth, field)[0]]
    else:
        half = torch.from_numpy(rotation_about(np.array([0.0, 0.0, 1.0]), np.pi)).float()
        other.R[0, 6] = truth.R[0, 6] @ half
    said = exact_outputs(other, category)
    given = targets_of(truth, category)
    assert float(page_loss(said, given)["total"]) > 0.1
    assert float(page_loss(said, settled_targets(truth, given, said, category))["total"]) < 1e-4
    exact = exact_outputs(truth, category)
    settled = settled_targets(truth, given, exact, category)
    for one, wanted in zip(settled, given, strict=True):
        torch.testing.assert_close(one, wanted, atol=1e-5, rtol=1e-4)
    plain = replace(category, interchange=None, parts=tuple(replace(p, symmetry=None) for p in category.parts))
    assert settled_targets(truth, given, said, plain) is given
