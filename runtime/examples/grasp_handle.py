"""Where a gripper takes hold of a drawer, and which way to pull: a JSON line for every frame in which it is seen.

python runtime/examples/grasp_handle.py RECORDING --bundle runtime/bundles/drawer.onnx --drawer "top drawer"
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

from page_runtime import ArticulatedPose, Category, Network, PartPose, estimate, open_source


def grasp(category: Category, pose: ArticulatedPose, drawer: str, *, least_confidence: float) -> dict[str, Any] | None:
    """The grasp of one drawer in the camera frame, metres; None where it is not seen well enough.

    T_camera_grasp: origin in the middle of the box's front, which is where the handle ends; z into the drawer, the
    way the gripper comes; x along a horizontal handle, the way the fingers do not close. pull_m: the way that is left.
    """
    k = [part.name for part in category.parts].index(drawer)
    at, joint = next((i, joint) for i, joint in enumerate(category.joints) if joint.child == k)
    part, state_m = pose.parts[k], pose.joints[at].value
    if not isinstance(part, PartPose) or part.confidence < least_confidence or joint.kind != "prismatic":
        return None
    T = np.asarray(part.T_camera_part)
    out_part = np.array(joint.axis)  # a prismatic joint's axis is the same in the frames of both parts
    axes_part = np.stack([(right := np.eye(3)[0]), np.cross(-out_part, right), -out_part], axis=1)
    T_camera_grasp = np.eye(4)
    T_camera_grasp[:3, :3] = T[:3, :3] @ axes_part
    T_camera_grasp[:3, 3] = T[:3, :3] @ (out_part * np.asarray(part.extents_m) / 2) + T[:3, 3]
    return {
        "T_camera_grasp": T_camera_grasp.tolist(),
        "pull_direction_camera": (T[:3, :3] @ out_part).tolist(),
        "pull_m": None if state_m is None else max(0.0, joint.limits[1] - state_m),
        "confidence": part.confidence,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("--bundle", required=True)
    parser.add_argument("--drawer", default="top drawer")
    parser.add_argument("--least-confidence", type=float, default=0.8)
    options = parser.parse_args()
    network = Network(options.bundle)
    for recorded in open_source(options.recording):
        for region in (instance.region for instance in recorded.instances if instance.region is not None):
            pose = estimate(network, recorded.frame, region)
            found = grasp(network.metadata.category, pose, options.drawer, least_confidence=options.least_confidence)
            if found is not None:
                print(json.dumps({"frame": recorded.frame.index, **found}), flush=True)


if __name__ == "__main__":
    main()
