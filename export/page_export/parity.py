"""Does the bundle say what the checkpoint says? Outputs and final poses of both, on real samples."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from page_runtime.capture.playback import open_source
from page_runtime.estimator import sample_for
from page_runtime.evaluation import rotation_error, translation_error
from page_runtime.neighbours import find_neighbours
from page_runtime.network import OUTPUT_NAMES, Network, NetworkOutput
from page_runtime.part_poses import pose_from_output
from page_runtime.pose import PartPose
from page_runtime.recorded import Source
from page_training.evaluate import torch_inputs
from page_training.network import PageNetwork


@dataclass(frozen=True, slots=True)
class Parity:
    """Largest differences over all samples. outputs: per graph output, absolute. poses: only where both have one.

    disagreements: parts that one of the two gives a pose for and the other does not.
    """

    samples: int
    outputs: dict[str, float]
    rotation_deg: float
    translation_mm: float
    disagreements: int


def compare(bundle: Network, network: PageNetwork, source: Source, limit: int = 50) -> Parity:
    """Run both on up to `limit` regions of `source`; ValueError if it has none with depth."""
    network.eval()
    metadata = bundle.metadata
    worst: dict[str, float] = dict.fromkeys(map(str, OUTPUT_NAMES), 0.0)
    rotation, translation, disagreements, samples = 0.0, 0.0, 0, 0
    regions = ((item.frame, instance.region) for item in source for instance in item.instances)
    for frame, region in regions:
        if samples == limit:
            break
        if region is None:
            continue
        sample = sample_for(metadata, frame, region)
        if isinstance(sample, str):
            continue
        samples += 1
        neighbours = find_neighbours(sample.points_camera - sample.center_camera)
        with torch.no_grad():
            outputs = network(torch_inputs(metadata, sample, neighbours))
        graph = bundle.run_raw(sample, neighbours)
        reference = tuple(getattr(outputs, name).numpy() for name in OUTPUT_NAMES)
        for name, ours, theirs in zip(OUTPUT_NAMES, graph, reference, strict=True):
            worst[name] = max(worst[name], float(np.abs(ours - theirs).max()))
        pair = [
            pose_from_output(metadata, sample, NetworkOutput.from_graph(values, metadata.category.region_radius_m))
            for values in (graph, reference)
        ]
        for ours, theirs in zip(pair[0].parts, pair[1].parts, strict=True):
            if isinstance(ours, PartPose) and isinstance(theirs, PartPose):
                rotation = max(rotation, np.degrees(rotation_error(ours.T_camera_part, theirs.T_camera_part)))
                translation = max(translation, 1e3 * translation_error(ours.T_camera_part, theirs.T_camera_part))
            else:
                disagreements += type(ours) is not type(theirs)
    if samples == 0:
        raise ValueError(f"{source.path}: expected at least one region with depth to compare on")
    return Parity(samples, worst, float(rotation), float(translation), disagreements)


def compare_on(bundle: Network, network: PageNetwork, recording: Path, limit: int = 50) -> Parity:
    """`compare` on a recording's folder."""
    return compare(bundle, network, open_source(recording), limit)
