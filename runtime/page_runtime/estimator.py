"""The whole algorithm: one frame and one region in, the pose of every part out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.bundle import BundleMetadata
from page_runtime.denoising import denoised
from page_runtime.focus import Focus, focus_on
from page_runtime.frame import RgbdFrame
from page_runtime.mirror import mirror_order, mirrored_pose, mirrored_sample
from page_runtime.network import Network, NetworkOutput
from page_runtime.part_poses import (
    MAX_VOTERS,
    LabelledPoints,
    labelled_points,
    members_of,
    pose_from_output,
    seen_parts,
)
from page_runtime.pose import ArticulatedPose, PartPose, not_seen
from page_runtime.sampling import REGION_MARGIN, Region, RegionSample, sample_region, square_region
from page_runtime.sessions import DeadlineExceeded
from page_runtime.stopwatch import Stopwatch

# One validation frame of boxes in five, of laptops in eight has a part below; looking again at others gained nothing.
LOOK_AGAIN_BELOW = 0.5
# How the region is cut out for the second look and the third: none of mirror, tighter and wider crop alone errs as
# differently as mirror and crop together, and a fourth look gained nothing.
OTHER_MARGINS = (0.0, 0.25)
MAX_LOOKS = 1 + len(OTHER_MARGINS)


def estimate(
    network: Network,
    frame: RgbdFrame,
    region: Region,
    *,
    max_looks: int = MAX_LOOKS,
    max_voters: int = MAX_VOTERS,
    network_seconds: float | None = None,
) -> ArticulatedPose:
    """The pose of every part of the object in `region` (x, y, w, h px) of `frame`, in the category's order.

    A part without a pose comes with the reason. Where a pose is unlikely to be right the frame is looked at again, in a
    mirror and cut out otherwise, at most max_looks times in all, and the likeliest answer taken; each look takes about
    the time of the first (half of the network's where the category is of thin objects), so 1 is for loops whose time
    must not vary, but for what parts that make no sense one by one cost (`whole_object`). max_voters: of a part's
    points, at most so many vote.
    network_seconds: DeadlineExceeded where a forward pass takes longer; where there is an answer already, that stays.
    Raises ValueError for a region outside the image.
    """
    return examine(
        network, frame, region, max_looks=max_looks, max_voters=max_voters, network_seconds=network_seconds
    ).pose


@dataclass(frozen=True, eq=False, slots=True)
class Examined:
    """An estimate, and what it was made of; None where the region has too little depth. labelled: the points of the
    look whose answer was taken, as the camera sees them. sample, output, first_pose: of the first look, whichever was
    taken."""

    pose: ArticulatedPose
    sample: RegionSample | None = None
    output: NetworkOutput | None = None
    first_pose: ArticulatedPose | None = None
    labelled: LabelledPoints | None = None


def examine(
    network: Network,
    frame: RgbdFrame,
    region: Region,
    *,
    max_looks: int = MAX_LOOKS,
    max_voters: int = MAX_VOTERS,
    network_seconds: float | None = None,
) -> Examined:
    """`estimate`, with the points of the region and what the network said of them."""
    first = first_look(network, frame, region, network_seconds=network_seconds)
    return examined(
        network, frame, region, first, max_looks=max_looks, max_voters=max_voters, network_seconds=network_seconds
    )


@dataclass(frozen=True, eq=False, slots=True)
class FirstLook:
    """What the network says of a region, before anything is made of it. depth_m: what its points were to be near, as in
    `sample_region`. reason: why there is neither sample nor output. stage_ms: the time it took."""

    sample: RegionSample | None = None
    output: NetworkOutput | None = None
    depth_m: float | None = None
    reason: str = ""
    stage_ms: Mapping[str, float] = field(default_factory=dict)


def first_look(
    network: Network, frame: RgbdFrame, region: Region, *, network_seconds: float | None = None
) -> FirstLook:
    """The first half of `examine`, most of it onnxruntime's: it may run beside the other half of an earlier frame."""
    metadata = network.metadata
    watch = Stopwatch()
    sample, depth_m = sample_for(metadata, frame, region), None
    watch.stage("sampling")
    if isinstance(sample, str):
        return FirstLook(reason=sample, stage_ms=watch.stage_ms)
    output = network.run(sample, network.neighbours_of(sample), seconds=network_seconds)
    watch.stage("network")
    members = members_of(output, sample.num_distinct)
    again = sampled_again(metadata, frame, region, sample, members)
    if sample.other_depth_m is not None and again is None and not seen_parts(members):
        # What is nearer is not the object, but something before it.
        behind = sample_for(metadata, frame, region, depth_m=sample.other_depth_m)
        watch.stage("sampling")
        if isinstance(behind, RegionSample):
            sample, depth_m = behind, sample.other_depth_m
            output = network.run(sample, network.neighbours_of(sample), seconds=network_seconds)
            watch.stage("network")
            members = members_of(output, sample.num_distinct)
            again = sampled_again(metadata, frame, region, sample, members, depth_m=depth_m)
    if again is not None:
        watch.stage("sampling")
        with suppress(DeadlineExceeded):
            found = network.run(again, network.neighbours_of(again), seconds=network_seconds)
            # What is not recognised from nearby was none, but then there is nothing better.
            if seen_parts(members_of(found, again.num_distinct)) or not seen_parts(members):
                sample, output = again, found
        watch.stage("network")
    return FirstLook(sample, output, depth_m, stage_ms=watch.stage_ms)


def sampled_again(
    metadata: BundleMetadata,
    frame: RgbdFrame,
    region: Region,
    sample: RegionSample,
    members: Sequence[NDArray[np.intp]],
    *,
    depth_m: float | None = None,
) -> RegionSample | None:
    """Of a thin object the points where this sample of the region has them, for the network to look at instead; None
    for a category that fills its regions, and where the sample has too little of the object. members: for each part
    its points of the sample. depth_m: what the sample was asked for."""
    if not metadata.category.focused:
        return None
    rows, columns = np.divmod(sample.source_index, frame.depth_m.shape[1])
    pixels = np.stack([columns, rows], axis=1).astype(np.float32)
    focus = focus_on([pixels[own] for own in members], square_region(region)[2])
    again = None if focus is None else sample_for(metadata, frame, region, depth_m=depth_m, focus=focus)
    return again if isinstance(again, RegionSample) else None


def examined(
    network: Network,
    frame: RgbdFrame,
    region: Region,
    first_look: FirstLook,
    *,
    max_looks: int = MAX_LOOKS,
    max_voters: int = MAX_VOTERS,
    network_seconds: float | None = None,
) -> Examined:
    """The second half of `examine`: poses from the first look, and further looks where they are unlikely."""
    metadata, sample, output = network.metadata, first_look.sample, first_look.output
    watch = Stopwatch(first_look.stage_ms)
    if sample is None or output is None:
        return Examined(replace(not_seen(metadata.category, first_look.reason), stage_ms=watch.stage_ms))
    pose = pose_from_output(metadata, sample, output, watch, max_voters=max_voters)
    first, labelled = (sample, output, pose), labelled_points(sample, output)
    if not metadata.mirrored or metadata.confidence is None:
        return Examined(pose, *first, labelled)
    looks = 1
    for margin in OTHER_MARGINS[: max_looks - 1]:
        if not _unlikely(pose):
            break
        again = sample_for(metadata, frame, region, margin=margin, depth_m=first_look.depth_m, focus=sample.focus)
        watch.stage("sampling")
        if isinstance(again, RegionSample):
            image = mirrored_sample(again)
            try:
                output = network.run(image, network.neighbours_of(image), seconds=network_seconds)
            except DeadlineExceeded:
                watch.stage("network")
                break
            watch.stage("network")
            found = pose_from_output(metadata, image, output, watch, max_voters=max_voters)
            other = mirrored_pose(found, metadata.category)
            if _mean_confidence(other) > _mean_confidence(pose):
                # Point i of the image is point i of the sample.
                pose, labelled = other, labelled_points(again, output).in_order(mirror_order(metadata.category))
            looks += 1
    return Examined(replace(pose, looks=looks), *first, labelled)


def _unlikely(pose: ArticulatedPose) -> bool:
    """Whether a part has no pose, or one that is less likely right than LOOK_AGAIN_BELOW."""
    return any(not isinstance(part, PartPose) or part.confidence < LOOK_AGAIN_BELOW for part in pose.parts)


def _mean_confidence(pose: ArticulatedPose) -> float:
    return float(np.mean([part.confidence if isinstance(part, PartPose) else 0.0 for part in pose.parts]))


def sample_for(
    metadata: BundleMetadata,
    frame: RgbdFrame,
    region: Region,
    *,
    margin: float = REGION_MARGIN,
    depth_m: float | None = None,
    focus: Focus | None = None,
) -> RegionSample | str:
    """The points a bundle asks for, smoothed where the sensor is noisy, or why there are none; margin, depth_m and
    focus as in `sample_region`."""
    sample = sample_region(
        frame,
        region,
        image_size=metadata.image_size,
        num_points=metadata.num_points,
        radius_m=metadata.category.region_radius_m,
        margin=margin,
        depth_m=depth_m,
        focus=focus,
    )
    return sample if isinstance(sample, str) else denoised(sample)
