"""Laws of the refinement by a template: it moves a pose only where that helps, and else says why not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from page_runtime.geometry import apply, rotation_angle, transform_from
from page_runtime.icp import IcpResult, refine_to_template
from page_runtime.similarity import so3_exp
from page_runtime.template import Template
from synthetic_parts import SyntheticPart, box_extents_m, box_template, keypoints_around, random_rotation, seen_part

NEAR = (0.0012, np.radians(0.3), 0.005)
FAR = (0.005, np.radians(1.2), 0.02)


def seen_box(seed: int, depth_noise_m: float = 0.001) -> SyntheticPart:
    rng = np.random.default_rng(seed)
    extents_m = box_extents_m(rng)
    return seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), depth_noise_m=depth_noise_m)


def seen_plate(seed: int) -> SyntheticPart:
    rng = np.random.default_rng(seed)
    extents_m = np.array([rng.uniform(0.2, 0.4), rng.uniform(0.15, 0.3), 0.006])
    return seen_part(rng, extents_m, keypoints_around(rng, extents_m, 3), depth_noise_m=0.001)


def prior(deviations: tuple[float, float, float]) -> np.ndarray:
    """(7,7) of independent deviations: translation m, rotation rad, log scale."""
    translation_m, rotation_rad, log_scale = deviations
    return np.diag(np.repeat([rotation_rad, translation_m, log_scale], [3, 3, 1]) ** 2)


def perturbed(part: SyntheticPart, seed: int, covariance: np.ndarray) -> tuple[np.ndarray, float]:
    """A pose and scale whose error is drawn from the covariance."""
    step = np.random.default_rng(1000 + seed).multivariate_normal(np.zeros(7), covariance)
    R = so3_exp(step[None, :3])[0] @ part.R
    return transform_from(R, part.t + step[3:6]), part.scale_m * float(np.exp(step[6]))


def refined(part: SyntheticPart, seed: int, deviations: tuple[float, float, float], template: Template) -> IcpResult:
    covariance = prior(deviations)
    return refine_to_template(part.points_camera, *perturbed(part, seed, covariance), covariance, template)


def average_distance(part: SyntheticPart, T_camera_part: np.ndarray) -> float:
    """Mean distance between the true part's surface and the same surface at an estimate, m."""
    own = box_template(part.extents_unit, side=4).points_unit * part.scale_m
    return float(np.linalg.norm(own @ part.R.T + part.t - apply(T_camera_part, own), axis=1).mean())


def medians(
    parts: list[SyntheticPart], deviations: tuple[float, float, float], off: float = 0.0
) -> tuple[float, float, list[IcpResult]]:
    """Median distance before and after; off: share by which the template's axes are wrong, to and fro."""
    before, after, results = [], [], []
    for seed, part in enumerate(parts):
        factors = 1.0 + off * np.random.default_rng(seed).permutation([-1.0, 1.0, 1.0 if seed % 2 else -1.0])
        right = box_template(part.extents_unit)
        template = Template(right.points_unit * factors, right.normals_unit, right.extents_unit * factors)
        result = refined(part, seed, deviations, template)
        before.append(average_distance(part, perturbed(part, seed, prior(deviations))[0]))
        after.append(average_distance(part, result.T_camera_part))
        results.append(result)
    return float(np.median(before)), float(np.median(after)), results


def test_the_right_template_gives_the_exact_place_across_every_face_that_is_seen() -> None:
    for seed in range(20):
        part = seen_box(seed, depth_noise_m=0.0)
        start, _ = perturbed(part, seed, prior(NEAR))
        wide = prior((0.3, np.radians(30.0), 1e-4))[:6, :6]
        result = refine_to_template(part.points_camera, start, part.scale_m, wide, box_template(part.extents_unit))
        assert result.accepted, result.reason
        assert result.scale_m == pytest.approx(part.scale_m, rel=1e-6)
        seen = np.count_nonzero(np.abs(part.normals_camera @ part.R) > 0.9, axis=0) >= 50
        across_m = (result.T_camera_part[:3, 3] - part.t) @ part.R
        assert np.abs(across_m[seen]).max() < 2e-4
        if np.count_nonzero(seen) > 1:
            assert np.degrees(rotation_angle(result.T_camera_part[:3, :3], part.R)) < 0.05


@pytest.mark.parametrize("seen", [seen_box, seen_plate])
def test_the_right_template_helps(seen) -> None:
    parts = [seen(seed) for seed in range(30)]
    before, after, results = medians(parts, NEAR)
    assert after < 0.9 * before
    assert np.mean([result.accepted for result in results]) > 0.9
    before, after, _ = medians(parts, FAR)
    assert after < 0.6 * before


