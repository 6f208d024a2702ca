"""KP-Estimator (PAGE V-A): a graph network that learns where the keypoints of a category's parts are, without labels.

It sees the complete canonical point cloud of a part and answers n keypoints. Eq. 3 asks that the radii to every
keypoint be distributed alike; as written its signed sum over histograms is zero (METHOD 7), so the distance between two
keypoints' radii is the exact Wasserstein distance, that of the sorted radii. That alone puts the keypoints into the
plane of a flat part; what Section V-A asks for in words, little variation of the radii themselves, is a term beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from page_training.categories import category_named
from page_training.scenes.kinds import scene_category
from page_training.scenes.textures import Generator
from page_training.templates import evenly_spread, surface_samples


@dataclass(frozen=True, slots=True)
class EstimatorConfig:
    """wasserstein_weight, separation_weight: lambda 1 and 2 of Eq. 6, the coverage has the rest. spread_weight: of the
    radii's standard deviation beside Eq. 3. instances: procedural objects learned from; points: of a part's cloud;
    neighbours: edges of a point in the graph."""

    keypoints: int = 3
    wasserstein_weight: float = 0.6
    separation_weight: float = 0.2
    spread_weight: float = 6.0
    instances: int = 96
    points: int = 256
    neighbours: int = 12
    steps: int = 400
    batch_size: int = 16
    learning_rate: float = 2e-3
    seed: int = 0


class EdgeLayer(nn.Module):
    """Of each point the maximum over its graph neighbours of a layer of its feature and the difference to theirs."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.own, self.difference = nn.Linear(inputs, outputs), nn.Linear(inputs, outputs, bias=False)

    def forward(self, features: Tensor, index: Tensor) -> Tensor:
        batch = torch.arange(len(features)).view(-1, 1, 1)
        edges = self.difference(features)[batch, index] - self.difference(features).unsqueeze(2)
        return functional.relu(self.own(features) + edges.amax(dim=2))


class KeypointEstimator(nn.Module):
    """Clouds (B,P,3) in units of the part's diagonal with graph neighbours (B,P,k) to keypoints (B,n,3)."""

    def __init__(self, keypoints: int) -> None:
        super().__init__()
        self.first, self.second = EdgeLayer(3, 48), EdgeLayer(48, 96)
        last = nn.Linear(96, 3 * keypoints)
        # Small at first, about the part's centre, but not all in one place: a distance has no gradient at zero.
        nn.init.normal_(last.bias, std=0.3)
        self.head = nn.Sequential(nn.Linear(96, 96), nn.ReLU(), last)

    def forward(self, clouds: Tensor, index: Tensor) -> Tensor:
        features = self.second(self.first(clouds, index), index)
        return self.head(features.amax(dim=1)).view(len(clouds), -1, 3)


def part_clouds(category: str, rng: Generator, instances: int, points: int) -> list[NDArray[np.float32]]:
    """For each part (instances, points, 3) of its surface, evenly spread, canonical frame, in units of its diagonal."""
    clouds: list[list[NDArray[np.float32]]] = [[] for _ in category_named(category).parts]
    for _ in range(instances):
        for own, part in zip(clouds, scene_category(category).sample_object(rng).parts, strict=True):
            samples, _ = surface_samples(part.mesh, rng, 4 * points)
            unit = samples[evenly_spread(samples, points)] / np.linalg.norm(part.extents_m)
            own.append(unit.astype(np.float32))
    return [np.stack(own) for own in clouds]


def wasserstein_loss(radii: Tensor) -> Tensor:
    """Mean over pairs of the keypoints of radii (B,n,P) of the exact Wasserstein distance of their distributions."""
    ordered = radii.sort(dim=-1).values
    pairs = torch.combinations(torch.arange(radii.shape[1]))
    return (ordered[:, pairs[:, 0]] - ordered[:, pairs[:, 1]]).abs().mean()


def separation_loss(keypoints: Tensor, zeta: float) -> Tensor:
    """Eq. 4 over pairs of keypoints (B,n,3)."""
    pairs = torch.combinations(torch.arange(keypoints.shape[1]))
    distances = (keypoints[:, pairs[:, 0]] - keypoints[:, pairs[:, 1]]).norm(dim=-1)
    return torch.exp(zeta**2 - distances).sum(dim=1).mean()


def coverage_loss(keypoints: Tensor, clouds: Tensor) -> Tensor:
    """Eq. 5: extents of the keypoints (B,n,3) against those of the clouds (B,P,3), and how far off the surface they are
    (METHOD 8)."""
    extents = [points.amax(dim=1) - points.amin(dim=1) for points in (keypoints, clouds)]
    nearest = torch.cdist(keypoints, clouds).amin(dim=-1)
    return (extents[0] - extents[1]).norm(dim=-1).mean() + nearest.sum(dim=1).mean()


def farthest_keypoints(cloud: NDArray[np.floating], count: int) -> NDArray[np.float64]:
    """(count,3): the usual heuristic, farthest-point selection on the surface from the point farthest out."""
    order = np.argsort(-(np.asarray(cloud, float) ** 2).sum(axis=1), kind="stable")
    points = np.asarray(cloud, float)[order]
    return points[evenly_spread(points, count)]


def estimate_keypoints(
    clouds: NDArray[np.float32], config: EstimatorConfig, on_step: Callable[[int, float], None] = lambda *_: None
) -> tuple[NDArray[np.float64], float]:
    """Keypoints (n,3) of a part from its clouds (I,P,3), the median over the instances, and how far they differ among
    them: the largest standard deviation of a coordinate. `on_step` hears of each step and its loss (Eq. 6)."""
    generator = torch.Generator().manual_seed(config.seed)
    torch.manual_seed(config.seed)
    network = KeypointEstimator(config.keypoints)
    optimizer = torch.optim.Adam(network.parameters(), config.learning_rate)
    points = torch.from_numpy(clouds)
    index = torch.stack([_nearest(cloud, config.neighbours) for cloud in points])
    sampled = farthest_keypoints(clouds[0], config.keypoints)
    between = np.linalg.norm(sampled[:, None] - sampled[None], axis=2)
    # "Slightly larger than the distance between keypoints sampled by FPS".
    zeta = 1.1 * float(between[np.triu_indices(config.keypoints, 1)].mean())
    for step in range(config.steps):
        chosen = torch.randint(len(points), (config.batch_size,), generator=generator)
        keypoints = network(points[chosen], index[chosen])
        radii = torch.cdist(keypoints, points[chosen])
        alike = wasserstein_loss(radii) + config.spread_weight * radii.std(dim=-1).mean()
        rest = 1.0 - config.wasserstein_weight - config.separation_weight
        loss = (
            config.wasserstein_weight * alike
            + config.separation_weight * separation_loss(keypoints, zeta)
            + rest * coverage_loss(keypoints, points[chosen])
        )
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        on_step(step + 1, float(loss.detach()))
    with torch.no_grad():
        answers = network(points, index).numpy().astype(np.float64)
    return np.median(answers, axis=0), float(answers.std(axis=0).max())


def _nearest(cloud: Tensor, count: int) -> Tensor:
    """(P,count) indices of each point's nearest others."""
    return torch.cdist(cloud, cloud).topk(count + 1, largest=False).indices[:, 1:]
