"""Laws of the scorer's benchmark: its parts are true, its accumulators count right, its figures hold together."""

import json
from pathlib import Path

import numpy as np
import pytest
from benchmarks import scorer
from benchmarks.accumulators import gemm_votes, grid_around, maximum
from benchmarks.report import Cache, document_from, machine
from benchmarks.steps import Step, full_steps, quick_steps
from benchmarks.synthetic import EXACT, KEYPOINT_DISTANCE_M, SHAPES, Noise, suite
from benchmarks.tables import readable

from dense_accumulator import dense_votes
from synthetic_parts import SyntheticPart


def small_parts() -> list[SyntheticPart]:
    return suite(4, "mid", 64, Noise(), seed=1)


@pytest.mark.parametrize("distance", sorted(KEYPOINT_DISTANCE_M))
def test_radii_without_noise_are_the_distances_to_keypoints_as_far_off_as_asked_for(distance: str) -> None:
    nearest_m, farthest_m = KEYPOINT_DISTANCE_M[distance]
    for part in suite(8, distance, 100, EXACT, seed=0):
        away = part.points_camera[:, None].astype(np.float64) - part.keypoints_camera
        np.testing.assert_allclose(part.radii_m, np.linalg.norm(away, axis=2), atol=1e-6)
        beyond = np.maximum(np.abs(part.keypoints_unit) - 0.5 * part.extents_unit, 0.0) * part.scale_m
        off_m = np.linalg.norm(beyond, axis=1)
        assert nearest_m - 1e-9 <= off_m.min()
        assert off_m.max() <= farthest_m + 1e-9


def test_a_camera_sees_the_near_side_of_a_part_within_its_box() -> None:
    for part in suite(8, "mid", 200, EXACT, seed=3):
        np.testing.assert_allclose(np.linalg.norm(part.normals_camera, axis=1), 1.0, atol=1e-9)
        assert np.einsum("nk,nk->n", part.normals_camera, part.points_camera).max() < 1e-6
        canonical = (part.points_camera - part.t) @ part.R
        assert (np.abs(canonical) <= 0.5 * part.scale_m * part.extents_unit + 1e-5).all()
        assert 0.2 <= part.scale_m * part.extents_unit.max() <= 0.6


def test_noise_changes_neither_the_part_nor_the_keypoints_and_has_the_size_asked_for() -> None:
    exact, noisy, smooth = (
        suite(4, "mid", 800, noise, seed=5)
        for noise in (EXACT, Noise(0.005, 0.0, 0.0, 0.001), Noise(0.0, 0.0, 0.008, 0.0))
    )
    errors = []
    for one, other, third in zip(exact, noisy, smooth, strict=True):
        np.testing.assert_array_equal(one.keypoints_camera, other.keypoints_camera)
        assert np.std(one.points_camera - other.points_camera, axis=0)[2] == pytest.approx(0.001, rel=0.1)
        assert np.std(other.radii_m - one.radii_m) == pytest.approx(0.005, rel=0.1)
        errors.append(third.radii_m - one.radii_m)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.008, rel=0.3)


def test_the_gemm_accumulator_is_the_dense_one_but_for_rounding_at_the_edge_of_a_vote() -> None:
    for part in small_parts():
        radii_m = part.radii_m[:, 0]
        dense = dense_votes(part.points_camera, radii_m, 0.05)
        grid = grid_around(part.points_camera, radii_m, 0.05)
        np.testing.assert_array_equal(grid.first, dense.first)
        votes = gemm_votes(part.points_camera, radii_m, grid)
        assert np.mean(votes != dense.votes) < 1e-4
        assert np.abs(votes - dense.votes).max() <= 1
        by_slabs = maximum(lambda slab, p=part, r=radii_m: gemm_votes(p.points_camera, r, slab), grid, 500)
        assert by_slabs[0] == votes.max()
        first_of_ties = np.argwhere(votes == votes.max())[0] + grid.first
        np.testing.assert_array_equal(by_slabs[1], first_of_ties * 0.05)


