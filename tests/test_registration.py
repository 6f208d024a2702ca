"""Laws of registration: exact radii give the exact pose, and what is ambiguous is said to be."""

from dataclasses import replace

import numpy as np
import pytest

from page_runtime.geometry import rotation_angle
from page_runtime.registration import Ambiguous, Observed, Registration, register_part, register_parts
from page_runtime.scoring import KeypointVotes, score_keypoints
from synthetic_parts import (
    SyntheticPart,
    box_extents_m,
    keypoints_around,
    plate_extents_m,
    random_rotation,
    seen_part,
)

SCALES_M = (0.15, 1.0)


def scored(part: SyntheticPart, num_voted: int = 3) -> tuple[KeypointVotes, ...]:
    return score_keypoints(part.points_camera, part.radii_m[:, :num_voted])


def registered(part: SyntheticPart, votes: tuple[KeypointVotes, ...] | None = None, **options):
    return register_part(observed(part, votes, **options))


def observed(part: SyntheticPart, votes: tuple[KeypointVotes, ...] | None = None, **options) -> Observed:
    arguments = {
        "points_camera": part.points_camera,
        "radii_m": part.radii_m,
        "keypoints_unit": part.keypoints_unit,
        "votes": scored(part) if votes is None else votes,
        "extents_unit": part.extents_unit,
        "scale_range_m": SCALES_M,
    }
    return Observed(**(arguments | options))


def pose_of(result: Registration | Ambiguous | str) -> Registration:
    assert isinstance(result, Registration), result
    return result


def reason_of(result: Registration | Ambiguous | str) -> str:
    assert isinstance(result, str), result
    return result


def errors(result: Registration, part: SyntheticPart) -> tuple[float, float, float]:
    """Rotation in degrees, translation in millimetres, scale in per cent."""
    T = result.T_camera_part
    return (
        float(np.degrees(rotation_angle(T[:3, :3], part.R))),
        float(1e3 * np.linalg.norm(T[:3, 3] - part.t)),
        100.0 * abs(result.scale_m / part.scale_m - 1.0),
    )


def box_part(seed: int, **noise: float) -> SyntheticPart:
    rng = np.random.default_rng(seed)
    extents_m = box_extents_m(rng)
    return seen_part(rng, extents_m, keypoints_around(rng, extents_m, 8), **noise)


def lid(seed: int, **noise: float) -> SyntheticPart:
    """Points exactly in a plane (without depth noise), all keypoints off it."""
    rng = np.random.default_rng(seed)
    extents_m = plate_extents_m(rng)
    return seen_part(rng, extents_m, keypoints_around(rng, extents_m, 8), **noise)


def symmetric_lid(seed: int, **noise: float) -> SyntheticPart:
    """A lid whose three keypoints lie in its symmetry plane x = 0: neither radii nor box tell the mirror
    image.
    """
    rng = np.random.default_rng(seed)
    keypoints_m = np.array([[0.0, 0.1, 0.25], [0.0, -0.25, 0.15], [0.0, 0.15, -0.2]])
    return seen_part(rng, np.array([0.3, 0.2, 0.0]), keypoints_m, **noise)


def test_exact_radii_give_the_exact_pose_and_scale_of_boxes() -> None:
    for seed in range(20):
        part = box_part(seed)
        result = pose_of(registered(part))
        assert max(errors(result, part)) < 0.01
        assert result.inlier_share == 1.0
        assert result.residual_m < 1e-5
        np.testing.assert_allclose(result.keypoints_camera, part.keypoints_camera, atol=1e-5)


def test_a_flat_lid_is_told_from_its_mirror_image_by_the_other_keypoints() -> None:
    for seed in range(20):
        part = lid(seed)
        votes = scored(part)
        for j, one in enumerate(votes):
            truth = part.keypoints_camera[j]
            image = truth - 2.0 * (part.R[:, 2] @ (truth - part.t)) * part.R[:, 2]
            peaks = np.array([peak.position_camera for peak in one.peaks])
            assert np.linalg.norm(peaks - image, axis=1).min() < 1e-3
        result = pose_of(registered(part, votes))
        assert max(errors(result, part)) < 0.01
        assert result.runner_up_ratio < 0.9


def test_a_flat_lid_is_right_also_where_only_its_mirror_image_was_voted_for() -> None:
    for seed in range(10):
        part = lid(seed, sigma_m=0.003, outliers=0.1)
        normal, wrong = part.R[:, 2], []
        for j, one in enumerate(scored(part)):
            truth = part.keypoints_camera[j]
            image = truth - 2.0 * (normal @ (truth - part.t)) * normal
            nearest = min(one.peaks, key=lambda peak: float(np.linalg.norm(peak.position_camera - image)))
            wrong.append(replace(one, peaks=(nearest,)))
        assert max(errors(pose_of(registered(part, tuple(wrong))), part)[:1]) < 2.0


