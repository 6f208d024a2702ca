"""Do two networks say the same? Outputs and final poses of both, on real samples."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from page_runtime.bundle import BundleMetadata
from page_runtime.estimator import sample_for
from page_runtime.evaluation import rotation_error, translation_error
from page_runtime.neighbours import Neighbours, find_neighbours
from page_runtime.network import OUTPUT_NAMES, NetworkOutput
from page_runtime.part_poses import pose_from_output
from page_runtime.pose import ArticulatedPose, PartPose
from page_runtime.recorded import Source
from page_runtime.sampling import RegionSample
from page_training.evaluate import torch_inputs
from page_training.network import NetworkInputs, PageNetwork

# Above these a bundle is another network than its checkpoint (float32 in another order gives a tenth of them).
MAX_OUTPUT_DIFFERENCE = 1e-4
MAX_ROTATION_DEG = 0.02
MAX_TRANSLATION_MM = 0.1
FRAMES = 50

Inputs = tuple[RegionSample, Neighbours]
# What a network makes of a sample: the graph's outputs in the order of OUTPUT_NAMES, batch of one.
Run = Callable[[RegionSample, Neighbours], tuple[NDArray[np.float32], ...]]


@dataclass(frozen=True, slots=True)
class Difference:
    """The largest and the mean of absolute differences."""

    max: float
    mean: float

    @staticmethod
    def of(values: list[float], means: list[float] | None = None) -> Difference:
        """Of single values, or of the largest and the mean of groups of one size."""
        means = values if means is None else means
        return Difference(max(values, default=0.0), float(np.mean(means)) if means else 0.0)


@dataclass(frozen=True, slots=True)
class Parity:
    """outputs: by the graph's name for them. rotation_deg, translation_mm: where both have a pose.

    disagreements: parts that one of the two gives a pose for and the other does not.
    """

    samples: int
    outputs: dict[str, Difference]
    rotation_deg: Difference
    translation_mm: Difference
    disagreements: int

    @property
    def holds(self) -> bool:
        """Whether the two are the same network, by this module's bounds."""
        return (
            all(difference.max <= MAX_OUTPUT_DIFFERENCE for difference in self.outputs.values())
            and self.rotation_deg.max <= MAX_ROTATION_DEG
            and self.translation_mm.max <= MAX_TRANSLATION_MM
            and self.disagreements == 0
        )

    def document(self) -> dict[str, Any]:
        """In JSON's types, with the bounds."""

        def entry(difference: Difference, bound: float) -> dict[str, float]:
            return {"max": difference.max, "mean": difference.mean, "bound": bound}

        return {
            "samples": self.samples,
            "holds": self.holds,
            "outputs": {name: entry(value, MAX_OUTPUT_DIFFERENCE) for name, value in self.outputs.items()},
            "rotation_deg": entry(self.rotation_deg, MAX_ROTATION_DEG),
            "translation_mm": entry(self.translation_mm, MAX_TRANSLATION_MM),
            "disagreements": self.disagreements,
        }


def samples_of(metadata: BundleMetadata, source: Source, limit: int = FRAMES) -> Iterator[Inputs]:
    """What a network would be given for the first `limit` regions of `source` with depth; ValueError for none."""
    found = 0
    for recorded in source:
        for region in (instance.region for instance in recorded.instances if instance.region is not None):
            sample = sample_for(metadata, recorded.frame, region)
            if found == limit or isinstance(sample, str):
                continue
            found += 1
            yield sample, find_neighbours(sample.points_camera - sample.center_camera)
        if found == limit:
            return
    if found == 0:
        raise ValueError(f"{source.path}: expected at least one region with depth to compare on")


def checkpoint_run(metadata: BundleMetadata, network: PageNetwork) -> Run:
    """A checkpoint's network as `Network.run_raw` would give its answers, computed in float64 on one thread.

    In float32 the reference would be off itself, and on some samples more than what it is compared with: of 50 frames
    of boxes, up to 1.7e-4 in a logit where the bundle is off by 4e-5.
    """
    exact = copy.deepcopy(network).double().eval()

    @torch.no_grad()
    def run(sample: RegionSample, neighbours: Neighbours) -> tuple[NDArray[np.float32], ...]:
        given = torch_inputs(metadata, sample, neighbours)
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            outputs = exact(NetworkInputs(*(x.double() if x.is_floating_point() else x for x in given)))
        finally:
            torch.set_num_threads(before)
        return tuple(getattr(outputs, name).numpy().astype(np.float32) for name in OUTPUT_NAMES)

    return run


def compare(metadata: BundleMetadata, ours: Run, theirs: Run, samples: Iterator[Inputs]) -> Parity:
    """Run both on the samples."""
    worst: dict[str, list[float]] = {name: [] for name in OUTPUT_NAMES}
    mean: dict[str, list[float]] = {name: [] for name in OUTPUT_NAMES}
    rotation, translation, disagreements, count = [], [], 0, 0
    for sample, neighbours in samples:
        count += 1
        pair = ours(sample, neighbours), theirs(sample, neighbours)
        for name, one, other in zip(OUTPUT_NAMES, *pair, strict=True):
            difference = np.abs(one - other)
            worst[name].append(float(difference.max()))
            mean[name].append(float(difference.mean()))
        poses = [pose_of(metadata, sample, values) for values in pair]
        for one, other in zip(poses[0].parts, poses[1].parts, strict=True):
            if isinstance(one, PartPose) and isinstance(other, PartPose):
                rotation.append(float(np.degrees(rotation_error(one.T_camera_part, other.T_camera_part))))
                translation.append(1e3 * float(translation_error(one.T_camera_part, other.T_camera_part)))
            else:
                disagreements += type(one) is not type(other)
    return Parity(
        samples=count,
        outputs={name: Difference.of(worst[name], mean[name]) for name in OUTPUT_NAMES},
        rotation_deg=Difference.of(rotation),
        translation_mm=Difference.of(translation),
        disagreements=disagreements,
    )


def pose_of(metadata: BundleMetadata, sample: RegionSample, values: tuple[NDArray[np.float32], ...]) -> ArticulatedPose:
    """The pose that a graph's outputs lead to."""
    return pose_from_output(metadata, sample, NetworkOutput.from_graph(values, metadata.category.region_radius_m))
