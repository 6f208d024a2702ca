"""Frames of the shipped boxes, later, hidden, beside each other, and what was found in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from page_runtime import Network, RecordedFrame, open_source
from page_runtime.estimator import estimate
from page_runtime.evaluation import rotation_error, translation_error
from page_runtime.frame import RgbdFrame
from page_runtime.live.advance import trust
from page_runtime.live.result import LiveObject
from page_runtime.pose import ArticulatedPose, PartPose
from page_runtime.sampling import Region

ROOT = Path(__file__).resolve().parents[1]
BOXES = ROOT / "runtime" / "bundles" / "box.onnx"
PERIOD_S = 1 / 30


def box_network() -> Network:
    return Network(BOXES, threads=1)


def good_frames(network: Network) -> list[RecordedFrame]:
    """Frames whose object a single look recognises well."""
    recorded = list(open_source(ROOT / "tests" / "data" / "box"))
    good = [one for one in recorded if trust(estimate(network, one.frame, region_of(one), max_looks=1)) > 0.8]
    assert len(good) >= 2
    return good


def region_of(recorded: RecordedFrame) -> Region:
    region = recorded.instances[0].region
    assert region is not None
    return region


def at(recorded: RecordedFrame, index: int, *, noise: int | None = None) -> RecordedFrame:
    """The same frame, later; noise: of depth, by this seed."""
    depth_m = recorded.frame.depth_m
    if noise is not None:
        depth_m = depth_m + np.random.default_rng(noise).normal(0.0, 0.001, depth_m.shape).astype(np.float32)
        depth_m = np.where(recorded.frame.depth_m > 0, depth_m, np.float32(0))
    frame = replace(recorded.frame, depth_m=depth_m, timestamp_s=index * PERIOD_S, index=index)
    return RecordedFrame(frame, recorded.instances)


def hidden(recorded: RecordedFrame, index: int) -> RecordedFrame:
    """A board right before the camera."""
    frame = recorded.frame
    color, depth_m = np.full_like(frame.color, 128), np.full_like(frame.depth_m, 0.2)
    return RecordedFrame(RgbdFrame(color, depth_m, frame.camera, index * PERIOD_S, index))


def only(objects: tuple[LiveObject, ...]) -> LiveObject:
    (found,) = objects
    return found


def apart(one: ArticulatedPose, other: ArticulatedPose) -> tuple[float, float]:
    """Largest rotation [rad] and translation [m] between the parts of two poses."""
    pairs = [
        (a.T_camera_part, b.T_camera_part)
        for a, b in zip(one.parts, other.parts, strict=True)
        if isinstance(a, PartPose) and isinstance(b, PartPose)
    ]
    assert pairs
    return max(rotation_error(*pair) for pair in pairs), max(translation_error(*pair) for pair in pairs)
