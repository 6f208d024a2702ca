"""Poses from the keypoints the network regresses for each part as a whole, without radii, votes or refinement.

The alternative the paper compares its scoring with (Table II, X and XI). On the device nothing uses it.
"""

from __future__ import annotations

import numpy as np

from page_runtime.bundle import BundleMetadata
from page_runtime.geometry import apply
from page_runtime.part_poses import MIN_PART_POINTS
from page_runtime.pose import ArticulatedPose, JointState, NotSeen, PartPose
from page_runtime.sampling import RegionSample
from page_runtime.similarity import umeyama
from page_training.network import NetworkOutputs


def regressed_pose(metadata: BundleMetadata, sample: RegionSample, outputs: NetworkOutputs) -> ArticulatedPose:
    """The similarity that places each part's keypoints nearest the regressed ones (Umeyama 1991).

    A part with fewer points than the runtime asks for is not seen, as there. What only votes could say (inlier share,
    runner-up, residual, covariance) is 0 or infinite.
    """
    category = metadata.category
    labels = outputs.part_logits[0, : sample.num_distinct].argmax(dim=-1).numpy()
    counts = np.bincount(labels, minlength=len(category.parts) + 1)
    keypoints = outputs.part_keypoints[-1][0].numpy().astype(np.float64) * category.region_radius_m
    unit = np.stack([np.asarray(part.keypoints_unit, np.float64) for part in category.parts])
    placed = umeyama(unit, keypoints + sample.center_camera)
    extents_m = outputs.log_extents[0].exp().numpy().astype(np.float64)
    parts: list[PartPose | NotSeen] = []
    for k, part in enumerate(category.parts):
        if counts[k] < MIN_PART_POINTS:
            parts.append(NotSeen(part.name, f"not seen: {counts[k]} points belong to it, {MIN_PART_POINTS} are needed"))
            continue
        T_camera_part = np.eye(4)
        T_camera_part[:3, :3], T_camera_part[:3, 3] = placed.R[k], placed.t[k]
        scale_m = float(placed.s[k])
        parts.append(
            PartPose(
                name=part.name,
                T_camera_part=T_camera_part,
                extents_m=extents_m[k] * scale_m / np.linalg.norm(extents_m[k]),
                keypoints_camera=apply(T_camera_part, scale_m * part.keypoints_unit),
                scores=np.zeros(category.num_voted),
                confidence=0.0,
                inlier_share=0.0,
                runner_up_ratio=0.0,
                vote_gap=0,
                num_points=int(counts[k]),
                residual_m=float("inf"),
                covariance=np.diag(np.full(6, np.inf)),
            )
        )
    joints = tuple(
        JointState(joint.name, joint.kind, None, None, joint.limits, "regressed poses have no joint states")
        for joint in category.joints
    )
    return ArticulatedPose(tuple(parts), joints, {})
