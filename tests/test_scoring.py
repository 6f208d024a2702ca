"""Laws of proposal integration scoring: it is the dense accumulator, only sooner."""

import tracemalloc
from itertools import combinations
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dense_accumulator import dense_votes
from page_runtime.branch_and_bound import search
from page_runtime.multilateration import anchors_from, linear_hypotheses, principal_axes, refine_positions, stacked
from page_runtime.scoring import ONE_SIDED, TWO_SIDED, KeypointVotes, VoteRule, score_keypoints, score_parts
from page_runtime.vote_shells import shells_from
from synthetic_parts import (
    SyntheticPart,
    box_extents_m,
    keypoints_around,
    plate_extents_m,
    random_rotation,
    seen_part,
)

RuleName = Literal["two-sided", "one-sided"]
RULES: dict[RuleName, VoteRule] = {"two-sided": TWO_SIDED, "one-sided": ONE_SIDED}
EACH_RULE = pytest.mark.parametrize("rule", list(RULES))


def small_problem(seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Points (N, 3), radii (N,) and a voxel whose dense grid is small; a quarter each without outliers and
    with 15, 40 and 60 %, flat and solid clouds, noise from nothing to two voxels, half with a correlated
    error."""
    rng = np.random.default_rng(seed)
    num_points, voxel_m = int(rng.integers(4, 120)), float(rng.choice([0.005, 0.007, 0.02]))
    half_extents = rng.uniform(2.0, 7.0) * np.array([1.0, rng.uniform(0.2, 1.0), rng.choice([0.0, 0.3, 1.0])])
    points = voxel_m * rng.uniform(-half_extents, half_extents, (num_points, 3)) @ random_rotation(rng).T
    keypoint = rng.normal(size=3) * 5.0 * voxel_m
    radii = np.linalg.norm(points - keypoint, axis=1) + rng.choice([0.0, 0.2, 0.6, 2.0]) * voxel_m * rng.normal(
        size=num_points
    )
    radii += rng.choice([0.0, 1.0]) * voxel_m * np.sin(points @ rng.normal(size=3) / voxel_m / 3.0)
    outlier = rng.random(num_points) < rng.choice([0.0, 0.15, 0.4, 0.6])
    radii = np.where(outlier, rng.uniform(0.0, 12.0 * voxel_m, num_points), np.abs(radii))
    points += rng.uniform(-2.0, 2.0, 3)
    return points.astype(np.float32), radii.astype(np.float32), voxel_m


def solid_part(seed: int, **noise: float) -> SyntheticPart:
    """A box that shows more than one face: of a single one the mirror image of a keypoint is as good."""
    rng = np.random.default_rng(seed)
    while True:
        extents_m = box_extents_m(rng)
        part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), **noise)
        spread, _ = principal_axes(part.points_camera - part.points_camera.mean(axis=0, dtype=np.float64))
        if spread[2] > 0.3 * spread[1]:
            return part


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
@pytest.mark.parametrize("rival_share", [0.95, 0.6])
def test_rivals_have_their_share_of_the_votes_and_keep_their_distance(rival_share: float, rule: RuleName) -> None:
    rivals = 0
    for seed in range(60):
        points, radii, voxel_m = small_problem(seed)
        dense = dense_votes(points, radii, voxel_m, rule=rule)
        (votes,) = score_keypoints(points, radii[:, None], voxel_m=voxel_m, rule=RULES[rule], rival_share=rival_share)
        rivals += len(votes.peaks) - 1
        for peak in votes.peaks:
            at = np.rint(peak.voxel_camera / voxel_m).astype(int) - dense.first
            assert dense.votes[tuple(at)] == peak.votes
            assert peak.votes >= rival_share * dense.max_votes - 1e-9
        for one, other in combinations(votes.peaks, 2):
            apart_m = np.linalg.norm(one.position_camera - other.position_camera)
            assert apart_m > 2.0 * np.sqrt(3.0) * voxel_m
    assert rivals > 0


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
    for peak in votes.peaks:
        at = np.rint(peak.voxel_camera / voxel_m).astype(int) - dense.first
        assert dense.votes[tuple(at)] == peak.votes
    if votes.gap == 0:
        np.testing.assert_array_equal(votes.ties_camera, dense.ties_camera)


def test_a_hard_part_stays_within_the_default_budget() -> None:
    rng = np.random.default_rng(3)
    extents_m = box_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 1), sigma_m=0.05, outliers=0.7)
    votes = score_keypoints(part.points_camera, part.radii_m, voxel_m=0.002)[0]
    assert votes.gap > 0
    assert votes.evaluations <= 20_000_000 + 300 * len(part.points_camera)


def test_exact_radii_give_the_exact_keypoint() -> None:
    for seed in range(10):
        part = solid_part(seed)
        for votes, truth in zip(score_keypoints(part.points_camera, part.radii_m), part.keypoints_camera, strict=True):
            assert np.linalg.norm(votes.peaks[0].position_camera - truth) < 1e-4
            assert votes.peaks[0].share == 1.0


def test_refinement_at_least_halves_the_error_of_the_voxel() -> None:
    refined, voxel = [], []
    for seed in range(15):
        part = solid_part(seed, sigma_m=0.005, outliers=0.15)
        for votes, truth in zip(score_keypoints(part.points_camera, part.radii_m), part.keypoints_camera, strict=True):
            refined.append(np.linalg.norm(votes.peaks[0].position_camera - truth))
            voxel.append(np.linalg.norm(votes.peaks[0].voxel_camera - truth))
    assert np.median(refined) <= 0.5 * np.median(voxel)


def test_the_peaks_of_a_plate_hold_the_keypoint_and_its_mirror_image() -> None:
    for seed in range(15):
        rng = np.random.default_rng(seed)
        extents_m = plate_extents_m(rng)
        part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), sigma_m=0.003, outliers=0.15)
        normal = part.R[:, 2]
        for votes, truth in zip(score_keypoints(part.points_camera, part.radii_m), part.keypoints_camera, strict=True):
            image = truth - 2.0 * (normal @ (truth - part.t)) * normal
            peaks = np.array([peak.position_camera for peak in votes.peaks])
            for expected in (truth, image):
                assert np.linalg.norm(peaks - expected, axis=1).min() < 0.02


def test_multilateration_starts_on_both_sides_of_a_plate() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        extents_m = plate_extents_m(rng)
        part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), sigma_m=0.003, outliers=0.3)
        anchors = anchors_from(part.points_camera)
        starts = linear_hypotheses(anchors, part.radii_m.T.astype(np.float64))
        for j, truth in enumerate(part.keypoints_camera):
            radii_m = np.repeat(part.radii_m[None, :, j].astype(np.float64), 2, axis=0)
            pair = refine_positions(starts[j, :2], anchors, radii_m, [0.3 * 0.6**k for k in range(8)])
            image = truth - 2.0 * (part.R[:, 2] @ (truth - part.t)) * part.R[:, 2]
            for expected in (truth, image):
                assert np.linalg.norm(pair - expected, axis=1).min() < 0.01


def test_peaks_are_sorted_and_apart() -> None:
    rng = np.random.default_rng(0)
    extents_m = plate_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), sigma_m=0.01)
    voxel_m = 0.005
    for votes in score_keypoints(part.points_camera, part.radii_m, voxel_m=voxel_m):
        counts = [peak.votes for peak in votes.peaks]
        assert counts == sorted(counts, reverse=True)
        assert counts[0] == votes.max_votes
        assert counts[-1] >= 0.95 * votes.max_votes
        assert votes.ties == len(votes.ties_camera) >= 1
        apart_m = [
            np.linalg.norm(one.position_camera - other.position_camera) for one, other in combinations(votes.peaks, 2)
        ]
        assert len(apart_m) > 0
        assert min(apart_m) > 2.0 * np.sqrt(3.0) * voxel_m


def test_moving_the_part_moves_the_keypoints() -> None:
    part = solid_part(5, sigma_m=0.005, outliers=0.2)
    rng = np.random.default_rng(5)
    R, t = random_rotation(rng), np.array([0.3, -0.2, 1.1])
    moved = score_keypoints(part.points_camera @ R.T + t, part.radii_m)
    for before, after in zip(score_keypoints(part.points_camera, part.radii_m), moved, strict=True):
        expected = R @ before.peaks[0].position_camera + t
        assert np.linalg.norm(after.peaks[0].position_camera - expected) < 5e-4


def test_moving_the_part_by_whole_voxels_moves_the_ties_and_nothing_else() -> None:
    rng = np.random.default_rng(6)
    voxel_m = 2.0**-7
    points = np.round(rng.uniform(-0.2, 0.2, (200, 3)) * 2**18) / 2**18
    radii = np.linalg.norm(points - [0.1, 0.3, 0.2], axis=1)[:, None] + rng.normal(size=(200, 1)) * 0.005
    shift = voxel_m * np.array([17, -40, 100])
    before = score_keypoints(points, radii, voxel_m=voxel_m)[0]
    after = score_keypoints(points + shift, radii, voxel_m=voxel_m)[0]
    np.testing.assert_array_equal(after.ties_camera, before.ties_camera + shift)
    assert after.max_votes == before.max_votes


def test_neither_the_order_of_the_points_nor_the_other_keypoints_matter() -> None:
    rng = np.random.default_rng(7)
    extents_m = plate_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), sigma_m=0.005, outliers=0.3)
    order = rng.permutation(len(part.points_camera))
    together = score_keypoints(part.points_camera, part.radii_m)
    shuffled = score_keypoints(part.points_camera[order], part.radii_m[order])
    for j, votes in enumerate(together):
        alone = score_keypoints(part.points_camera, part.radii_m[:, j : j + 1])[0]
        for other in (shuffled[j], alone):
            assert other.max_votes == votes.max_votes
            np.testing.assert_array_equal(other.ties_camera, votes.ties_camera)


@EACH_RULE
def test_a_frame_of_parts_is_scored_as_each_part_alone(rule: RuleName) -> None:
    parts = []
    for seed, count in enumerate([500, 3, 60, 0, 300]):
        rng = np.random.default_rng(seed)
        extents_m = box_extents_m(rng)
        part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 2), sigma_m=0.004, outliers=0.2)
        parts.append((part.points_camera[:count], part.radii_m[:count]))
    parts.append((parts[0][0], parts[0][1][:, :0]))
    parts[2][1][:, 0] = np.nan
    parts[4][0][7] = np.nan
    frame = score_parts(parts, rule=RULES[rule])
    assert len(frame) == len(parts)
    for (points, radii), together in zip(parts, frame, strict=True):
        for one, other in zip(together, score_keypoints(points, radii, rule=RULES[rule]), strict=True):
            assert (one.max_votes, one.gap, one.reason) == (other.max_votes, other.gap, other.reason)
            np.testing.assert_array_equal(one.ties_camera, other.ties_camera)
            for peak, alone in zip(one.peaks, other.peaks, strict=True):
                np.testing.assert_array_equal(peak.voxel_camera, alone.voxel_camera)
                np.testing.assert_allclose(peak.position_camera, alone.position_camera, atol=1e-9)


def test_stacked_parts_are_located_as_each_part_alone() -> None:
    rng = np.random.default_rng(11)
    clouds = [rng.normal(size=(count, 3)) * 0.2 + 1.0 for count in (100, 37)]
    radii = [np.linalg.norm(cloud - rng.normal(size=(2, 1, 3)), axis=2) for cloud in clouds]
    padded = np.full((2, 2, 100), 1e6)
    for row, each in zip(padded, radii, strict=True):
        row[:, : each.shape[1]] = each
    anchors = stacked([anchors_from(cloud) for cloud in clouds])
    starts = linear_hypotheses(anchors, padded)
    refined = refine_positions(starts[:, :, 2], anchors, padded, [0.1, 0.02])
    for k, cloud in enumerate(clouds):
        alone = linear_hypotheses(anchors_from(cloud), radii[k])
        np.testing.assert_allclose(starts[k], alone, atol=1e-6)
        np.testing.assert_allclose(
            refined[k], refine_positions(alone[:, 2], anchors_from(cloud), radii[k], [0.1, 0.02]), atol=1e-6
        )


def test_a_frame_is_scored_in_4_mb() -> None:
    parts = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        extents_m = plate_extents_m(rng)
        part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), sigma_m=0.005, outliers=0.15)
        parts.append((part.points_camera, part.radii_m))
    tracemalloc.start()
    try:
        score_parts(parts)
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak_bytes < 4e6


def test_bad_points_and_radii_do_not_vote() -> None:
    rng = np.random.default_rng(8)
    extents_m = box_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), sigma_m=0.004)
    points, radii = part.points_camera.copy(), part.radii_m.copy()
    points[3] = np.nan
    points[4, 1] = np.inf
    radii[5:9] = [[np.nan], [-0.1], [np.inf], [1e9]]
    radii[9, 1] = np.nan
    good = np.r_[0:3, 10 : len(points)]
    clean = score_keypoints(points[good], radii[good])
    for j, votes in enumerate(score_keypoints(points, radii)):
        rows = good if j == 1 else np.r_[good, 9]
        expected = clean[1] if j == 1 else score_keypoints(points[rows], radii[rows])[j]
        assert votes.max_votes == expected.max_votes
        np.testing.assert_array_equal(votes.ties_camera, expected.ties_camera)


def assert_no_peak(votes: KeypointVotes, reason: str) -> None:
    assert reason in votes.reason
    assert votes.peaks == ()
    assert votes.max_votes == 0
    assert votes.gap == 0
    assert votes.ties == 0


@pytest.mark.parametrize("count", [0, 1, 3])
def test_fewer_than_four_points_are_no_votes(count: int) -> None:
    for votes in score_keypoints(np.zeros((count, 3)), np.ones((count, 2))):
        assert_no_peak(votes, "four are needed")


def test_points_on_a_line_or_at_one_place_are_no_votes() -> None:
    line = np.linspace(0.0, 1.0, 50)[:, None] * np.array([0.1, 0.2, 0.3]) + 1.0
    assert_no_peak(score_keypoints(line, np.full((50, 1), 0.3))[0], "one line")
    assert_no_peak(score_keypoints(np.ones((50, 3)), np.full((50, 1), 0.3))[0], "one line")


def test_one_keypoint_without_radii_leaves_the_others_alone() -> None:
    rng = np.random.default_rng(9)
    extents_m = box_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3))
    radii = part.radii_m.copy()
    radii[:, 1] = np.nan
    votes = score_keypoints(part.points_camera, radii)
    assert_no_peak(votes[1], "0 points vote")
    assert votes[0].peaks[0].share == votes[2].peaks[0].share == 1.0


@settings(max_examples=60, deadline=None)
@given(
    points=hnp.arrays(np.float32, st.tuples(st.integers(0, 12), st.just(3))),
    data=st.data(),
)
def test_no_value_whatever_raises_or_takes_unbounded_work(points: np.ndarray, data: st.DataObject) -> None:
    radii = data.draw(hnp.arrays(np.float32, (len(points), 2)))
    rule = data.draw(
        st.sampled_from([*RULES.values(), VoteRule(-3.0, 2.0, closed=False), VoteRule(0.5, 1.0, closed=True)])
    )
    for votes in score_keypoints(points, radii, rule=rule, max_evaluations=200_000):
        assert bool(votes.peaks) == (votes.reason == "")
        assert votes.evaluations <= 200_000 + 300 * len(points)
        assert all(np.isfinite(peak.position_camera).all() for peak in votes.peaks)


def test_points_and_radii_at_the_range_limit_are_scored_within_the_budget() -> None:
    rng = np.random.default_rng(10)
    points = rng.uniform(-9000.0, 9000.0, (60, 3))
    votes = score_keypoints(points, rng.uniform(0.0, 9000.0, (60, 1)), max_evaluations=2_000_000)[0]
    assert votes.evaluations <= 2_000_000 + 300 * 60
    assert votes.max_votes >= 1


@pytest.mark.parametrize(
    ("points", "radii", "options", "message"),
    [
        (np.zeros((5, 2)), np.zeros((5, 1)), {}, r"points_camera: expected \(N, 3\).*\(5, 2\)"),
        (np.zeros((5, 3)), np.zeros(5), {}, r"radii_m: expected \(5, n\).*\(5,\)"),
        (np.zeros((5, 3)), np.zeros((4, 1)), {}, "radii_m: expected"),
        (np.zeros((5, 3)), np.zeros((5, 1)), {"voxel_m": 0.0}, "voxel_m: expected"),
        (np.zeros((5, 3)), np.zeros((5, 1)), {"voxel_m": float("nan")}, "voxel_m: expected"),
        (np.zeros((5, 3)), np.zeros((5, 1)), {"rival_share": 1.5}, "rival_share: expected"),
        (np.zeros((5, 3)), np.zeros((5, 1)), {"max_evaluations": -1}, "max_evaluations: expected"),
        (np.zeros((5, 3)), np.zeros((5, 1)), {"max_seconds": -1.0}, "max_seconds: expected"),
        (np.zeros((5, 3)), np.zeros((5, 1)), {"max_seconds": float("nan")}, "max_seconds: expected"),
    ],
)
def test_wrong_shapes_and_parameters_are_named(points, radii, options, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        score_keypoints(points, radii, **options)


def test_no_keypoints_are_no_votes() -> None:
    assert score_keypoints(np.zeros((5, 3)), np.zeros((5, 0))) == ()


@pytest.mark.parametrize(("lowest", "highest"), [(1.0, 1.0), (0.0, -1.0), (float("nan"), 1.0), (-1.0, float("inf"))])
def test_a_rule_without_a_shell_is_named(lowest: float, highest: float) -> None:
    with pytest.raises(ValueError, match="VoteRule: expected lowest_etas < highest_etas"):
        VoteRule(lowest, highest, closed=True)


def test_radii_that_leave_no_voxel_a_vote_are_no_votes() -> None:
    points = np.random.default_rng(12).uniform(-0.1, 0.1, (30, 3))
    votes = score_keypoints(points, np.zeros((30, 1)), rule=ONE_SIDED)[0]
    assert dense_votes(points, np.zeros(30), 0.005, rule="one-sided").max_votes == 0
    assert_no_peak(votes, "no voxel has a vote")
    assert score_keypoints(points, np.zeros((30, 1)), rule=ONE_SIDED, max_evaluations=0)[0].gap > 0


@EACH_RULE
def test_parts_far_from_the_camera_are_scored(rule: RuleName) -> None:
    rng = np.random.default_rng(13)
    points = (rng.uniform(-0.2, 0.2, (60, 3)) + np.array([0.0, 300.0, 1000.0])).astype(np.float32)
    radii = np.linalg.norm(points - np.array([0.1, 300.2, 1000.0]), axis=1)
    votes = score_keypoints(points, radii[:, None], voxel_m=0.02, rule=RULES[rule])[0]
    dense = dense_votes(points, radii, 0.02, rule=rule)
    assert (votes.max_votes, votes.gap) == (dense.max_votes, 0)
    np.testing.assert_array_equal(votes.ties_camera, dense.ties_camera)
