"""The KP-Estimator: losses are what they say, answers alike for all instances, and the figures of the report hold."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from scipy.stats import wasserstein_distance

from page_training.cli import main
from page_training.keypoint_estimator import (
    EstimatorConfig,
    KeypointEstimator,
    coverage_loss,
    estimate_keypoints,
    farthest_keypoints,
    part_clouds,
    separation_loss,
    wasserstein_loss,
)
from page_training.keypoint_report import figures_of, heuristics, pose_spread

QUICK = EstimatorConfig(instances=6, points=64, steps=30, batch_size=4)


@pytest.fixture(scope="module")
def clouds() -> list[np.ndarray]:
    return part_clouds("laptop", np.random.default_rng(0), QUICK.instances, QUICK.points)


def test_clouds_lie_in_the_boxes_of_their_parts(clouds: list[np.ndarray]) -> None:
    assert [cloud.shape for cloud in clouds] == [(6, 64, 3)] * 2
    for cloud in clouds:
        extents = np.ptp(cloud, axis=1)
        assert np.linalg.norm(extents, axis=1).max() <= 1.0 + 1e-6
        assert np.linalg.norm(extents, axis=1).min() > 0.9


def test_the_wasserstein_loss_is_the_mean_distance_of_every_pair() -> None:
    radii = torch.rand(3, 4, 50, generator=torch.Generator().manual_seed(0))
    expected = [
        wasserstein_distance(one[i].numpy(), one[j].numpy()) for one in radii for i in range(4) for j in range(i + 1, 4)
    ]
    assert float(wasserstein_loss(radii)) == pytest.approx(np.mean(expected), rel=1e-5)
    shuffled = radii[:, :1, torch.randperm(50)].repeat(1, 2, 1)
    assert float(wasserstein_loss(shuffled)) == 0.0


def test_separation_and_coverage_are_equations_4_and_5() -> None:
    keypoints = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]])
    distances = np.array([1.0, 2.0, np.sqrt(5.0)])
    assert float(separation_loss(keypoints, 0.5)) == pytest.approx(np.exp(0.25 - distances).sum(), rel=1e-6)
    cloud = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 1.0]]])
    # The extents differ by 1 along z; only the last keypoint is off the cloud, by 1.
    assert float(coverage_loss(keypoints, cloud)) == pytest.approx(2.0, rel=1e-6)


def test_the_network_does_not_see_the_order_of_the_points() -> None:
    torch.manual_seed(0)
    network, cloud = KeypointEstimator(3), torch.rand(1, 20, 3)
    index = torch.cdist(cloud, cloud).topk(5, largest=False).indices[..., 1:]
    order = torch.randperm(20)
    rank = torch.argsort(order)
    torch.testing.assert_close(network(cloud, index), network(cloud[:, order], rank[index[:, order]]))


def test_training_lowers_the_loss_and_instances_agree(clouds: list[np.ndarray]) -> None:
    losses: list[float] = []
    keypoints, spread = estimate_keypoints(clouds[0], QUICK, lambda _, loss: losses.append(loss))
    again, _ = estimate_keypoints(clouds[0], QUICK)
    np.testing.assert_array_equal(keypoints, again)
    assert keypoints.shape == (3, 3)
    assert len(losses) == QUICK.steps
    assert np.mean(losses[-5:]) < 0.9 * np.mean(losses[:5])
    assert spread < 0.1


def test_the_centre_of_a_sphere_has_even_radii_and_far_points_are_far_apart() -> None:
    rng = np.random.default_rng(0)
    sphere = rng.normal(size=(2, 300, 3))
    sphere /= np.linalg.norm(sphere, axis=2, keepdims=True)
    figures = figures_of(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.5, 0.0, 0.0]]), sphere)
    assert figures.radius_std[0] == pytest.approx(0.0, abs=1e-4)
    assert min(figures.radius_std[1:]) > 0.1
    chosen = farthest_keypoints(sphere[0], 4)
    apart = np.linalg.norm(chosen[:, None] - chosen[None], axis=2)[np.triu_indices(4, 1)]
    assert apart.min() > 1.2


def test_keypoints_in_the_plane_of_a_plate_hold_a_pose_badly() -> None:
    rng = np.random.default_rng(0)
    plate = np.column_stack([rng.uniform(-0.5, 0.5, (200, 2)), np.zeros(200)])
    triangle = 0.35 * np.array([[1.0, 0.0, 0.0], [-0.5, 0.8, 0.0], [-0.5, -0.8, 0.0]])
    raised = triangle + np.array([0.0, 0.0, 0.3])
    assert pose_spread(raised, plate)[0] < 0.2 * pose_spread(triangle, plate)[0]


def test_the_command_writes_figures_and_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture, figures = tmp_path / "keypoints.png", tmp_path / "keypoints.json"
    arguments = ["keypoints", "box", "--steps", "3", "--instances", "4", "--count", "4"]
    assert main([*arguments, "--picture", str(picture), "--json", str(figures)]) == 0
    rows = json.loads(figures.read_text())
    assert {row["method"] for row in rows} == {"KP-Estimator", *heuristics(np.zeros((1, 9, 3)), 3)}
    assert all(np.shape(row["keypoints_unit"]) == (4, 3) for row in rows)
    image = cv2.imread(str(picture))
    assert image is not None
    assert len(image) == 8 * 240
    assert "pose" in capsys.readouterr().out
    assert main(["keypoints", "box", "--count", "2"]) == 2
