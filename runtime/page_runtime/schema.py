"""One estimate as a JSON object: the line `page-runtime run` writes. Documented in runtime/README.md."""

from __future__ import annotations

import json
from typing import Any

from page_runtime.pose import ArticulatedPose, JointState, NotSeen, PartPose


def pose_record(
    pose: ArticulatedPose, *, frame: int, timestamp_s: float, instance: int | None = None
) -> dict[str, Any]:
    """The record of one object in one frame; `instance` numbers the objects of a frame in a source that has several."""
    record: dict[str, Any] = {"frame": frame, "timestamp_s": timestamp_s}
    if instance is not None:
        record["instance"] = instance
    record["parts"] = [_part_record(part) for part in pose.parts]
    record["joints"] = [_joint_record(joint) for joint in pose.joints]
    record["looks"] = pose.looks
    record["stage_ms"] = {name: round(value, 3) for name, value in pose.stage_ms.items()}
    return record


def _part_record(part: PartPose | NotSeen) -> dict[str, Any]:
    if isinstance(part, NotSeen):
        return {
            "name": part.name,
            "T_camera_part": None,
            "extents_m": None,
            "keypoints_camera": None,
            "confidence": 0.0,
            "reason": part.reason,
        }
    return {
        "name": part.name,
        "T_camera_part": part.T_camera_part.tolist(),
        "extents_m": part.extents_m.tolist(),
        "keypoints_camera": part.keypoints_camera.tolist(),
        "confidence": float(part.confidence),
        "reason": None,
    }


def _joint_record(joint: JointState) -> dict[str, Any]:
    return {
        "name": joint.name,
        "kind": joint.kind,
        "value": joint.value,
        "sigma": joint.sigma,
        "unit": joint.unit,
        "limits": list(joint.limits),
        "reason": joint.reason or None,
    }


def json_line(record: dict[str, Any]) -> str:
    """The record as one line; ValueError if a number in it is not finite, which no reader of JSON could take."""
    return json.dumps(record, allow_nan=False) + "\n"
