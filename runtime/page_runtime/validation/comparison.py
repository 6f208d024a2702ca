"""One estimate compared with its truth, as a value that survives JSON unchanged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from page_runtime.category import Category
from page_runtime.equivalents import nearest_description
from page_runtime.estimator import MAX_LOOKS, Examined, examine
from page_runtime.evaluation import JointError, PartError, joint_errors, part_errors
from page_runtime.network import Network
from page_runtime.part_masks import PartMasks
from page_runtime.pose import NO_REGION, ArticulatedPose, not_seen
from page_runtime.recorded import PartTruth, RecordedFrame
from page_runtime.validation.points import Segmentation, radius_errors, segmentation


@dataclass(frozen=True, slots=True)
class Comparison:
    """One object in one frame.

    frame: its number in the source. instance: of the frame's objects. parts, joints: those that are visible. radius_m:
    by part, mean error of the radii that vote (`points.radius_errors`). segmentation: None where no masks tell.
    looks: that the estimate took.
    """

    frame: int
    instance: int
    parts: tuple[PartError, ...]
    joints: tuple[JointError, ...]
    radius_m: dict[str, float]
    segmentation: Segmentation | None
    looks: int


def compared(
    category: Category, pose: ArticulatedPose, truths: Sequence[PartTruth], *, frame: int, instance: int = 0
) -> Comparison:
    """Of a pose alone, without what the network said of its points."""
    parts, joints = part_errors(category, pose, truths), joint_errors(category, pose, truths)
    return Comparison(frame, instance, parts, joints, {}, None, pose.looks)


@dataclass(frozen=True, eq=False, slots=True)
class Estimated:
    """The objects of a frame that have truth. poses: of all objects, by their number in the frame."""

    poses: tuple[ArticulatedPose, ...]
    comparisons: tuple[Comparison, ...]


def compare_frame(
    network: Network,
    category: Category,
    recorded: RecordedFrame,
    masks: PartMasks | None,
    *,
    max_looks: int = MAX_LOOKS,
) -> Estimated:
    """Estimate every object of a frame, and compare those with truth. category: the network's, with the symmetries
    that errors are counted by."""
    poses, comparisons = [], []
    for i, instance in enumerate(recorded.instances):
        if instance.region is None:
            examined = Examined(not_seen(category, NO_REGION))
        else:
            examined = examine(network, recorded.frame, instance.region, max_looks=max_looks)
        pose, sample, output = examined.pose, examined.sample, examined.output
        poses.append(pose)
        if instance.truths is None:
            continue
        index = recorded.frame.index
        part, joints = part_errors(category, pose, instance.truths), joint_errors(category, pose, instance.truths)
        radius_m: dict[str, float] = {}
        found: Segmentation | None = None
        if sample is not None and output is not None and examined.first_pose is not None:
            # Which of two parts that look alike is which, each look says anew.
            nearest = nearest_description(category, examined.first_pose, instance.truths)
            radius_m = radius_errors(category, sample, output, nearest)
            if masks is not None and masks.known(index, i):
                part_map = masks.part_map(index, i, recorded.frame.depth_m.shape)
                found = segmentation(sample, output, part_map, nearest.order)
        comparisons.append(Comparison(index, i, part, joints, radius_m, found, pose.looks))
    return Estimated(tuple(poses), tuple(comparisons))


def comparison_document(one: Comparison) -> dict[str, Any]:
    """In JSON's types; `comparison_from` gives it back to the last bit."""
    return asdict(one)


def comparison_from(document: dict[str, Any]) -> Comparison:
    """A comparison from its JSON document."""
    segmented = document["segmentation"]
    if segmented is not None:
        counts = {name: tuple(segmented[name]) for name in ("part_points", "part_right")}
        segmented = Segmentation(**(segmented | counts))
    return Comparison(
        frame=document["frame"],
        instance=document["instance"],
        parts=tuple(PartError(**part) for part in document["parts"]),
        joints=tuple(JointError(**joint) for joint in document["joints"]),
        radius_m=dict(document["radius_m"]),
        segmentation=segmented,
        looks=document["looks"],
    )
