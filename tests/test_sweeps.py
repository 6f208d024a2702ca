"""Other numbers of points and parts: the tables divide as they should, and known answers are like a network's."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from benchmarks import latency_sweeps
from benchmarks.known_answers import KnownAnswers
from benchmarks.sweep_tables import markdown, plots

from page_export.edge_network import EdgeNetwork
from page_export.onnx_export import RuntimeSignature, example_inputs, folded
from page_runtime import Network, estimate, open_source
from page_runtime.neighbours import GROUP_SIZE, INTERPOLATION_SIZE, answered_of, find_neighbours, levels_of
from page_runtime.pose import NotSeen
from page_training.categories import CATEGORIES
from page_training.network import PageNetwork, keypoints_of
from toy import CATEGORY, part_poses, write_oracle_bundle

BOX = CATEGORIES["box"]


@pytest.mark.parametrize("num_points", [256, 1024, 3072])
def test_neighbour_tables_of_any_n_have_its_levels(num_points: int) -> None:
    points = np.random.default_rng(0).random((num_points, 3)).astype(np.float32)
    found, levels = find_neighbours(points), levels_of(num_points)
    fine = (answered_of(num_points), *levels[1:-1])
    for i in (1, 2, 3):
        group, up = getattr(found, f"group{i}"), getattr(found, f"up{i}")
        assert group.shape == (levels[i], GROUP_SIZE)
        assert up.shape == (fine[i - 1], INTERPOLATION_SIZE)
        assert group.max() < levels[i - 1]
        assert up.max() < levels[i]
        # The nearest point to a centre is itself, as every level is a prefix of the one before.
        assert (group == np.arange(levels[i])[:, None]).any(axis=1).all()


@pytest.mark.parametrize("num_points", [0, 192, 2000])
def test_an_n_that_cannot_be_divided_is_refused(num_points: int) -> None:
    with pytest.raises(ValueError, match=f"multiple of 64 from 256 on, got {num_points}"):
        find_neighbours(np.zeros((num_points, 3), np.float32))


def test_the_exported_form_says_the_same_for_other_points_and_pictures() -> None:
    num_points, image_size = 512, 160
    torch.manual_seed(0)
    network = folded(PageNetwork(keypoints_of(BOX), BOX.num_voted, image_size=image_size))
    inputs = example_inputs(num_points, image_size)
    with torch.no_grad():
        plain, edge = RuntimeSignature(network)(*inputs), EdgeNetwork(network, num_points).eval()(*inputs)
    for one, other in zip(plain, edge, strict=True):
        assert one.shape == other.shape
        torch.testing.assert_close(one, other, atol=2e-4, rtol=1e-3)
    assert plain[0].shape[1] == num_points // 2


def test_known_answers_give_poses_as_good_as_a_trained_networks(oracle_bundle: Path, toy_recording: Path) -> None:
    """The bundle is one whose own answers are right, and the toy's second frame has no depth."""
    source = open_source(toy_recording)
    network = KnownAnswers(oracle_bundle, source, threads=1)
    plain = Network(oracle_bundle, threads=1)
    assert len(network.answers) == 1, "two frames show the same points"
    recorded = source.entries[0].read()
    (instance,) = recorded.instances
    assert instance.region is not None
    assert instance.truths is not None
    pose = estimate(network, recorded.frame, instance.region, max_looks=1)
    exact = estimate(plain, recorded.frame, instance.region, max_looks=1)
    for part, other, truth in zip(pose.parts, exact.parts, instance.truths, strict=True):
        assert not isinstance(part, NotSeen)
        assert not isinstance(other, NotSeen)
        error = np.linalg.norm(part.T_camera_part[:3, 3] - truth.T_camera_part[:3, 3])
        assert np.linalg.norm(other.T_camera_part[:3, 3] - truth.T_camera_part[:3, 3]) < error < 0.02


def test_known_answers_of_a_thin_object_are_of_both_samples(tmp_path: Path, toy_recording: Path) -> None:
    source = open_source(toy_recording)
    recorded = source.entries[0].read()
    (instance,) = recorded.instances
    assert instance.region is not None
    assert instance.truths is not None
    thin = replace(CATEGORY, focused=True)
    bundle = write_oracle_bundle(tmp_path / "thin.onnx", recorded.frame, instance.region, part_poses(), thin)
    network = KnownAnswers(bundle, source, threads=1)
    assert len(network.answers) == 2
    pose = estimate(network, recorded.frame, instance.region, max_looks=1)
    for part, truth in zip(pose.parts, instance.truths, strict=True):
        assert not isinstance(part, NotSeen)
        assert np.linalg.norm(part.T_camera_part[:3, 3] - truth.T_camera_part[:3, 3]) < 0.02


def measurement(p50_ms: float, stable: bool = True) -> dict[str, Any]:
    times = {"p50_ms": p50_ms, "p95_ms": 2 * p50_ms}
    stages = dict.fromkeys(("sampling", "network", "scoring", "registration"), times)
    return {"stages": stages, "total": times, "stability": {"stable": stable}}


def test_sweeps_are_told_beside_the_papers_time() -> None:
    errors = {"rotation_deg": 1.25, "translation_m": None}
    document = {
        "cpu": "a processor", "threads": 2, "frames": 3, "swept": "laptop",
        "paper_ms": {"scoring": 115.0, "registration": 15.0, "total": 160.0},
        "parts": [
            {"category": name, "parts": parts, "network": network, **measurement(10.0 * parts, parts != 7)}
            for name, parts, network in (("arm", 7, "untrained"), ("box", 2, "shipped"), ("eyeglasses", 3, "untrained"))
        ],
        "points": [{"num_points": n, "image_size": 224, "errors": errors, **measurement(n / 100)} for n in (512, 1024)],
        "size": [{"num_points": 2048, "image_size": 160, "errors": errors, **measurement(9.0)}],
    }  # fmt: skip
    lines = [line for line in markdown(document).splitlines() if line.startswith("| ")]
    assert lines[1] == "| 2 | box | shipped | 20 / 40 | 20 / 40 | 20 / 40 | 20 / 40 | 8.0 |"
    assert [line.split(" | ")[0] for line in lines[1:5]] == ["| 2", "| 3", "| 7", "| not stated"]
    assert "70 / 140 *" in lines[3]
    assert "| 512 | 5 / 10 | 5 / 10 | 5 / 10 | 5 / 10 | 1.2 | - |" in lines
    drawn = plots(json.loads(json.dumps(document)))
    assert set(drawn) == {"sweep-parts.svg", "sweep-points.svg", "sweep-size.svg"}
    assert "paper, RTX 4090" in drawn["sweep-parts.svg"]
    assert all(svg.startswith("<svg xmlns=") for svg in drawn.values())


def test_what_cannot_be_measured_is_said_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(*_: object, **__: object) -> dict[str, Any]:
        raise FileNotFoundError("weights: there are none")

    monkeypatch.setattr("benchmarks.sweep_steps.measured", missing)
    assert latency_sweeps.main(["--quick", "--out", str(tmp_path / "out")]) == 2
    assert "weights: there are none" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