def test_algorithm_1_in_numba_is_the_dense_accumulator_under_both_rules() -> None:
    pytest.importorskip("numba", reason="the compiled peers need numba")
    from benchmarks import compiled

    for part in small_parts():
        points, radii_m = part.points_camera, part.radii_m[:, 0]
        grid = grid_around(points, radii_m, 0.05)
        two_sided, one_sided = (dense_votes(points, radii_m, 0.05, rule=rule) for rule in ("two-sided", "one-sided"))
        np.testing.assert_array_equal(compiled.algorithm_1_votes(points, radii_m, grid), one_sided.votes)
        literal = compiled.algorithm_1_votes(points, radii_m, grid, one_sided=False)
        np.testing.assert_array_equal(literal, two_sided.votes)
        lifted = compiled.lifted_votes(points, radii_m, grid)
        assert np.mean(lifted != two_sided.votes) < 1e-4
        assert np.abs(lifted - two_sided.votes).max() <= 1


def test_the_slabs_of_a_grid_are_the_grid() -> None:
    part = small_parts()[0]
    grid = grid_around(part.points_camera, part.radii_m[:, 0], 0.08)
    for voxels in (1, 70, 1000, 10**7):
        slabs = list(grid.slabs(voxels))
        assert sum(slab.voxels for slab in slabs) == grid.voxels
        np.testing.assert_allclose(np.concatenate([slab.centres_m() for slab in slabs]), grid.centres_m())
        middle = grid.middle_slab(voxels)
        assert (middle.first >= grid.first).all()
        assert (middle.first + middle.shape <= grid.first + grid.shape).all()


def test_a_quick_run_has_the_figures_that_a_gate_reads() -> None:
    steps = quick_steps(cases=2, parts=len(SHAPES), frames=1, repeats=1, slab_evaluations=1e5)
    document = document_from(steps, {step.name: step.work() for step in steps}, machine(), quick=True)
    assert json.loads(json.dumps(document, allow_nan=False)) == json.loads(json.dumps(document))
    assert document["equal_fraction"] == 1.0
    assert 0.0 < document["ms_per_keypoint"]["p50"] <= document["ms_per_keypoint"]["p95"]
    for name in ("frame_ms", "frame_evaluations", "scoring_plus_registration_ms"):
        assert set(document[name]) == {"k2", "k4", "k7"}
    assert all(document["frame_ms"][k] < document["scoring_plus_registration_ms"][k] for k in ("k2", "k4", "k7"))
    assert document["keypoint_mm"]["refined"] < document["keypoint_mm"]["voxel"]
    for error in ("rotation_deg", "translation_mm"):
        assert document["pose"]["refined"][error] < document["pose"]["argmax_kabsch"][error]
    assert set(document["planar"]) >= {"truth_listed", "chosen", "ambiguous", "decided_by"}
    assert sum(document["planar"]["decided_by"].values()) == pytest.approx(1.0, abs=1e-3)
    assert abs(document["mis_scaled"]["refined"]["extra_mm"]) < 0.1
    assert all(peer["extrapolated"] for name in document["peers"] for peer in document["peers"][name]["peers"].values())
    assert "RTX 4090" in readable(document)


def test_the_names_of_the_steps_are_distinct_as_results_are_kept_by_them(tmp_path: Path) -> None:
    cache = Cache(tmp_path, "of these sources")
    for steps in (quick_steps(), full_steps()):
        assert len({cache._path(step.name) for step in steps}) == len(steps)
    assert {step.name for step in quick_steps()} < {step.name for step in full_steps()}


def test_results_are_kept_for_the_same_sources_only(tmp_path: Path) -> None:
    step = Step("parts mid K=2", lambda: {"ms": 1.5})
    Cache(tmp_path / "steps", "old").keep(step.name, step.work())
    assert Cache(tmp_path / "steps", "old").load(step.name) == {"ms": 1.5}
    assert Cache(tmp_path / "steps", "new").load(step.name) is None
    assert Cache(tmp_path / "steps", "old").load("another") is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--nonsense"], "unrecognized arguments: --nonsense"),
        (["--quick", "--out", "folder"], "leave out --out"),
        (["--quick", "--json", "no/such/folder/file.json"], "no folder"),
    ],
)
def test_bad_arguments_are_one_sentence_and_exit_code_2(
    arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(scorer, "_prepare", lambda: None)
    assert scorer.main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert message in said.err
    assert said.err.count("\n") == 1