@pytest.mark.parametrize("seen", [seen_box, seen_plate])
@pytest.mark.parametrize("deviations", [NEAR, FAR])
def test_a_template_five_percent_off_makes_poses_no_worse(seen, deviations: tuple[float, float, float]) -> None:
    before, after, _ = medians([seen(seed) for seed in range(30)], deviations, off=0.05)
    assert after <= 1.05 * before


def test_stretched_to_the_true_proportions_a_wrong_template_is_the_right_one() -> None:
    part = seen_box(4)
    right = box_template(part.extents_unit)
    covariance = prior(FAR)
    start = perturbed(part, 4, covariance)
    direct = refine_to_template(part.points_camera, *start, covariance, right)
    wrong = right.stretched(np.array([0.5, 0.6, 0.4]))
    other = refine_to_template(part.points_camera, *start, covariance, wrong, extents_unit=7.0 * part.extents_unit)
    np.testing.assert_allclose(other.T_camera_part, direct.T_camera_part, atol=1e-5)


def test_what_is_accepted_fits_better_and_what_is_not_is_what_went_in() -> None:
    rng = np.random.default_rng(0)
    outcomes = set()
    for seed in range(60):
        part = seen_box(seed)
        template = box_template(part.extents_unit * rng.uniform(0.7, 1.4, 3))
        deviations = FAR if seed % 2 else NEAR
        start, scale_m = perturbed(part, seed, prior(deviations) * rng.choice([0.0, 1.0, 25.0]))
        result = refine_to_template(part.points_camera, start, scale_m, prior(deviations), template)
        outcomes.add(result.accepted)
        if result.accepted:
            assert result.residual_after_m < result.residual_before_m
            assert result.reason == ""
        else:
            np.testing.assert_array_equal(result.T_camera_part, start)
            np.testing.assert_array_equal(result.covariance, prior(deviations))
            assert result.scale_m == scale_m
            assert result.reason
    assert outcomes == {True, False}


def test_turning_the_camera_turns_the_pose() -> None:
    rng = np.random.default_rng(5)
    for seed in range(6):
        part = seen_box(seed)
        template = box_template(part.extents_unit)
        wide = rng.normal(size=(7, 7)) * 0.3 + np.eye(7)
        deviations = np.sqrt(np.diag(prior(FAR)))
        covariance = wide @ wide.T * np.outer(deviations, deviations)
        start, scale_m = perturbed(part, seed, prior(FAR))
        result = refine_to_template(part.points_camera, start, scale_m, covariance, template)
        turn = random_rotation(rng)
        both = np.eye(7)
        both[:3, :3] = both[3:6, 3:6] = turn
        moved = refine_to_template(
            part.points_camera @ turn.T,
            transform_from(turn, np.zeros(3)) @ start,
            scale_m,
            both @ covariance @ both.T,
            template,
        )
        assert moved.accepted == result.accepted
        expected = transform_from(turn, np.zeros(3)) @ result.T_camera_part
        np.testing.assert_allclose(moved.T_camera_part, expected, atol=1e-4)
        np.testing.assert_allclose(moved.covariance, both @ result.covariance @ both.T, atol=1e-6)


def test_the_middle_of_a_plate_does_not_say_where_it_is_in_its_plane() -> None:
    for seed in range(8):
        part = seen_plate(seed)
        own = (part.points_camera - part.t) @ part.R
        middle = (np.abs(own[:, :2]) < 0.3 * part.extents_unit[:2] * part.scale_m).all(axis=1)
        face = np.abs(part.normals_camera @ part.R[:, 2]) > 0.9
        inner = replace(part, points_camera=part.points_camera[middle & face])
        result = refined(inner, seed, FAR, box_template(part.extents_unit))
        start, _ = perturbed(inner, seed, prior(FAR))
        slid = (result.T_camera_part[:3, 3] - start[:3, 3]) @ part.R[:, :2]
        assert np.linalg.norm(slid) < 0.001


def test_a_part_is_drawn_back_under_the_points_beyond_its_rim() -> None:
    part = seen_plate(1)
    start = transform_from(part.R, part.t + 0.02 * part.R[:, 0])
    wide = prior((0.03, np.radians(1.0), 0.001))
    result = refine_to_template(part.points_camera, start, part.scale_m, wide, box_template(part.extents_unit))
    assert result.accepted, result.reason
    assert abs((result.T_camera_part[:3, 3] - part.t) @ part.R[:, 0]) < 0.01


