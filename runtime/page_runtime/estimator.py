"""The whole algorithm: one frame and one region in, the pose of every part out."""

from __future__ import annotations

from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from page_runtime.bundle import BundleMetadata
from page_runtime.category import Part
from page_runtime.frame import RgbdFrame
from page_runtime.neighbours import find_neighbours
from page_runtime.network import Network, NetworkOutput
from page_runtime.pose import ArticulatedPose, NotSeen, PartPose
from page_runtime.registration import register_part
from page_runtime.sampling import Region, RegionSample, sample_region
from page_runtime.scoring import score_keypoints

MIN_PART_POINTS = 24
MAX_VOTERS = 512
STAGES = ("sampling", "network", "scoring", "registration")


def estimate(network: Network, frame: RgbdFrame, region: Region) -> ArticulatedPose:
    """The pose of every part of the object in `region` (x, y, w, h px) of `frame`, in the category's order.

    A part without a pose comes with the reason. Raises ValueError for a region that lies outside the image.
    """
    metadata = network.metadata
    watch = Stopwatch()
    sample = sample_for(metadata, frame, region)
    watch.stage("sampling")
    if isinstance(sample, str):
        return ArticulatedPose(tuple(NotSeen(part.name, sample) for part in metadata.category.parts), watch.stage_ms)
    output = network.run(sample, find_neighbours(sample.points_camera - sample.center_camera))
    watch.stage("network")
    return pose_from_output(metadata, sample, output, watch)


def sample_for(metadata: BundleMetadata, frame: RgbdFrame, region: Region) -> RegionSample | str:
    """The points a bundle asks for, or why there are none."""
    return sample_region(
        frame,
        region,
        image_size=metadata.image_size,
        num_points=metadata.num_points,
        radius_m=metadata.category.region_radius_m,
    )


def pose_from_output(
    metadata: BundleMetadata, sample: RegionSample, output: NetworkOutput, watch: Stopwatch | None = None
) -> ArticulatedPose:
    """The second half of `estimate`: from the network's answer for the points of `sample` to poses."""
    watch = watch or Stopwatch()
    points = sample.points_camera[: sample.num_distinct]
    labels = output.part_logits[: sample.num_distinct].argmax(axis=1)
    parts = tuple(
        _estimate_part(part, index, points, np.flatnonzero(labels == index), output, metadata, watch)
        for index, part in enumerate(metadata.category.parts)
    )
    return ArticulatedPose(parts, watch.stage_ms)


class Stopwatch:
    """Adds the wall time since the last call to a stage."""

    def __init__(self) -> None:
        self.stage_ms: dict[str, float] = dict.fromkeys(map(str, STAGES), 0.0)
        self.since = perf_counter()

    def stage(self, name: str) -> None:
        now = perf_counter()
        self.stage_ms[name] += (now - self.since) * 1e3
        self.since = now


def _estimate_part(
    part: Part,
    index: int,
    points_camera: NDArray[np.float32],
    members: NDArray[np.intp],
    output: NetworkOutput,
    metadata: BundleMetadata,
    watch: Stopwatch,
) -> PartPose | NotSeen:
    """Votes, then pose, of one part from its points (`members` indexes points and outputs alike)."""
    if len(members) < MIN_PART_POINTS:
        return NotSeen(
            part.name,
            f"not seen: {len(members)} of {len(points_camera)} points belong to it, {MIN_PART_POINTS} are needed",
        )
    voters = members[:MAX_VOTERS]  # a prefix of the progressive order covers the part evenly
    voted_radii_m = output.radii_m[voters, : metadata.category.num_voted]
    votes = score_keypoints(points_camera[voters], voted_radii_m, voxel_m=metadata.voxel_m)
    watch.stage("scoring")
    extents_m = output.extents_m[index].astype(np.float64)
    registration = register_part(
        points_camera[members],
        output.radii_m[members],
        part.keypoints_unit,
        votes,
        extents_unit=extents_m / np.linalg.norm(extents_m),
        scale_range_m=part.diagonal_range_m,
        side_logits=output.side_logits[members],
    )
    watch.stage("registration")
    if isinstance(registration, str):
        return NotSeen(part.name, registration)
    return PartPose(
        name=part.name,
        T_camera_part=registration.T_camera_part,
        extents_m=extents_m * (registration.scale_m / np.linalg.norm(extents_m)),
        keypoints_camera=registration.keypoints_camera,
        scores=np.array([vote.peaks[0].share if vote.peaks else 0.0 for vote in votes]),
        confidence=registration.inlier_share,
        runner_up_ratio=registration.runner_up_ratio,
        vote_gap=max(vote.gap for vote in votes),
        num_points=len(members),
        residual_m=registration.residual_m,
        covariance=registration.covariance[:6, :6],
    )