def test_with_three_keypoints_the_sides_decide_and_without_them_it_is_ambiguous() -> None:
    for seed in range(10):
        part = symmetric_lid(seed, sigma_m=0.003, outliers=0.1)
        votes = scored(part)
        rng = np.random.default_rng(seed)
        unsure = np.where(rng.random(part.sides.shape) < 0.2, -1.0, 1.0)
        result = pose_of(registered(part, votes, side_logits=3.0 * part.sides * unsure))
        assert errors(result, part)[0] < 2.0
        opposite = pose_of(registered(part, votes, side_logits=-3.0 * part.sides))
        assert errors(opposite, part)[0] > 30.0
        for undecided in (None, np.zeros_like(part.sides), np.full_like(part.sides, np.nan)):
            result = registered(part, votes, side_logits=undecided)
            assert isinstance(result, Ambiguous)
            assert result.reason.startswith("ambiguous")
            assert min(errors(pose, part)[0] for pose in result.poses) < 2.0


def test_with_three_keypoints_off_the_symmetry_planes_the_box_decides() -> None:
    for seed in range(20):
        part = lid(seed, sigma_m=0.003, outliers=0.1)
        part = replace(part, radii_m=part.radii_m[:, :3], keypoints_unit=part.keypoints_unit[:3])
        assert errors(pose_of(registered(part)), part)[0] < 5.0


def test_without_any_votes_multilateration_tries_both_sides_of_a_flat_lid() -> None:
    for seed in range(10):
        part = lid(seed, sigma_m=0.003, outliers=0.1)
        assert errors(pose_of(registered(part, ())), part)[0] < 2.0


def test_misscaled_keypoints_cost_nothing() -> None:
    for seed in range(8):
        part = box_part(seed, sigma_m=0.005, outliers=0.15)
        votes = scored(part)
        plain = pose_of(registered(part, votes))
        scaled = replace(part, keypoints_unit=1.03 * part.keypoints_unit)
        result = pose_of(registered(scaled, votes))
        assert result.scale_m * 1.03 == pytest.approx(plain.scale_m, rel=1e-4)
        np.testing.assert_allclose(result.T_camera_part, plain.T_camera_part, atol=1e-4)


def test_noise_of_5_mm_and_15_percent_outliers_cost_half_a_degree_and_two_millimetres() -> None:
    found = np.array(
        [
            errors(pose_of(registered(part)), part)
            for part in (box_part(seed, sigma_m=0.005, outliers=0.15, depth_noise_m=0.001) for seed in range(20))
        ]
    )
    rotation_deg, translation_mm, _ = np.median(found, axis=0)
    assert rotation_deg <= 0.5
    assert translation_mm <= 2.0
    assert found[:, 0].max() <= 2.0


def test_the_covariance_covers_the_errors() -> None:
    squares = []
    for seed in range(20):
        part = box_part(seed, sigma_m=0.005, outliers=0.1)
        result = pose_of(registered(part))
        assert result.residual_m == pytest.approx(0.005, rel=0.3)
        R_error = result.T_camera_part[:3, :3] @ part.R.T
        rotation = 0.5 * np.array([R_error[2, 1], R_error[0, 2], R_error[1, 0]]) - 0.5 * np.array(
            [R_error[1, 2], R_error[2, 0], R_error[0, 1]]
        )
        step = np.concatenate((rotation, result.T_camera_part[:3, 3] - part.t, [np.log(result.scale_m / part.scale_m)]))
        np.testing.assert_allclose(result.covariance, result.covariance.T, rtol=1e-6, atol=1e-15)
        squares.append(step @ np.linalg.solve(result.covariance, step))
    # Chi-square of 7 degrees of freedom: its mean over 20 parts is within 7 +- 2.5 by three standard
    # deviations.
    assert 3.5 < np.mean(squares) < 12.0


def test_moving_the_points_moves_the_pose() -> None:
    part = box_part(3, sigma_m=0.005, outliers=0.15)
    before = pose_of(registered(part))
    rng = np.random.default_rng(0)
    R, t = random_rotation(rng), np.array([0.2, -0.3, 0.9])
    moved = replace(part, points_camera=(part.points_camera @ R.T + t).astype(np.float32))
    after = pose_of(registered(moved))
    np.testing.assert_allclose(after.T_camera_part[:3, :3], R @ before.T_camera_part[:3, :3], atol=2e-4)
    np.testing.assert_allclose(after.T_camera_part[:3, 3], R @ before.T_camera_part[:3, 3] + t, atol=2e-4)
    assert after.scale_m == pytest.approx(before.scale_m, rel=2e-4)


