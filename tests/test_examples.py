"""The examples run as a reader would run them, and do what they say."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from page_runtime import Network, estimate, open_source
from page_runtime.geometry import rotation_about, transform_from
from page_runtime.pose import ArticulatedPose, JointState, NotSeen, PartPose
from page_training.categories import CATEGORIES

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "runtime" / "examples"
DRAWER_BUNDLE, DRAWER_RECORDING = ROOT / "runtime/bundles/drawer.onnx", ROOT / "tests/data/drawer"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(name: str, *arguments: object) -> list[str]:
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_short(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 60


def test_the_laptops_angle_is_the_estimates_where_frames_are_far_apart() -> None:
    recording, bundle = ROOT / "tests/data/laptop", ROOT / "runtime/bundles/laptop.onnx"
    lines = run("laptop_angle", recording, "--bundle", bundle)
    network, expected = Network(bundle, threads=1), []
    for recorded in open_source(recording):
        region = recorded.instances[0].region
        assert region is not None
        (hinge,) = estimate(network, recorded.frame, region, max_looks=1).joints
        assert hinge.value is not None
        expected.append(np.degrees(hinge.value))
    # Other laptops in each frame: a filter that trusts the last one would be tens of degrees off.
    assert [float(line.split()[2]) for line in lines] == pytest.approx(expected, abs=6.0)


def test_the_laptops_angle_of_a_lid_that_stands_still_is_steadier_than_the_estimates(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    laptop_angle = example("laptop_angle")
    recorded = open_source(ROOT / "tests/data/laptop").entries[0].read()
    rng, sigma = np.random.default_rng(0), 0.1
    values = list(rng.normal(1.8, sigma, 200))
    states = iter(values)

    def noisy(*_: object, **__: object) -> ArticulatedPose:
        return ArticulatedPose((), (JointState("hinge", "revolute", next(states), sigma, (0.0, 3.5)),), {})

    monkeypatch.setattr(laptop_angle, "estimate", noisy)
    monkeypatch.setattr(laptop_angle, "PROCESS_SIGMA_RAD", 0.01)
    found = np.array(list(laptop_angle.hinge_angles(None, [recorded] * len(values))))
    assert len(found) == 200
    assert np.std(found[50:, 1]) < np.std(values[50:]) / 2
    assert abs(found[50:, 1].mean() - 1.8) < 0.05
    assert (found[:, 2] <= sigma + 1e-12).all()


def pulled_drawer(pull_m: float) -> ArticulatedPose:
    """A chest of drawers whose top drawer is so far out."""
    category = CATEGORIES["drawer"]
    R = rotation_about(np.array([1.0, 0.2, -0.1]), 1.9)
    size_m = np.array([0.4, 0.35, 0.15])
    body = part_pose("body", transform_from(R, np.array([0.1, 0.2, 1.5])), np.array([0.5, 0.45, 0.6]))
    top_body = np.array([0.0, -0.05 - pull_m, 0.2])
    top = part_pose("top drawer", transform_from(R, R @ top_body + body.T_camera_part[:3, 3]), size_m)
    unseen = tuple(NotSeen(part.name, "not seen") for part in category.parts[2:])
    joints = tuple(
        JointState(joint.name, joint.kind, pull_m if joint.child == 1 else None, None, joint.limits)
        for joint in category.joints
    )
    return ArticulatedPose((body, top, *unseen), joints, {})


def part_pose(name: str, T_camera_part: np.ndarray, extents_m: np.ndarray) -> PartPose:
    nothing = np.zeros((8, 3))
    return PartPose(name, T_camera_part, extents_m, nothing, np.ones(3), 0.9, 0.9, 0.1, 0, 300, 1e-3, np.eye(6))


@pytest.mark.parametrize("pull_m", [0.0, 0.1, 0.25])
def test_a_grasp_is_in_the_middle_of_the_drawers_front_and_goes_with_the_drawer(pull_m: float) -> None:
    grasp = example("grasp_handle").grasp
    category, pose = CATEGORIES["drawer"], pulled_drawer(pull_m)
    found = grasp(category, pose, "top drawer", least_confidence=0.8)
    T, out = np.array(found["T_camera_grasp"]), np.array(found["pull_direction_camera"])
    R = T[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R[:, 2], -out, atol=1e-12)
    top = pose.parts[1]
    assert isinstance(top, PartPose)
    front_part = np.linalg.inv(top.T_camera_part) @ T[:, 3]
    np.testing.assert_allclose(front_part[:3], [0.0, -top.extents_m[1] / 2, 0.0], atol=1e-12)
    # Pulled by a little, the grasp is where it would have been found then.
    further = grasp(category, pulled_drawer(pull_m + 0.05), "top drawer", least_confidence=0.8)
    np.testing.assert_allclose(np.array(further["T_camera_grasp"])[:3, 3], T[:3, 3] + 0.05 * out, atol=1e-12)
    assert found["pull_m"] - further["pull_m"] == pytest.approx(0.05)


def test_a_drawer_that_is_not_seen_or_not_sure_is_not_grasped() -> None:
    grasp, category, pose = example("grasp_handle").grasp, CATEGORIES["drawer"], pulled_drawer(0.1)
    assert grasp(category, pose, "bottom drawer", least_confidence=0.0) is None
    assert grasp(category, pose, "top drawer", least_confidence=0.95) is None


@pytest.mark.skipif(not DRAWER_BUNDLE.exists(), reason="no bundle of drawers is shipped yet")
@pytest.mark.skipif(not DRAWER_RECORDING.exists(), reason="no recording of drawers is shipped yet")
def test_the_grasp_of_recorded_drawers_is_a_line_of_json() -> None:
    lines = run("grasp_handle", DRAWER_RECORDING, "--bundle", DRAWER_BUNDLE, "--least-confidence", 0)
    assert lines
    assert all(np.shape(json.loads(line)["T_camera_grasp"]) == (4, 4) for line in lines)


def test_any_category_is_described_by_its_bundle_and_a_point_of_a_part_is_followed(
    toy_recording: Path, oracle_bundle: Path
) -> None:
    import toy

    lines = run("own_category", toy_recording, "--bundle", oracle_bundle, "--part", "lid", "--point=0,0.1,0")
    assert lines[0] == "box: 2 parts"
    assert lines[3].startswith("  hinge: revolute, lid on base, 0 to 3.14")
    first, blind, _ = (json.loads(line) for line in lines[4:])
    T = toy.part_poses()[1]
    np.testing.assert_allclose(first["point_camera"], T[:3, :3] @ [0, 0.1, 0] + T[:3, 3], atol=1e-3)
    assert blind["point_camera"] is None
    assert blind["reason"].startswith("not seen")