def test_the_covariance_only_shrinks() -> None:
    part = seen_box(2)
    result = refined(part, 2, FAR, box_template(part.extents_unit))
    assert result.accepted
    unit = np.sqrt(np.outer(np.diag(prior(FAR)), np.diag(prior(FAR))))
    gained = np.linalg.eigvalsh((prior(FAR) - result.covariance) / unit)
    assert gained.min() > -1e-9
    assert gained.max() > 0.5


def test_a_template_of_another_shape_is_refused() -> None:
    rng = np.random.default_rng(0)
    part = seen_box(3)
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ball = Template(directions * 0.29, directions, np.full(3, 0.58))
    result = refined(part, 3, FAR, ball)
    assert not result.accepted
    assert "another shape" in result.reason


def test_too_few_points_no_template_and_no_covariance_have_a_reason() -> None:
    part = seen_box(0)
    template, covariance = box_template(part.extents_unit), prior(FAR)
    pose = transform_from(part.R, part.t), part.scale_m
    empty = Template(np.empty((0, 3)), np.empty((0, 3)), np.ones(3))
    away = Template(template.points_unit, -template.normals_unit, template.extents_unit)
    inside = transform_from(part.R, np.zeros(3)), part.scale_m
    points = part.points_camera
    for reason, result in (
        *(("finite points", refine_to_template(points[:n], *pose, covariance, template)) for n in range(4)),
        ("finite points", refine_to_template(np.full((400, 3), np.nan), *pose, covariance, template)),
        ("faces the camera", refine_to_template(points, *pose, covariance, empty)),
        ("near a side", refine_to_template(points + 5.0, *pose, covariance, template)),
        ("near a side", refine_to_template(np.zeros((400, 3)), *inside, covariance, template)),
        ("positive definite", refine_to_template(points, *pose, np.zeros((7, 7)), template)),
        ("positive definite", refine_to_template(points, *pose, np.full((7, 7), np.nan), template)),
    ):
        assert not result.accepted
        assert reason in result.reason
        np.testing.assert_array_equal(result.T_camera_part, pose[0] if result.T_camera_part[2, 3] else inside[0])
    assert isinstance(refine_to_template(points, *pose, covariance, away), IcpResult)


def test_points_that_are_not_finite_do_not_count() -> None:
    part = seen_box(6)
    template, covariance = box_template(part.extents_unit), prior(FAR)
    start = perturbed(part, 6, covariance)
    spoilt = np.concatenate((part.points_camera[:300], np.full((50, 3), np.nan), np.full((50, 3), np.inf)))
    clean = refine_to_template(part.points_camera[:300], *start, covariance, template)
    result = refine_to_template(spoilt, *start, covariance, template)
    np.testing.assert_array_equal(result.T_camera_part, clean.T_camera_part)


def test_points_of_something_else_hardly_matter() -> None:
    part = seen_box(8)
    covariance, template = prior(FAR), box_template(part.extents_unit)
    start = perturbed(part, 8, covariance)
    rng = np.random.default_rng(0)
    others = part.t + rng.uniform(-0.4, 0.4, (60, 3))
    mixed = np.concatenate((part.points_camera[:340], others))[rng.permutation(400)]
    result = refine_to_template(mixed, *start, covariance, template)
    assert result.accepted, result.reason
    assert average_distance(part, result.T_camera_part) < 0.8 * average_distance(part, start[0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points_camera": np.zeros((5, 2))}, "points_camera: expected"),
        ({"covariance": np.eye(3)}, "covariance: expected"),
        ({"scale_m": 0.0}, "scale_m: expected"),
        ({"scale_m": float("nan")}, "scale_m: expected"),
        ({"sensor_sigma_m": 0.0}, "sensor_sigma_m: expected"),
        ({"extents_unit": np.zeros(3)}, "extents_unit: expected"),
        ({"T_camera_part": 2.0 * np.eye(4)}, "T_camera_part: expected"),
    ],
)
def test_wrong_arguments_are_named(changes: dict, message: str) -> None:
    part = seen_box(0)
    arguments = {
        "points_camera": part.points_camera,
        "T_camera_part": transform_from(part.R, part.t),
        "scale_m": part.scale_m,
        "covariance": prior(NEAR),
        "template": box_template(part.extents_unit),
        **changes,
    }
    with pytest.raises(ValueError, match=message):
        refine_to_template(**arguments)
