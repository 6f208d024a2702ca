"""The modes of the votes: where the keypoint and its rivals are, refined below the voxel, whatever moves."""

import tracemalloc
from itertools import combinations

import numpy as np
import pytest

from dense_accumulator import dense_votes
from page_runtime.multilateration import anchors_from, linear_hypotheses, refine_positions, stacked
from page_runtime.scoring import score_keypoints, score_parts
from scoring_problems import EACH_RULE, RULES, RuleName, small_problem, solid_part
from synthetic_parts import (
    box_extents_m,
    keypoints_around,
    plate_extents_m,
    random_rotation,
    seen_part,
)


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


@pytest.mark.parametrize("max_evaluations", [0, 100_000])
def test_no_rival_has_more_votes_than_the_maximum_of_a_search_cut_short(max_evaluations: int) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        extents_m = plate_extents_m(rng)
        part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), sigma_m=0.003, outliers=0.15)
        for votes in score_keypoints(part.points_camera, part.radii_m, max_evaluations=max_evaluations):
            assert votes.max_votes == votes.peaks[0].votes == max(peak.votes for peak in votes.peaks)
            np.testing.assert_array_equal(votes.peaks[0].voxel_camera, votes.ties_camera[0])


def test_a_part_far_away_costs_another_none_of_its_modes() -> None:
    rng = np.random.default_rng(1)
    extents_m = plate_extents_m(rng)
    part = seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), sigma_m=0.003, outliers=0.15)
    far = part.points_camera, np.linalg.norm(part.points_camera - np.array([100.0, 0.0, 0.0]), axis=1)[:, None]
    alone = score_parts([(part.points_camera, part.radii_m)])[0]
    beside = score_parts([(part.points_camera, part.radii_m), far])[0]
    for one, other in zip(alone, beside, strict=True):
        assert [peak.votes for peak in one.peaks] == [peak.votes for peak in other.peaks]
