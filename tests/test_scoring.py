"""Laws of proposal integration scoring: it is the dense accumulator, only sooner."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dense_accumulator import dense_votes
from page_runtime.branch_and_bound import Shells, rival_votes, search, voters_from
from page_runtime.multilateration import anchors_from, linear_hypotheses, principal_axes, refine_positions
from page_runtime.scoring import KeypointVotes, score_keypoints
from synthetic_parts import (
    SyntheticPart,
    box_extents_m,
    keypoints_around,
    plate_extents_m,
    random_rotation,
    seen_part,
)


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


@pytest.mark.parametrize("block", range(20))
def test_maximum_ties_and_first_of_the_ties_are_those_of_the_dense_accumulator(block: int) -> None:
    for seed in range(20 * block, 20 * block + 20):
        points, radii, voxel_m = small_problem(seed)
        votes = score_keypoints(points, radii[:, None], voxel_m=voxel_m)[0]
        dense = dense_votes(points, radii, voxel_m)
        assert votes.gap == 0, seed
        assert votes.max_votes == dense.max_votes, seed
        np.testing.assert_array_equal(votes.ties_camera, dense.ties_camera, err_msg=str(seed))
        np.testing.assert_array_equal(votes.peaks[0].voxel_camera, dense.ties_camera[0], err_msg=str(seed))


def test_radii_on_the_very_edge_of_a_vote_are_counted_as_the_dense_accumulator_counts_them() -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        voxel_m = float(rng.choice([0.005, 2.0**-7]))
        points = voxel_m * rng.integers(-8, 8, (80, 3)) + rng.choice([0.0, 1.0]) * np.array([0.3, -0.2, 1.1])
        at = voxel_m * np.rint(points.mean(axis=0) / voxel_m + rng.integers(-10, 10, 3))
        edge = rng.choice([-1.0, 1.0], 80) * np.sqrt(3.0) * voxel_m
        radii = np.abs(np.linalg.norm(points.astype(np.float32) - at, axis=1) + edge)
        votes = score_keypoints(points, radii[:, None], voxel_m=voxel_m)[0]
        dense = dense_votes(points, radii, voxel_m)
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
            dense_votes(points, radii, voxel_m, rule=rule).ties_camera @ direction - 0.2
            for rule in ("two-sided", "one-sided")
        )
        # Towards the part is negative. The mean is over all voxels with the most votes.
        assert abs(two_sided.mean()) < 0.25 * voxel_m
        assert one_sided.mean() < -0.5 * voxel_m


@pytest.mark.parametrize("rival_share", [0.95, 0.7])
def test_every_voxel_with_the_rivals_share_is_found_with_its_votes(rival_share: float) -> None:
    for seed in range(1000, 1030):
        points, radii, voxel_m = small_problem(seed)
        dense = dense_votes(points, radii, voxel_m)
        voters = voters_from(points.astype(np.float64), voxel_m)
        # A seed that is no use: exactness must not depend on it.
        found = search(Shells(voters, radii.astype(np.float64)), np.full((1, 3), 5.0), rival_share, 10**9)
        rivals = np.argwhere(dense.votes >= rival_votes(dense.max_votes, rival_share))
        order = np.lexsort(found.voxels.T[::-1])
        np.testing.assert_array_equal(found.voxels[order], rivals + dense.first)
        np.testing.assert_array_equal(found.votes[order], dense.votes[tuple(rivals.T)])


@pytest.mark.parametrize("max_evaluations", [0, 3_000, 30_000, 300_000])
def test_a_spent_budget_gives_bounds_that_hold(max_evaluations: int) -> None:
    gaps = []
    for seed in range(2000, 2025):
        points, radii, voxel_m = small_problem(seed)
        votes = score_keypoints(points, radii[:, None], voxel_m=voxel_m, max_evaluations=max_evaluations)[0]
        dense = dense_votes(points, radii, voxel_m)
        assert votes.max_votes <= dense.max_votes <= votes.max_votes + votes.gap
        assert votes.evaluations <= max_evaluations + 300 * len(points)
        at = np.rint(votes.peaks[0].voxel_camera / voxel_m).astype(int) - dense.first
        assert dense.votes[tuple(at)] == votes.max_votes
        if votes.gap == 0:
            np.testing.assert_array_equal(votes.ties_camera, dense.ties_camera)
        gaps.append(votes.gap)
    assert max_evaluations > 30_000 or max(gaps) > 0


def test_a_hard_part_stays_within_the_default_budget() -> None:
    rng = np.random.default_rng(3)
    extents_m = box_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 1), sigma_m=0.05, outliers=0.7)
    votes = score_keypoints(part.points_camera, part.radii_m, voxel_m=0.002)[0]
    assert votes.gap > 0
    assert not votes.rivals_complete
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
            assert votes.rivals_complete
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
    for votes in score_keypoints(points, radii, max_evaluations=200_000):
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
    ],
)
def test_wrong_shapes_and_parameters_are_named(points, radii, options, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        score_keypoints(points, radii, **options)


def test_no_keypoints_are_no_votes() -> None:
    assert score_keypoints(np.zeros((5, 3)), np.zeros((5, 0))) == ()
