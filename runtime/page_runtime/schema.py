"""Estimates as JSON objects: the lines that `page-runtime run` (runtime/README.md) and sinks (SINKS.md) write."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from page_runtime.live.result import LiveObject, LiveResult
from page_runtime.pose import ArticulatedPose, JointState, NotSeen, PartPose


def pose_record(
    pose: ArticulatedPose, *, frame: int, timestamp_s: float, instance: int | None = None
) -> dict[str, Any]:
    """The record of one object in one frame; `instance` numbers the objects of a frame in a source that has several."""
    record: dict[str, Any] = {"frame": frame, "timestamp_s": timestamp_s}
    if instance is not None:
        record["instance"] = instance
    return record | _pose_fields(pose)


def result_record(result: LiveResult) -> dict[str, Any]:
    """The record of everything about one processed frame; its objects have the fields of `pose_record`."""
    return {
        "frame": result.frame.index,
        "timestamp_s": result.frame.timestamp_s,
        "state": result.state,
        "reason": result.reason or None,
        "latency_ms": round(result.latency_ms, 3),
        "late": result.late,
        "stage_ms": _milliseconds(result.stage_ms),
        "counts": asdict(result.counts),
        "objects": [_object_record(found) for found in result.objects],
    }


def _object_record(found: LiveObject) -> dict[str, Any]:
    region = [int(value) for value in found.region]
    fields = _pose_fields(found.pose)
    for joint, rate in zip(fields["joints"], found.joint_rates, strict=False):
        joint["rate"] = rate
    return {"number": found.number, "region": region, "tracked": found.tracked, **fields}


def _pose_fields(pose: ArticulatedPose) -> dict[str, Any]:
    return {
        "parts": [_part_record(part) for part in pose.parts],
        "joints": [_joint_record(joint) for joint in pose.joints],
        "looks": pose.looks,
        "stage_ms": _milliseconds(pose.stage_ms),
    }


def _milliseconds(stage_ms: Mapping[str, float]) -> dict[str, float]:
    return {name: round(value, 3) for name, value in stage_ms.items()}


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
