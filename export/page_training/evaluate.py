"""A network's poses against the truth of recorded frames, before it is exported: one look at each, uncalibrated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from page_runtime.bundle import BundleMetadata
from page_runtime.category import Category
from page_runtime.estimator import sample_for, sampled_again
from page_runtime.neighbours import LEVELS, Neighbours, find_neighbours
from page_runtime.network import NetworkOutput, feeds
from page_runtime.part_poses import pose_from_output
from page_runtime.pose import ArticulatedPose, not_seen
from page_runtime.recorded import PartTruth, Source
from page_runtime.sampling import RegionSample
from page_runtime.signature import INPUT_NAMES, OUTPUT_NAMES
from page_runtime.validation.figures import figures_of
from page_training.config import VOXEL_M
from page_training.network import NetworkInputs, NetworkOutputs, PageNetwork
from page_training.records import IMAGE_SIZE
from page_training.regressed import members_of

PoseOf = Callable[[BundleMetadata, RegionSample, NetworkOutputs], ArticulatedPose]


def metadata_for(category: Category) -> BundleMetadata:
    """What the runtime needs to know of a network that is no bundle yet."""
    return BundleMetadata(category, LEVELS[0], IMAGE_SIZE, VOXEL_M, opset=0, mirrored=False, provenance={})


def torch_inputs(metadata: BundleMetadata, sample: RegionSample, neighbours: Neighbours) -> NetworkInputs:
    """The same arrays the runtime feeds, as tensors."""
    given = feeds(metadata, sample, neighbours)
    return NetworkInputs(*(torch.from_numpy(np.ascontiguousarray(given[name])) for name in INPUT_NAMES))


@torch.no_grad()
def outputs_of(network: PageNetwork, sample: RegionSample, metadata: BundleMetadata) -> NetworkOutputs:
    """All the network says of a sample."""
    neighbours = find_neighbours(sample.points_camera - sample.center_camera)
    return network(torch_inputs(metadata, sample, neighbours))


def answer(network: PageNetwork, sample: RegionSample, metadata: BundleMetadata) -> NetworkOutput:
    """What the network says of a sample, as the runtime's session gives it."""
    return _as_session(outputs_of(network, sample, metadata), metadata)


def _as_session(outputs: NetworkOutputs, metadata: BundleMetadata) -> NetworkOutput:
    values = tuple(getattr(outputs, name).numpy() for name in OUTPUT_NAMES)
    return NetworkOutput.from_graph(values, metadata.category.region_radius_m)


def scored_pose(metadata: BundleMetadata, sample: RegionSample, outputs: NetworkOutputs) -> ArticulatedPose:
    """The poses the runtime finds from the network's radii."""
    return pose_from_output(metadata, sample, _as_session(outputs, metadata))


def evaluate(
    network: PageNetwork,
    category: Category,
    source: Source,
    on_frame: Callable[[], None] = lambda: None,
    pose_of: PoseOf = scored_pose,
) -> dict[str, Any]:
    """The figures of `page-runtime validate` of every instance with a region and true poses, by `scored_pose` or
    `regressed.regressed_pose`.

    ValueError for frames of another category or without truth.
    """
    if source.category not in (None, category.name) or not source.has_truth:
        raise ValueError(
            f"{source.path}: expected frames of {category.name!r} with true poses, got a {source.format} of "
            f"{source.category!r}"
        )
    network.eval()
    metadata = metadata_for(category)
    compared: list[tuple[ArticulatedPose, tuple[PartTruth, ...]]] = []
    for recorded in source:
        for instance in recorded.instances:
            if instance.region is None or instance.truths is None:
                continue
            sample = sample_for(metadata, recorded.frame, instance.region)
            if isinstance(sample, str):
                pose = not_seen(category, sample)
            else:
                outputs = outputs_of(network, sample, metadata)
                members = members_of(sample, outputs)
                again = sampled_again(metadata, recorded.frame, instance.region, sample, members)
                if again is not None:
                    sample, outputs = again, outputs_of(network, again, metadata)
                pose = pose_of(metadata, sample, outputs)
            compared.append((pose, instance.truths))
        on_frame()
    return {"recording": source.path.name, "frames": len(source), **figures_of(category, compared)}
