"""Laws of proposal integration scoring: it is the dense accumulator, only sooner."""

import tracemalloc

import numpy as np
import pytest

from dense_accumulator import dense_votes
from page_runtime.branch_and_bound import search
from page_runtime.scoring import ONE_SIDED, TWO_SIDED, KeypointVotes, score_keypoints, score_parts
from page_runtime.vote_shells import shells_from
from scoring_problems import EACH_RULE, RULES, RuleName, small_problem
from synthetic_parts import (
    box_extents_m,
    keypoints_around,
    seen_part,
)


@EACH_RULE
@pytest.mark.parametrize("block", range(8))
def test_maximum_ties_and_first_of_the_ties_are_those_of_the_dense_accumulator(block: int, rule: RuleName) -> None:
    for seed in range(20 * block, 20 * block + 20):
        points, radii, voxel_m = small_problem(seed)
        votes = score_keypoints(points, radii[:, None], voxel_m=voxel_m, rule=RULES[rule])[0]
        dense = dense_votes(points, radii, voxel_m, rule=rule)
        assert votes.gap == 0, seed
        assert votes.max_votes == dense.max_votes, seed
        np.testing.assert_array_equal(votes.ties_camera, dense.ties_camera, err_msg=str(seed))
        np.testing.assert_array_equal(votes.peaks[0].voxel_camera, dense.ties_camera[0], err_msg=str(seed))


@EACH_RULE
def test_radii_on_the_very_edge_of_a_vote_are_counted_as_the_dense_accumulator_counts_them(rule: RuleName) -> None:
    for seed in range(15):
        rng = np.random.default_rng(seed)
        voxel_m = float(rng.choice([0.005, 2.0**-7]))
        points = voxel_m * rng.integers(-8, 8, (80, 3)) + rng.choice([0.0, 1.0]) * np.array([0.3, -0.2, 1.1])
        at = voxel_m * np.rint(points.mean(axis=0) / voxel_m + rng.integers(-10, 10, 3))
        edge = rng.choice(RULES[rule].bounds_m(voxel_m), 80)
        radii = np.abs(np.linalg.norm(points.astype(np.float32) - at, axis=1) - edge)
        votes = score_keypoints(points, radii[:, None], voxel_m=voxel_m, rule=RULES[rule])[0]
        dense = dense_votes(points, radii, voxel_m, rule=rule)
        assert (votes.max_votes, votes.gap) == (dense.max_votes, 0)
        np.testing.assert_array_equal(votes.ties_camera, dense.ties_camera)


def test_the_one_sided_rule_would_place_a_keypoint_nearer_to_the_part() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        points = rng.uniform(-0.1, 0.1, (120, 3))
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        radii, voxel_m = np.linalg.norm(points - 0.2 * direction, axis=1), 0.02
        two_sided, one_sided = (
            score_keypoints(points, radii[:, None], voxel_m=voxel_m, rule=rule)[0].ties_camera @ direction - 0.2
            for rule in (TWO_SIDED, ONE_SIDED)
        )
        # Towards the part is negative. The mean is over all voxels with the most votes.
        assert abs(two_sided.mean()) < 0.25 * voxel_m
        assert one_sided.mean() < -0.5 * voxel_m


@EACH_RULE
def test_exactness_does_not_depend_on_the_seeds(rule: RuleName) -> None:
    for seed in range(1000, 1015):
        points, radii, voxel_m = small_problem(seed)
        dense = dense_votes(points, radii, voxel_m, rule=rule)
        part = points.astype(np.float64), radii[None].astype(np.float64)
        found = search(shells_from([part], voxel_m, RULES[rule]), np.full((1, 1, 3), 5.0), 10**9)[0]
        assert found.votes == dense.max_votes
        np.testing.assert_array_equal(found.voxels, np.argwhere(dense.votes == dense.max_votes) + dense.first)


@EACH_RULE
@pytest.mark.parametrize("max_evaluations", [0, 3_000, 30_000, 300_000])
def test_a_spent_budget_gives_bounds_that_hold(max_evaluations: int, rule: RuleName) -> None:
    gaps = []
    for seed in range(2000, 2015):
        points, radii, voxel_m = small_problem(seed)
        votes = score_keypoints(
            points, radii[:, None], voxel_m=voxel_m, rule=RULES[rule], max_evaluations=max_evaluations
        )[0]
        assert_bounds_hold(votes, points, radii, voxel_m, rule)
        assert votes.evaluations <= max_evaluations + 300 * len(points)
        gaps.append(votes.gap)
    assert max_evaluations > 30_000 or max(gaps) > 0


@EACH_RULE
def test_a_time_that_is_up_gives_bounds_that_hold(rule: RuleName) -> None:
    gaps = []
    for seed in range(2000, 2015):
        points, radii, voxel_m = small_problem(seed)
        for max_seconds in (0.0, 0.003):
            options = {"voxel_m": voxel_m, "rule": RULES[rule], "max_seconds": max_seconds}
            votes = score_keypoints(points, radii[:, None], **options)[0]
            assert_bounds_hold(votes, points, radii, voxel_m, rule)
            gaps.append(votes.gap)
    assert max(gaps) > 0


