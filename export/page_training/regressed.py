"""Poses without the scorer's votes and refinement, as the alternatives that the paper compares it with give them
(Table I, II, X and XI). On the device nothing uses them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from page_runtime.bundle import BundleMetadata
from page_runtime.category import Category
from page_runtime.geometry import apply, transform_from
from page_runtime.part_poses import MIN_PART_POINTS
from page_runtime.pose import ArticulatedPose, JointState, NotSeen, PartPose
from page_runtime.sampling import RegionSample
from page_runtime.similarity import Similarities, umeyama
from page_training.network import NetworkOutputs, ObjectOutputs


def regressed_pose(metadata: BundleMetadata, sample: RegionSample, outputs: NetworkOutputs) -> ArticulatedPose:
    """The similarity that places each part's keypoints nearest those the network regresses for it as a whole (Umeyama
    1991)."""
    category = metadata.category
    keypoints = outputs.part_keypoints[-1][0].numpy().astype(np.float64) * category.region_radius_m
    unit = np.stack([np.asarray(part.keypoints_unit, np.float64) for part in category.parts])
    placed = umeyama(unit, keypoints + sample.center_camera)
    one_each = [placed.take(np.array([k])) for k in range(len(category.parts))]
    return plain_pose(category, members_of(sample, outputs), one_each, outputs)


def members_of(sample: RegionSample, outputs: ObjectOutputs) -> list[NDArray[np.intp]]:
    """For each part the indices of its points among the sample's distinct ones that the network answered for."""
    labels = outputs.part_logits[0, : sample.num_distinct].argmax(dim=-1).numpy()
    return [np.flatnonzero(labels == k) for k in range(outputs.part_logits.shape[-1] - 1)]


def plain_pose(
    category: Category,
    members: Sequence[NDArray[np.intp]],
    placed: Sequence[Similarities | str],
    outputs: ObjectOutputs,
) -> ArticulatedPose:
    """Each part where its similarity, from units of its diagonal to the camera's frame, puts it: one, or a sentence
    that says why there is none.

    A part with fewer points than the runtime asks for is not seen, as there. What only votes could say (inlier share,
    runner-up, residual, covariance) is 0 or infinite, and no joint has a state.
    """
    extents_m = outputs.log_extents[0].exp().numpy().astype(np.float64)
    parts: list[PartPose | NotSeen] = []
    for part, own, one, extents in zip(category.parts, members, placed, extents_m, strict=True):
        if len(own) < MIN_PART_POINTS:
            parts.append(NotSeen(part.name, f"not seen: {len(own)} points belong to it, {MIN_PART_POINTS} are needed"))
            continue
        if isinstance(one, str):
            parts.append(NotSeen(part.name, one))
            continue
        T_camera_part, scale_m = transform_from(one.R[0], one.t[0]), float(one.s[0])
        parts.append(
            PartPose(
                name=part.name,
                T_camera_part=T_camera_part,
                extents_m=extents * scale_m / np.linalg.norm(extents),
                keypoints_camera=apply(T_camera_part, scale_m * part.keypoints_unit),
                scores=np.zeros(category.num_voted),
                confidence=0.0,
                inlier_share=0.0,
                runner_up_ratio=0.0,
                vote_gap=0,
                num_points=len(own),
                residual_m=float("inf"),
                covariance=np.diag(np.full(6, np.inf)),
            )
        )
    joints = tuple(
        JointState(joint.name, joint.kind, None, None, joint.limits, "poses without votes have no joint states")
        for joint in category.joints
    )
    return ArticulatedPose(tuple(parts), joints, {})
