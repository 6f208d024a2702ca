"""What the scorer says of input that no keypoint follows from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dense_accumulator import dense_votes
from page_runtime.scoring import ONE_SIDED, KeypointVotes, VoteRule, score_keypoints, score_parts
from scoring_problems import EACH_RULE, RULES, RuleName
from synthetic_parts import (
    box_extents_m,
    keypoints_around,
    seen_part,
)


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


@pytest.mark.parametrize("share", [-0.1, 1.5, float("nan")])
def test_a_share_that_is_none_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match="full_share: expected a share"):
        score_parts([], full_share=share)
