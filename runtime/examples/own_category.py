"""A program for whatever a bundle knows, your own category included (export/your-own-category.md): what every part is
called, where its origin is, and the pose of a tool point that you give in a part's frame.

    python runtime/examples/own_category.py RECORDING --bundle B --part lid --point 0,0.1,0
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

from page_runtime import ArticulatedPose, Category, Network, NotSeen, estimate, open_source
from page_runtime.geometry import apply


def described(category: Category) -> str:
    """The parts and joints in words; nothing here knows the category before the bundle is read."""
    lines = [f"{category.name}: {len(category.parts)} parts"]
    lines += [f"  {part.name}: {part.frame}" for part in category.parts]
    for joint in category.joints:
        low, high = joint.limits
        names = f"{category.parts[joint.child].name} on {category.parts[joint.parent].name}"
        unit = "m" if joint.kind == "prismatic" else "rad"
        lines.append(f"  {joint.name}: {joint.kind}, {names}, {low:g} to {high:g} {unit}")
    return "\n".join(lines)


def point_record(pose: ArticulatedPose, part_name: str, point_part: np.ndarray) -> dict[str, Any]:
    """A point given in the frame of one part, metres, as the camera sees it; or the reason why nobody knows."""
    (part,) = (part for part in pose.parts if part.name == part_name)
    states = {joint.name: joint.value for joint in pose.joints}
    if isinstance(part, NotSeen):
        return {"point_camera": None, "reason": part.reason, "joints": states}
    point_camera = apply(np.asarray(part.T_camera_part), point_part)
    return {"point_camera": point_camera.tolist(), "confidence": part.confidence, "joints": states}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("--bundle", required=True)
    parser.add_argument("--part", required=True)
    parser.add_argument("--point", type=lambda text: np.array([float(v) for v in text.split(",")]), default=np.zeros(3))
    options = parser.parse_args()
    network = Network(options.bundle)
    print(described(network.metadata.category))
    for recorded in open_source(options.recording):
        for region in (instance.region for instance in recorded.instances if instance.region is not None):
            pose = estimate(network, recorded.frame, region)
            print(json.dumps({"frame": recorded.frame.index, **point_record(pose, options.part, options.point)}))


if __name__ == "__main__":
    main()
