"""Whatever a network says, the estimator answers with finite poses or with reasons."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from page_runtime import Network, open_source
from page_runtime.estimator import estimate, sample_for
from page_runtime.neighbours import find_neighbours
from page_runtime.network import NetworkOutput
from page_runtime.part_poses import MIN_PART_POINTS, pose_from_output
from page_runtime.pose import NotSeen, PartPose
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import RegionSample

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def answered(toy_sample: tuple[Network, RegionSample, RecordedFrame]) -> tuple[Network, RegionSample, NetworkOutput]:
    """The toy's bundle, its sample and the bundle's exact answer."""
    network, sample, _ = toy_sample
    return network, sample, network.run(sample, find_neighbours(sample.points_camera - sample.center_camera))


RNG = np.random.default_rng(0)
CHANGES = {
    "radii are not numbers": lambda o: replace(o, radii_m=np.full_like(o.radii_m, np.nan)),
    "some radii are not numbers": lambda o: replace(
        o, radii_m=np.where(RNG.random(o.radii_m.shape) < 0.3, np.nan, o.radii_m).astype(np.float32)
    ),
    "radii are negative": lambda o: replace(o, radii_m=-o.radii_m),
    "radii are zero": lambda o: replace(o, radii_m=np.zeros_like(o.radii_m)),
    "radii are random": lambda o: replace(o, radii_m=RNG.uniform(0, 2, o.radii_m.shape).astype(np.float32)),
    "radii are huge": lambda o: replace(o, radii_m=np.full_like(o.radii_m, 1e30)),
    "sides are not numbers": lambda o: replace(o, side_logits=np.full_like(o.side_logits, np.nan)),
    "sizes are not numbers": lambda o: replace(o, extents_m=np.full_like(o.extents_m, np.nan)),
    "sizes are infinite": lambda o: replace(o, extents_m=np.full_like(o.extents_m, np.inf)),
    "sizes are zero": lambda o: replace(o, extents_m=np.zeros_like(o.extents_m)),
    "labels are not numbers": lambda o: replace(o, part_logits=np.full_like(o.part_logits, np.nan)),
    "labels are random": lambda o: replace(o, part_logits=RNG.normal(size=o.part_logits.shape).astype(np.float32)),
    "all is background": lambda o: replace(o, part_logits=np.tile([0.0, 0.0, 1.0], (len(o.part_logits), 1))),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_nonsense_gives_reasons_or_finite_poses(answered: tuple[Network, RegionSample, NetworkOutput], change) -> None:
    network, sample, output = answered
    pose = pose_from_output(network.metadata, sample, change(output))
    assert len(pose.parts) == len(pose.joints) + 1 == 2
    for part in pose.parts:
        if isinstance(part, NotSeen):
            assert part.reason
        else:
            assert np.isfinite(part.T_camera_part).all()
            assert np.isfinite(part.covariance).all()
            assert (part.extents_m > 0).all()
            assert 0.0 <= part.confidence <= 1.0
    for joint in pose.joints:
        assert (joint.value is None) == bool(joint.reason)


@pytest.mark.parametrize(
    "points",
    [
        lambda p: np.full_like(p, 0.7),
        lambda p: np.linspace(0.5, 0.9, len(p), dtype=np.float32)[:, None] * np.ones(3, np.float32),
        lambda p: p + np.float32(1e3),
        lambda p: np.full_like(p, np.nan),
    ],
    ids=["all equal", "on one line", "a kilometre away", "not numbers"],
)
def test_degenerate_points_give_reasons_or_finite_poses(
    answered: tuple[Network, RegionSample, NetworkOutput], points
) -> None:
    network, sample, output = answered
    moved = replace(sample, points_camera=points(sample.points_camera))
    for part in pose_from_output(network.metadata, moved, output).parts:
        assert isinstance(part, NotSeen) or np.isfinite(part.T_camera_part).all()


@pytest.mark.parametrize("count", [0, 1, 2, 3, MIN_PART_POINTS - 1])
def test_a_few_points_are_not_a_part(answered: tuple[Network, RegionSample, NetworkOutput], count: int) -> None:
    network, sample, output = answered
    logits = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(output.part_logits), 1))
    logits[:count] = [1.0, 0.0, 0.0]
    base, lid = pose_from_output(network.metadata, sample, replace(output, part_logits=logits)).parts
    assert isinstance(base, NotSeen)
    assert base.reason.startswith(f"not seen: {count} of")
    assert isinstance(lid, NotSeen)


def test_the_exact_answer_gives_the_exact_pose(answered: tuple[Network, RegionSample, NetworkOutput]) -> None:
    network, sample, output = answered
    pose = pose_from_output(network.metadata, sample, output)
    assert all(isinstance(part, PartPose) and part.vote_gap == 0 for part in pose.parts)
    assert pose.joints[0].disagreement is not None
    assert pose.joints[0].disagreement < 0.1


def test_an_arm_close_to_the_camera_does_not_hide_the_object_behind_it() -> None:
    """The shipped laptop on a frame of its demo, and the same frame with something grey before a side of it."""
    network = Network(ROOT / "runtime/bundles/laptop.onnx", threads=1)
    recorded = open_source(ROOT / "tests/data/laptop").entries[0].read()
    frame, region = recorded.frame, recorded.instances[0].region
    assert region is not None
    free = estimate(network, frame, region)
    x, y, w, h = region
    arm = slice(y, y + h), slice(x + round(0.75 * w), x + w)
    color, depth_m = frame.color.copy(), frame.depth_m.copy()
    color[arm], depth_m[arm] = 128, 0.3
    sample = sample_for(network.metadata, replace(frame, color=color, depth_m=depth_m), region)
    assert isinstance(sample, RegionSample)
    assert sample.other_depth_m is not None
    hidden = estimate(network, replace(frame, color=color, depth_m=depth_m), region)
    for one, other in zip(free.parts, hidden.parts, strict=True):
        assert isinstance(one, PartPose)
        assert isinstance(other, PartPose)
        assert np.linalg.norm(one.T_camera_part[:3, 3] - other.T_camera_part[:3, 3]) < 0.05