def test_a_keypoint_without_peaks_or_with_a_false_one_does_not_spoil_the_pose() -> None:
    for seed in range(8):
        part = box_part(seed, sigma_m=0.004, outliers=0.1)
        votes = scored(part)
        silent = replace(votes[0], peaks=(), reason="0 points vote, four are needed")
        false_peak = replace(votes[1].peaks[0], position_camera=votes[1].peaks[0].position_camera + 0.2)
        for spoilt in (
            (silent, *votes[1:]),
            (silent, silent, silent),
            (votes[0], replace(votes[1], peaks=(false_peak,)), votes[2]),
            (),
        ):
            rotation_deg, translation_mm, _ = errors(pose_of(registered(part, spoilt)), part)
            assert rotation_deg < 2.0
            assert translation_mm < 5.0


def test_garbage_radii_of_one_keypoint_do_not_spoil_the_pose() -> None:
    for seed in range(8):
        part = box_part(seed, sigma_m=0.004, outliers=0.1)
        radii = part.radii_m.copy()
        radii[:, 0] = np.random.default_rng(seed).uniform(0.1, 0.8, len(radii))
        radii[::3, 2] = np.nan
        rotation_deg, translation_mm, _ = errors(pose_of(registered(replace(part, radii_m=radii))), part)
        assert rotation_deg < 2.0
        assert translation_mm < 5.0


def test_too_few_points_points_on_a_line_and_no_finite_point_have_a_reason() -> None:
    part = box_part(0)
    votes = scored(part)
    for count in range(4):
        few = replace(part, points_camera=part.points_camera[:count], radii_m=part.radii_m[:count])
        assert "four are needed" in reason_of(registered(few, votes))
    line = np.linspace(0.0, 0.3, 500)[:, None] * np.ones(3) + 1.0
    assert "one line" in reason_of(registered(replace(part, points_camera=line.astype(np.float32)), votes))
    nowhere = replace(part, points_camera=np.full((500, 3), np.nan, np.float32))
    assert "four are needed" in reason_of(registered(nowhere, votes))


def test_radii_that_fit_no_triangle_have_a_reason_or_show_in_the_inliers() -> None:
    for seed in range(5):
        part = box_part(seed)
        rng = np.random.default_rng(seed)
        nonsense = replace(part, radii_m=rng.uniform(0.0, 2.0, part.radii_m.shape).astype(np.float32))
        result = registered(nonsense)
        assert not isinstance(result, Registration) or result.residual_m > 0.005
        for radii in (np.full_like(part.radii_m, np.nan), np.zeros_like(part.radii_m)):
            assert "no combination of keypoint modes" in reason_of(registered(replace(part, radii_m=radii)))


def test_a_scale_outside_the_range_has_a_reason() -> None:
    part = box_part(1)
    reason = registered(part, scale_range_m=(2.0 * part.scale_m, 3.0 * part.scale_m))
    assert isinstance(reason, str)
    assert "scale" in reason


def test_parts_registered_together_get_the_poses_they_get_alone() -> None:
    parts = [box_part(1, sigma_m=0.004, outliers=0.1), lid(2, sigma_m=0.004), box_part(3, sigma_m=0.008)]
    parts.append(symmetric_lid(4, sigma_m=0.003, outliers=0.1))
    given = [observed(part) for part in parts[:3]]
    given.append(replace(given[0], radii_m=np.full_like(parts[0].radii_m, np.nan)))
    given.append(replace(given[1], points_camera=parts[1].points_camera[:30], radii_m=parts[1].radii_m[:30]))
    for together, one in zip(register_parts(given), given, strict=True):
        alone = register_part(one)
        assert type(together) is type(alone)
        if isinstance(together, Registration) and isinstance(alone, Registration):
            np.testing.assert_allclose(together.T_camera_part, alone.T_camera_part, atol=1e-9)
            assert together.scale_m == pytest.approx(alone.scale_m, abs=1e-9)
            assert together.runner_up_ratio == pytest.approx(alone.runner_up_ratio, abs=1e-9)
        else:
            assert together == alone
    assert register_parts([]) == []
    with pytest.raises(ValueError, match="as many keypoints of each"):
        register_parts([given[0], observed(parts[3])])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points_camera": np.zeros((500, 2))}, "points_camera: expected"),
        ({"radii_m": np.zeros((500, 3))}, r"radii_m: expected \(500, 8\)"),
        ({"keypoints_unit": np.zeros((2, 3))}, "keypoints_unit: expected"),
        ({"keypoints_unit": np.outer(np.arange(8.0), np.ones(3))}, "keypoints_unit: .*collinear"),
        ({"extents_unit": np.ones(2)}, "extents_unit: expected"),
        ({"scale_range_m": (0.5, 0.2)}, "scale_range_m: expected"),
        ({"side_logits": np.zeros((500, 8))}, r"side_logits: expected \(500, 3\)"),
    ],
)
def test_wrong_shapes_are_named(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        registered(box_part(0), **changes)
