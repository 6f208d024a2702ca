"""What the ablations change is what they say: keypoints, weights of losses, poses by regression, disturbed points."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch
from benchmarks import ablations, robustness, variants
from benchmarks.approaches import POSE_OF, Way
from benchmarks.perturbations import SETTINGS, gaussian, offset, scaling
from benchmarks.variants import VARIANTS, category_of

from page_runtime import Network
from page_runtime.geometry import apply
from page_runtime.pose import NotSeen
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import RegionSample
from page_training.batches import make_batch
from page_training.cache import make_shard
from page_training.categories import CATEGORIES
from page_training.cli import main
from page_training.config import Augmentation, TrainingConfig
from page_training.evaluate import metadata_for, outputs_of
from page_training.keypoint_estimator import EstimatorConfig
from page_training.keypoint_report import heuristics
from page_training.keypoints import METHODS, read_keypoints, with_keypoints, write_keypoints
from page_training.network import network_for
from page_training.records import NEIGHBOUR_TABLES, open_shards, shard_path
from page_training.regressed import regressed_pose
from page_training.templates import part_templates
from page_training.trained import load_trained

BOX = CATEGORIES["box"]
TRIANGLE = 0.35 * np.array([[1.0, 0.0, 0.0], [-0.5, 0.8, 0.0], [-0.5, -0.8, 0.0]])


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("cache")
    make_shard(BOX, "train", 0, shard_path(root, "box", "train", 0), size=2)
    return root


def test_keypoints_come_back_from_their_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    keypoints = [rng.normal(size=(4, 3)) for _ in BOX.parts]
    path = tmp_path / "keypoints.json"
    write_keypoints(path, BOX, keypoints)
    found = read_keypoints(path, BOX)
    assert found.num_voted == found.num_keypoints == 4
    for part, own in zip(found.parts, keypoints, strict=True):
        np.testing.assert_array_equal(part.keypoints_unit, own)
    with pytest.raises(ValueError, match="expected those of 'laptop'"):
        read_keypoints(path, CATEGORIES["laptop"])
    with pytest.raises(ValueError, match="expected those of 2 parts"):
        with_keypoints(BOX, keypoints[:1])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{", "expected a file of page-train keypoints"),
        ("[]", "expected a file of page-train keypoints"),
        ('{"category": "box", "keypoints_unit": {"base": [[0, 0, 0]]}}', "with the parts base, lid"),
        ('{"category": "box", "keypoints_unit": {"base": [[0, 0, 0]], "lid": [[0, 0, 0]]}}', "n>=3"),
    ],
)
def test_a_file_that_holds_no_keypoints_of_the_category_is_refused(
    text: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "keypoints.json"
    path.write_text(text)
    assert main(["pose", "box", "--keypoints", str(path), "--run", str(tmp_path / "run")]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_network_learns_the_keypoints_of_a_file(cache: Path, tmp_path: Path) -> None:
    """Learned ones, which lie in a plane as three always do, and every method the command offers."""
    assert set(METHODS) == {METHODS[0], *heuristics(np.zeros((1, 9, 3)), 3)}
    path = tmp_path / "keypoints.json"
    learn = ["keypoints", "box", "--steps", "2", "--instances", "3", "--out", str(path)]
    assert main([*learn, "--method", "box corners"]) == 0
    assert main(learn) == 0
    run = tmp_path / "run"
    budget = ["--samples", "4", "--batch-size", "2", "--cache", str(cache), "--tau", "0.5", "0.5"]
    assert main(["pose", "box", "--keypoints", str(path), "--run", str(run), *budget]) == 0
    trained = load_trained(run / "checkpoint.pt")
    assert trained.config["radius_weight"] == 0.5
    assert trained.category.num_voted == trained.category.num_keypoints == 3
    expected = read_keypoints(path, BOX)
    for part, other in zip(trained.category.parts, expected.parts, strict=True):
        np.testing.assert_allclose(part.keypoints_unit, other.keypoints_unit)


@pytest.mark.parametrize("planar", [False, True])
def test_exact_regressed_keypoints_give_the_exact_pose(
    planar: bool, toy_sample: tuple[Network, RegionSample, RecordedFrame]
) -> None:
    network, sample, recorded = toy_sample
    category = with_keypoints(BOX, [TRIANGLE] * 2) if planar else network.metadata.category
    metadata = replace(network.metadata, category=category)
    truths = recorded.instances[0].truths
    assert truths is not None
    outputs = outputs_of(network_for(category).eval(), sample, metadata_for(category))
    keypoints = [
        apply(truth.T_camera_part, np.linalg.norm(truth.extents_m) * part.keypoints_unit) - sample.center_camera
        for truth, part in zip(truths, category.parts, strict=True)
    ]
    logits = torch.zeros_like(outputs.part_logits)
    logits[0, :1000, 0], logits[0, 1000:, 1] = 1.0, 1.0
    exact = torch.from_numpy(np.stack(keypoints)[None] / category.region_radius_m)
    known = replace(
        outputs,
        part_keypoints=(torch.zeros_like(exact), exact),
        part_logits=logits,
        log_extents=torch.from_numpy(np.log(np.stack([truth.extents_m for truth in truths])))[None],
    )
    pose = regressed_pose(metadata, sample, known)
    for part, truth in zip(pose.parts, truths, strict=True):
        assert not isinstance(part, NotSeen)
        np.testing.assert_allclose(part.T_camera_part, truth.T_camera_part, atol=1e-6)
        np.testing.assert_allclose(part.extents_m, truth.extents_m, rtol=1e-6)
    logits[0, :, 2] = 2.0
    assert all(isinstance(part, NotSeen) for part in regressed_pose(metadata, sample, known).parts)


def test_jittered_points_come_with_the_neighbours_the_runtime_would_find(cache: Path) -> None:
    from page_runtime.neighbours import find_neighbours

    records = np.array(open_shards(cache, "box", "train")[0])
    still = Augmentation(flip_probability=0.0, scale_sigma=0.0, turn_sigma_rad=0.0, jitter_probability=0.0)
    for augmentation, moved in ((still, False), (replace(still, jitter_probability=1.0), True)):
        generator = torch.Generator().manual_seed(3)
        batch = make_batch(records, BOX, dense_points=64, generator=generator, augmentation=augmentation)
        points = (batch.inputs.points * BOX.region_radius_m).numpy()
        away = np.linalg.norm(points - records["points"], axis=2)
        assert bool((away.mean(axis=1) > 1e-5).all()) is moved
        assert away.max() < 6 * still.jitter_limit_m
        for row in range(len(records) if moved else 0):
            found = find_neighbours(points[row] - points[row].mean(axis=0), answered=points.shape[1])
            for name in NEIGHBOUR_TABLES:
                same = np.sort(getattr(batch.inputs, name)[row].numpy()) == np.sort(getattr(found, name))
                # Ties within rounding may fall either way.
                assert same.mean() > 0.99


def test_disturbed_points_are_disturbed_as_said(toy_sample: tuple[Network, RegionSample, RecordedFrame]) -> None:
    _, sample, _ = toy_sample
    repeated = replace(sample, num_distinct=700, points_camera=np.resize(sample.points_camera[:700], (2048, 3)))
    noisy = gaussian(0.02)(repeated, np.random.default_rng(0))
    moved = noisy.points_camera - repeated.points_camera
    np.testing.assert_allclose(moved[:700], moved[700:1400], atol=1e-6)
    assert np.std(moved) == pytest.approx(0.02, rel=0.05)
    scaled = scaling(sample, np.random.default_rng(1))
    np.testing.assert_allclose(scaled.center_camera, sample.center_camera, atol=1e-5)
    factor = np.linalg.norm(scaled.points_camera - scaled.center_camera, axis=1) / np.linalg.norm(
        sample.points_camera - sample.center_camera, axis=1
    )
    assert np.ptp(factor) < 1e-3
    assert 0.95 <= factor.mean() <= 1.05
    step = np.abs(offset(sample, np.random.default_rng(2)).points_camera - sample.points_camera)
    assert np.ptp(step, axis=0).max() < 1e-5
    assert 0.0015 - 1e-5 <= step.min() <= step.max() <= 0.005 + 1e-5


def test_robustness_of_a_bundle_that_knows_the_answer(
    oracle_bundle: Path, toy_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "robustness.json"
    assert robustness.main([str(oracle_bundle), str(toy_recording), "--json", str(out)]) == 0
    document = json.loads(out.read_text())
    assert list(document["settings"]) == list(SETTINGS)
    clean = document["settings"]["clean"]["parts"][0]
    assert clean["rotation_deg"]["mean"] < 0.5
    assert clean["missing"] == 1, "the blind frame counts"
    assert "Gaussian 30 mm" in capsys.readouterr().out
    assert robustness.main([str(oracle_bundle), str(tmp_path)]) == 2


def test_every_way_to_a_pose_is_trained_measured_and_goes_on(
    cache: Path, toy_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [one.name for one in VARIANTS]
    assert len(set(names)) == len(names)
    assert {one.trained_as for one in VARIANTS if one.trained_as} <= set(names)
    assert {one.way for one in VARIANTS} == set(get_args(Way)) == set(POSE_OF)
    ways = {one.way: one.name for one in reversed(VARIANTS)}
    monkeypatch.setattr(variants, "TrainingConfig", partial(TrainingConfig, batch_size=2, dense_points=64))
    monkeypatch.setattr("page_training.templates.part_templates", partial(part_templates, instances=3))
    runs, out = tmp_path / "runs", tmp_path / "out"
    arguments = ["box", str(toy_recording), "--samples", "2", "--cache", str(cache), "--runs", str(runs)]
    arguments += ["--out", str(out), "--only", *ways.values()]
    assert ablations.main(arguments) == 0
    checkpoints = sorted(runs.rglob("checkpoint.pt"))
    assert len(checkpoints) == len(ways) - 1, "regression is of the network of ours"
    before = {path: path.stat().st_mtime_ns for path in checkpoints}
    first = (out / "ablations.json").read_text()
    assert ablations.main(arguments) == 0
    assert {path: path.stat().st_mtime_ns for path in checkpoints} == before
    assert (out / "ablations.json").read_text() == first
    rows = (out / "ablations.md").read_text()
    assert all(f"| {name} |" in rows for name in ways.values())
    assert "trained with the same budget" in rows
    assert ablations.main(["no-category", str(toy_recording)]) == 2


def test_a_variants_keypoints_are_found_once_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(variants, "EstimatorConfig", partial(EstimatorConfig, instances=2, points=64, steps=2))
    chosen = {one.method: one for one in reversed(VARIANTS) if one.method is not None}
    assert set(chosen) == set(METHODS)
    for variant in chosen.values():
        found = category_of(variant, BOX, tmp_path)
        assert found.num_voted == found.num_keypoints == variant.count
    monkeypatch.setattr(variants, "part_clouds", None)
    for variant in chosen.values():
        kept = category_of(variant, BOX, tmp_path)
        assert kept.num_keypoints == variant.count
    assert category_of(VARIANTS[0], BOX, tmp_path) is BOX