@EACH_RULE
@pytest.mark.parametrize("ticks", [0, 1, 2, 5, 9, 14, 20, 30, 50])
def test_bounds_hold_wherever_the_time_is_up(ticks: int, rule: RuleName, monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(2000, 2006):
        points, radii, voxel_m = small_problem(seed)
        part = points.astype(np.float64), radii[None].astype(np.float64)
        clock = iter(range(10**6))
        monkeypatch.setattr("page_runtime.branch_and_bound.perf_counter", lambda clock=clock: next(clock))
        shells = shells_from([part], voxel_m, RULES[rule])
        found = search(shells, np.full((1, 1, 3), 5.0), 10**9, deadline=ticks)[0]
        dense = dense_votes(points, radii, voxel_m, rule=rule)
        at = found.voxels - dense.first
        inside = ((at >= 0) & (at < dense.votes.shape)).all(axis=1)
        assert (dense.votes[tuple(at[inside].T)] == found.votes).all()
        assert dense.max_votes <= max(found.unsearched_bound, found.votes)


def assert_bounds_hold(
    votes: KeypointVotes, points: np.ndarray, radii: np.ndarray, voxel_m: float, rule: RuleName
) -> None:
    dense = dense_votes(points, radii, voxel_m, rule=rule)
    assert votes.max_votes <= dense.max_votes <= votes.max_votes + votes.gap
    assert all(peak.votes <= votes.max_votes for peak in votes.peaks)
    assert [peak.votes for peak in votes.peaks] == sorted((peak.votes for peak in votes.peaks), reverse=True)
    for peak in votes.peaks:
        at = np.rint(peak.voxel_camera / voxel_m).astype(int) - dense.first
        assert dense.votes[tuple(at)] == peak.votes
    if votes.gap == 0:
        np.testing.assert_array_equal(votes.ties_camera, dense.ties_camera)


def test_a_hard_part_stays_within_a_budget_and_the_memory() -> None:
    rng = np.random.default_rng(3)
    extents_m = box_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 1), sigma_m=0.05, outliers=0.7)
    tracemalloc.start()
    try:
        votes = score_keypoints(part.points_camera, part.radii_m, voxel_m=0.002, max_evaluations=60_000_000)[0]
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert votes.gap > 0
    assert votes.evaluations <= 60_000_000 + 300 * len(part.points_camera)
    assert peak_bytes < 50e6


@EACH_RULE
@pytest.mark.parametrize("batch_cells", [1, 7, 50])
def test_cells_that_go_on_in_batches_give_the_same_answer(
    batch_cells: int, rule: RuleName, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("page_runtime.branch_and_bound._BATCH_CELLS", batch_cells)
    for seed in range(3000, 3008):
        points, radii, voxel_m = small_problem(seed)
        votes = score_keypoints(points, radii[:, None], voxel_m=voxel_m, rule=RULES[rule])[0]
        dense = dense_votes(points, radii, voxel_m, rule=rule)
        assert votes.gap == 0
        assert votes.max_votes == dense.max_votes
        np.testing.assert_array_equal(votes.ties_camera, dense.ties_camera)


def test_too_many_ties_leave_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four points of a plateau: its voxels go on in batches, and the search ends with the ties it may keep."""
    monkeypatch.setattr("page_runtime.branch_and_bound._BATCH_CELLS", 20)
    monkeypatch.setattr("page_runtime.branch_and_bound._MAX_TIES", 10)
    points = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0], [0.1, 0.1, 1.05]])
    radii = np.linalg.norm(points - [0.3, 0.2, 0.9], axis=1)[:, None]
    votes = score_keypoints(points, radii, voxel_m=0.01)[0]
    assert votes.max_votes == 4
    assert votes.gap > 0
    monkeypatch.undo()
    whole = score_keypoints(points, radii, voxel_m=0.01)[0]
    assert whole.gap == 0
    assert whole.ties > votes.ties
    assert {tuple(tie) for tie in votes.ties_camera} <= {tuple(tie) for tie in whole.ties_camera}


def test_small_voxels_are_certified_by_default() -> None:
    rng = np.random.default_rng(5)
    extents_m = box_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), sigma_m=0.005, outliers=0.15)
    for votes in score_keypoints(part.points_camera, part.radii_m, voxel_m=0.002):
        assert votes.gap == 0


def test_radii_that_agree_on_nothing_take_their_share_of_the_budget() -> None:
    rng = np.random.default_rng(8)
    extents_m = box_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 1), sigma_m=0.002, outliers=0.1)
    radii = np.hstack([part.radii_m, rng.uniform(0.1, 1.0, part.radii_m.shape)])
    budget = 4_000_000
    whole = score_keypoints(part.points_camera, radii, max_evaluations=budget)
    ((good, bad),) = score_parts([(part.points_camera, radii)], full_share=0.5, max_evaluations=budget)
    assert (good.max_votes, good.gap) == (whole[0].max_votes, 0)
    # Of N voters some hundredths agree, so some hundredths of twice the budget are spent.
    allowed = 2 * budget * bad.max_votes / len(part.points_camera) + 300 * len(part.points_camera)
    assert 0 < bad.evaluations <= allowed < whole[1].evaluations
    assert bad.gap > 0
    assert bad.max_votes <= whole[1].max_votes + whole[1].gap <= bad.max_votes + bad.gap
