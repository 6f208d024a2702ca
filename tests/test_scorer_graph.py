"""Scoring inside the graph finds the voxels that the numpy scorer finds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest
from numpy.typing import NDArray

import toy
from page_export.cli import main
from page_export.scorer_graph import CENTER, DISTINCT, INPUTS, OUTPUTS, scorer_graph
from page_runtime.bundle import BundleMetadata
from page_runtime.bundle_fields import BundleError
from page_runtime.category import Category
from page_runtime.neighbours import ANSWERED, LEVELS
from page_runtime.network import Network
from page_runtime.part_poses import MAX_VOTERS
from page_runtime.scoring import score_keypoints
from page_training.categories import CATEGORIES
from synthetic_parts import box_extents_m, keypoints_around, plate_extents_m, seen_part

NUM_POINTS = ANSWERED
VOXEL_M = 0.005


@pytest.fixture(scope="module")
def category() -> Category:
    """Boxes may be as large as the synthetic parts of these tests, their keypoints as far."""
    parts = tuple(replace(part, diagonal_range_m=(0.1, 0.7)) for part in CATEGORIES["box"].parts)
    return replace(CATEGORIES["box"], parts=parts)


@pytest.fixture(scope="module")
def session(category: Category) -> ort.InferenceSession:
    metadata = BundleMetadata(category, LEVELS[0], 224, VOXEL_M, 18, False, {})
    return ort.InferenceSession(scorer_graph(metadata).SerializeToString(), providers=["CPUExecutionProvider"])


def scored(
    session: ort.InferenceSession,
    category: Category,
    points: NDArray[np.float64],
    labels: NDArray[np.int64],
    radii_m: NDArray[np.float64],
    num_distinct: int | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Keypoints (K, 3, 3) m camera and votes (K, 3) of points (N, 3) m camera with labels (N,), radii (N, n) m."""
    unit, center = category.region_radius_m, points.mean(axis=0)
    logits = 5.0 * (labels[:, None] == np.arange(len(category.parts) + 1))
    # Of the points only those that the network answers for are looked at.
    region = np.resize(points, (LEVELS[0], 3))
    inputs = ((region - center)[None] / unit, logits[None], radii_m[None] / unit, center[None])
    feeds = {name: value.astype(np.float32) for name, value in zip(INPUTS, inputs, strict=False)}
    feeds[DISTINCT] = np.array([len(points) if num_distinct is None else num_distinct])
    keypoints, votes = session.run(list(OUTPUTS), feeds)
    return np.asarray(keypoints)[0], np.asarray(votes)[0]


@pytest.mark.parametrize("seed", range(4))
def test_the_graph_finds_the_voxels_of_the_numpy_scorer(
    session: ort.InferenceSession, category: Category, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    parts = [
        seen_part(rng, extents_m, keypoints_around(rng, extents_m, 8), sigma_m=0.005, outliers=0.15)
        for extents_m in (0.7 * box_extents_m(rng), 0.7 * plate_extents_m(rng))
    ]
    labels = np.repeat([0, 1], [len(part.points_camera) for part in parts])
    # The parts stand side by side; what is left of the points is background with nonsense radii.
    shift = np.array([0.1, 0.0, 0.0])
    points = np.concatenate([part.points_camera + sign * shift for sign, part in zip((-1, 1), parts, strict=True)])
    radii = np.concatenate([part.radii_m for part in parts])
    rest = NUM_POINTS - len(points)
    assert rest > 0
    points = np.concatenate([points, rng.normal(points.mean(axis=0), 0.2, (rest, 3))])
    radii = np.concatenate([radii, rng.uniform(0.0, 0.5, (rest, radii.shape[1]))])
    labels = np.concatenate([labels, np.full(rest, 2)])
    order = rng.permutation(NUM_POINTS)
    points, radii, labels = (values[order].astype(np.float64) for values in (points, radii, labels))
    keypoints, counts = scored(session, category, points, labels.astype(np.int64), radii)
    for part in (0, 1):
        own = np.flatnonzero(labels == part)[:MAX_VOTERS]
        numpy_votes = score_keypoints(points[own], radii[own, :3], voxel_m=VOXEL_M)
        for place, count, vote in zip(keypoints[part], counts[part], numpy_votes, strict=True):
            assert vote.gap == 0
            assert np.abs(vote.ties_camera - place).max(axis=1).min() <= 1.01 * VOXEL_M
            # float32 may move a vote or two that is on the very edge.
            assert abs(count - vote.max_votes) <= 2


def test_repeated_points_vote_once(session: ort.InferenceSession, category: Category) -> None:
    rng = np.random.default_rng(3)
    extents_m = 0.7 * box_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 8), sigma_m=0.005, outliers=0.15)
    rows = np.resize(np.arange(200), NUM_POINTS)
    points, radii = (values[rows].astype(np.float64) for values in (part.points_camera, part.radii_m))
    labels = np.where(rows < 5, 1, 0)
    keypoints, counts = scored(session, category, points, labels, radii, num_distinct=200)
    votes = score_keypoints(points[5:200], radii[5:200, :3], voxel_m=VOXEL_M)
    assert (counts[1] == 0).all()
    for place, count, vote in zip(keypoints[0], counts[0], votes, strict=True):
        assert abs(count - vote.max_votes) <= 2
        assert np.abs(vote.ties_camera - place).max(axis=1).min() <= 1.01 * VOXEL_M


def test_a_part_without_points_has_no_votes(session: ort.InferenceSession, category: Category) -> None:
    rng = np.random.default_rng(0)
    points = rng.normal([0.0, 0.0, 1.0], 0.1, (NUM_POINTS, 3))
    radii = rng.uniform(0.1, 0.2, (NUM_POINTS, 8))
    keypoints, counts = scored(session, category, points, np.zeros(NUM_POINTS, np.int64), radii)
    assert (counts[0] > 0).all()
    assert (counts[1] == 0).all()
    assert np.isfinite(keypoints).all()


def test_the_command_writes_a_graph_that_the_runtime_refuses_by_name(
    oracle_bundle: Path, toy_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = tmp_path / "with-scorer.onnx"
    arguments = ["scorer", str(oracle_bundle), "-o", str(written), "--measure-on", str(toy_recording), "--threads", "1"]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "within a voxel of the numpy scorer's  1.000" in said
    inputs = [value.name for value in ort.InferenceSession(written, providers=["CPUExecutionProvider"]).get_inputs()]
    assert inputs[-2:] == [CENTER, DISTINCT]
    with pytest.raises(BundleError, match="not an operator that bundles use"):
        Network(written)


def test_a_recording_without_a_visible_object_is_said_and_nothing_written(
    oracle_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blind = toy.write_toy_recording(tmp_path / "blind", frames=1, blind=(0,))
    written = tmp_path / "with-scorer.onnx"
    assert main(["scorer", str(oracle_bundle), "-o", str(written), "--measure-on", str(blind)]) == 2
    assert "expected at least one region" in capsys.readouterr().err
    assert not written.exists()


@pytest.mark.parametrize("option", ["--beam", "--threads"])
def test_no_cells_and_no_threads_are_refused(
    option: str, oracle_bundle: Path, toy_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = tmp_path / "with-scorer.onnx"
    arguments = ["scorer", str(oracle_bundle), "-o", str(written), "--measure-on", str(toy_recording)]
    assert main([*arguments, option, "0"]) == 2
    assert "expected at least 1" in capsys.readouterr().err
    assert not written.exists()
