"""A network that takes the time of one and gives the answers of a trained one, for categories that have none.

An untrained network's radii agree on nothing, and its labels may be of one part alone, so what follows the forward pass
would take any time but the true one. The forward pass is run and timed as it is; then the answer is the truth of the
frame, as wrong as trained networks are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from benchmarks.synthetic import Noise
from numpy.typing import NDArray

from page_runtime.category import Category
from page_runtime.estimator import sample_for, sampled_again
from page_runtime.geometry import apply
from page_runtime.neighbours import Neighbours, answered_of
from page_runtime.network import Network, NetworkOutput
from page_runtime.part_masks import part_masks
from page_runtime.part_poses import members_of
from page_runtime.recorded import PartTruth, Source
from page_runtime.sampling import RegionSample

# Most of the error of a trained network's radii is one that all points of a part share.
NOISE = Noise(sigma_m=0.002, outliers=0.05, correlated_m=0.006)
SURE = 8.0


class KnownAnswers(Network):
    """A bundle whose every answer is replaced by that of `answers_of` for the same points."""

    def __init__(self, path: Path, source: Source, *, threads: int) -> None:
        super().__init__(path, threads=threads)
        self.answers = answers_of(self, source)

    def run(self, sample: RegionSample, neighbours: Neighbours, *, seconds: float | None = None) -> NetworkOutput:
        super().run(sample, neighbours, seconds=seconds)
        return self.answers[_key(sample)]


def answers_of(network: Network, source: Source) -> dict[bytes, NetworkOutput]:
    """For every region of a recording with truth and masks what a trained network might say of its points.

    ValueError for a recording without either.
    """
    metadata, masks = network.metadata, part_masks(source)
    found: dict[bytes, NetworkOutput] = {}
    for recorded in source:
        for i, instance in enumerate(recorded.instances):
            if instance.region is None:
                continue
            if instance.truths is None or masks is None:
                raise ValueError(f"{source.path}: expected true poses and part masks; page-train record writes both")
            sample = sample_for(metadata, recorded.frame, instance.region)
            if isinstance(sample, str):
                continue
            part_map = masks.part_map(recorded.frame.index, i, recorded.frame.depth_m.shape).ravel().astype(np.intp)
            rng = np.random.default_rng([recorded.frame.index, i])
            while sample is not None:
                labels = (part_map[sample.source_index] - 1) % (len(instance.truths) + 1)
                said = answer(metadata.category, sample, labels, instance.truths, rng)
                found[_key(sample)] = said
                # Of a thin object the network is asked a second time.
                members = members_of(said, sample.num_distinct)
                first = sample.focus is None
                sample = sampled_again(metadata, recorded.frame, instance.region, sample, members) if first else None
    return found


def answer(
    category: Category,
    sample: RegionSample,
    labels: NDArray[np.intp],
    truths: tuple[PartTruth, ...],
    rng: np.random.Generator,
    noise: Noise = NOISE,
) -> NetworkOutput:
    """What is true of a sample, disturbed. labels (N,): of its points, K for background."""
    num_parts, count = len(category.parts), answered_of(len(sample.points_camera))
    points, own = sample.points_camera[:count].astype(float), np.minimum(labels[:count], num_parts - 1)
    keypoints = np.stack([
        apply(truth.T_camera_part, np.linalg.norm(truth.extents_m) * part.keypoints_unit)
        for truth, part in zip(truths, category.parts, strict=True)
    ])  # fmt: skip
    shared = keypoints + noise.correlated_m * rng.normal(size=(num_parts, 1, 3))
    radii_m = np.linalg.norm(points[:, None] - shared[own], axis=2)
    radii_m += noise.sigma_m * rng.normal(size=radii_m.shape)
    outliers = rng.random(radii_m.shape) < noise.outliers
    radii_m[outliers] = rng.uniform(0.0, 2.0 * radii_m.max(), int(outliers.sum()))
    centers = np.stack([truth.T_camera_part[:3, 3] for truth in truths])
    nearer = np.linalg.norm(keypoints, axis=2) < np.linalg.norm(centers, axis=1)[:, None]
    return NetworkOutput(
        part_logits=(SURE * np.eye(num_parts + 1)[labels[:count]]).astype(np.float32),
        radii_m=np.maximum(radii_m, 1e-3).astype(np.float32),
        side_logits=np.where(nearer[own, : category.num_voted], 3.0, -3.0).astype(np.float32),
        extents_m=np.stack([truth.extents_m for truth in truths]).astype(np.float32),
    )


def _key(sample: RegionSample) -> bytes:
    return sample.points_camera.tobytes()
