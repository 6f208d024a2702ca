"""The mirror: what it shows and what comes back from it, and that a second opinion is only ever for the better."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from page_runtime import Network, open_source
from page_runtime.category import Joint
from page_runtime.confidence import ConfidenceModel
from page_runtime.estimator import LOOK_AGAIN_BELOW, MAX_LOOKS, estimate
from page_runtime.mirror import MIRROR, mirrored_pose, mirrored_sample
from page_runtime.network import NetworkOutput
from page_runtime.part_poses import pose_from_output
from page_runtime.pose import ArticulatedPose, PartPose
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import RegionSample
from toy import CATEGORY, EXTENTS_M, KEYPOINTS_UNIT

ROOT = Path(__file__).resolve().parents[1]


def _same(one: PartPose, other: PartPose) -> None:
    assert np.allclose(one.T_camera_part, other.T_camera_part, atol=1e-12)
    assert np.allclose(one.keypoints_camera, other.keypoints_camera, atol=1e-12)
    assert np.allclose(one.covariance, other.covariance, rtol=1e-12, atol=0.0)


def test_twice_mirrored_is_as_before(toy_sample: tuple[Network, RegionSample, RecordedFrame]) -> None:
    _, sample, _ = toy_sample
    twice = mirrored_sample(mirrored_sample(sample))
    for name in ("image", "points_camera", "center_camera", "source_index"):
        assert np.array_equal(getattr(twice, name), getattr(sample, name)), name
    assert np.allclose(twice.pixels, sample.pixels, atol=1e-4)
    assert np.allclose(twice.camera.K, sample.camera.K)


def test_points_of_the_mirrored_sample_lie_at_its_pixels(
    toy_sample: tuple[Network, RegionSample, RecordedFrame],
) -> None:
    _, sample, _ = toy_sample
    mirrored = mirrored_sample(sample)
    assert np.allclose(mirrored.camera.project(mirrored.points_camera), mirrored.pixels, atol=0.01)
    u, v = np.round(mirrored.pixels).astype(int).T
    before_u, before_v = np.round(sample.pixels).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < sample.image.shape[1]) & (v < sample.image.shape[0])
    inside &= np.abs(sample.pixels[:, 0] % 1.0 - 0.5) > 0.01
    assert np.array_equal(mirrored.image[v, u][inside], sample.image[before_v, before_u][inside])


def _mirror_answer(sample: RegionSample, recorded: RecordedFrame) -> NetworkOutput:
    """What an exact network says of the mirrored sample: radii to the keypoints of the object in the mirror."""
    truths = recorded.instances[0].truths
    assert truths is not None
    points = sample.points_camera.astype(float) * MIRROR
    logits, radii = [], []
    for truth, extents_m in zip(truths, EXTENTS_M, strict=True):
        F = np.diag(MIRROR)
        R = F @ truth.T_camera_part[:3, :3] @ F
        t = F @ truth.T_camera_part[:3, 3]
        logits.append(-(np.abs((points - t) @ R) / (extents_m / 2 + 0.002)).max(axis=1))
        keypoints = np.linalg.norm(extents_m) * KEYPOINTS_UNIT @ R.T + t
        radii.append(np.linalg.norm(points[:, None] - keypoints, axis=2))
    logits = np.stack([*logits, np.full(len(points), -1.0)], axis=1)
    own = np.where(logits[:, 0] > logits[:, 1], 0, 1)
    return NetworkOutput(
        logits.astype(np.float32),
        np.stack(radii)[own, np.arange(len(points))].astype(np.float32),
        np.zeros((len(points), CATEGORY.num_voted), np.float32),
        np.array(EXTENTS_M, np.float32),
    )


def test_the_exact_answer_about_the_mirror_image_gives_the_exact_pose(
    toy_sample: tuple[Network, RegionSample, RecordedFrame],
) -> None:
    network, sample, recorded = toy_sample
    image = pose_from_output(network.metadata, mirrored_sample(sample), _mirror_answer(sample, recorded))
    pose = mirrored_pose(image, network.metadata.category)
    truths = recorded.instances[0].truths
    assert truths is not None
    for part, truth, own in zip(pose.parts, truths, network.metadata.category.parts, strict=True):
        assert isinstance(part, PartPose)
        assert np.allclose(part.T_camera_part, truth.T_camera_part, atol=2e-3)
        assert np.linalg.det(part.T_camera_part[:3, :3]) == pytest.approx(1.0)
        diagonal_m = np.linalg.norm(part.extents_m)
        expected = diagonal_m * own.keypoints_unit @ part.T_camera_part[:3, :3].T + part.T_camera_part[:3, 3]
        assert np.allclose(part.keypoints_camera, expected)
    assert pose.joints[0].value == pytest.approx(truths[1].joint_state, abs=0.01)
    for before, after in zip(image.parts, mirrored_pose(pose, network.metadata.category).parts, strict=True):
        assert isinstance(before, PartPose)
        assert isinstance(after, PartPose)
        _same(before, after)


def test_the_covariance_is_that_of_the_mirrored_error() -> None:
    """A small turn w and shift v of the pose in the mirror is, before it, the turn -F w and the shift F v."""
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(6, 6))
    part = PartPose(
        "base", np.eye(4), EXTENTS_M[0], np.zeros_like(KEYPOINTS_UNIT), np.ones(3), 1.0, 1.0, 0.0, 0, 99, 0.001,
        factor @ factor.T,
    )  # fmt: skip
    one = replace(CATEGORY, parts=CATEGORY.parts[:1], joints=())
    before = mirrored_pose(ArticulatedPose((part,), (), {}), one).parts[0]
    assert isinstance(before, PartPose)
    errors = rng.normal(size=(200_000, 6)) @ factor.T
    turned = np.hstack([-errors[:, :3] * MIRROR, errors[:, 3:] * MIRROR])
    assert np.allclose(before.covariance, np.cov(turned.T), atol=0.15)


def test_the_unlikely_are_looked_at_again_and_never_become_less_likely() -> None:
    """The shipped box bundle on its demo, with its own confidence and with one that trusts nothing."""
    bundle = Network(ROOT / "runtime/bundles/box.onnx", threads=1)
    model = bundle.metadata.confidence
    assert model is not None
    assert bundle.metadata.mirrored
    wary = ConfidenceModel(model.weights, model.offset - 12.0)
    changed = 0
    for recorded in open_source(ROOT / "tests/data/box"):
        region = recorded.instances[0].region
        assert region is not None
        for confidence in (model, wary):
            bundle.metadata = replace(bundle.metadata, confidence=confidence)
            poses = [estimate(bundle, recorded.frame, region, max_looks=looks) for looks in (1, 2, 3, 4)]
            likely = [_confidences(pose) for pose in poses]
            assert [pose.looks for pose in poses] == [min(pose.looks, n) for n, pose in enumerate(poses, 1)]
            assert [sum(each) for each in likely] == sorted(sum(each) for each in likely)
            if min(likely[0]) >= LOOK_AGAIN_BELOW:
                assert poses[-1].looks == 1
            if confidence is wary:
                assert poses[-1].looks == MAX_LOOKS == 3
            changed += likely[-1] != likely[0]
    assert changed > 0


def _confidences(pose: ArticulatedPose) -> list[float]:
    return [part.confidence if isinstance(part, PartPose) else 0.0 for part in pose.parts]


@pytest.mark.parametrize("lacking", ["confidence", "mirrored"])
def test_a_bundle_without_confidence_or_mirror_looks_once(lacking: str) -> None:
    bundle = Network(ROOT / "runtime/bundles/box.onnx", threads=1)
    model = bundle.metadata.confidence
    assert model is not None
    wary = ConfidenceModel(model.weights, model.offset - 12.0)
    poor = (
        {"confidence": None, "mirrored": True} if lacking == "confidence" else {"confidence": wary, "mirrored": False}
    )
    bundle.metadata = replace(bundle.metadata, **poor)
    recorded = open_source(ROOT / "tests/data/box").entries[0].read()
    region = recorded.instances[0].region
    assert region is not None
    assert estimate(bundle, recorded.frame, region).looks == 1


def test_a_joint_that_is_not_its_own_mirror_image_is_refused(oracle_bundle: Path) -> None:
    metadata = Network(oracle_bundle, threads=1).metadata
    joints = {
        "a hinge along y": (Joint("hinge", 0, 1, "revolute", (0.0, 1.0, 0.0), (0.0, 1.0)), False),
        "a hinge along x": (Joint("hinge", 0, 1, "revolute", (-1.0, 0.0, 0.0), (0.0, 1.0)), True),
        "a slide along x": (Joint("slide", 0, 1, "prismatic", (1.0, 0.0, 0.0), (0.0, 1.0)), False),
        "a slide along y": (Joint("slide", 0, 1, "prismatic", (0.0, 1.0, 0.0), (0.0, 1.0)), True),
    }
    for joint, mirrors in joints.values():
        category = replace(metadata.category, joints=(joint,))
        assert category.joints_mirror is mirrors
        if mirrors:
            assert replace(metadata, category=category, mirrored=True).mirrored
        else:
            with pytest.raises(ValueError, match="own mirror image"):
                replace(metadata, category=category, mirrored=True)
