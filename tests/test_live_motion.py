"""The filters of the live loop: what even motion, noise and surprises do to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.geometry import rotation_angle, transform_from
from page_runtime.live.figures import jitter
from page_runtime.live.joint_filter import JointMotion, joint_measured, joint_predicted
from page_runtime.live.motion import Motion, measured, predicted, settled, started, step_between, surprise
from page_runtime.pose import JointState
from page_runtime.similarity import so3_exp

PERIOD_S = 1 / 30
NOISE = np.repeat([0.02, 0.003], 3)


def pose_at(time_s: float, rate: np.ndarray) -> np.ndarray:
    """Even motion: a constant turn in fixed axes, a constant velocity."""
    return transform_from(so3_exp(rate[None, :3] * time_s)[0], np.array([0.1, 0.0, 0.8]) + rate[3:] * time_s)


def disturbed(T: np.ndarray, step: np.ndarray) -> np.ndarray:
    return transform_from(so3_exp(step[None, :3])[0] @ T[:3, :3], T[:3, 3] + step[3:])


def followed(poses: list[np.ndarray], covariance: np.ndarray) -> list[Motion]:
    motion = started(poses[0], covariance, 0.0)
    motions = [motion]
    for k, pose in enumerate(poses[1:], start=1):
        motion = measured(predicted(motion, k * PERIOD_S), pose, covariance)
        motions.append(motion)
    return motions


rates = st.lists(st.floats(-0.6, 0.6), min_size=6, max_size=6).map(np.array)


@settings(max_examples=25, deadline=None)
@given(rates)
def test_even_motion_without_noise_is_foreseen_exactly(rate: np.ndarray) -> None:
    poses = [pose_at(k * PERIOD_S, rate) for k in range(90)]
    last = followed(poses, 1e-8 * np.eye(6))[-1]
    np.testing.assert_allclose(last.rate, rate, atol=1e-3)
    ahead = predicted(last, 89 * PERIOD_S + 0.1)
    assert np.abs(step_between(ahead.T_a_part, pose_at(89 * PERIOD_S + 0.1, rate))).max() < 1e-3


@pytest.mark.parametrize("rate", [np.zeros(6), np.array([0.3, -0.2, 0.5, 0.1, -0.05, 0.02])])
def test_noise_is_reduced_and_its_frame_to_frame_part_at_least_halved(rate: np.ndarray) -> None:
    rng = np.random.default_rng(5)
    true = [pose_at(k * PERIOD_S, rate) for k in range(400)]
    noisy = [disturbed(T, rng.normal(0.0, NOISE)) for T in true]
    filtered = [motion.T_a_part for motion in followed(noisy, np.diag(NOISE**2))]
    own, better = (
        np.array([step_between(T, one) for T, one in zip(true[60:], some[60:], strict=True)])
        for some in (noisy, filtered)
    )
    assert (better.std(axis=0) < 0.8 * own.std(axis=0)).all()
    assert (np.diff(better, axis=0).std(axis=0) < 0.5 * np.diff(own, axis=0).std(axis=0)).all()


def test_the_covariance_says_how_far_off_the_filter_is() -> None:
    rng = np.random.default_rng(6)
    deviations = []
    for _ in range(60):
        noisy = [disturbed(pose_at(k * PERIOD_S, np.zeros(6)), rng.normal(0.0, NOISE)) for k in range(30)]
        last = followed(noisy, np.diag(NOISE**2))[-1]
        error = step_between(last.T_a_part, pose_at(0.0, np.zeros(6)))
        deviations.append(error @ np.linalg.solve(last.pose_covariance, error))
    # Six degrees of freedom; the filter allows for accelerations that are not there, so somewhat less.
    assert 1.5 < np.mean(deviations) < 7.0


def test_an_object_that_jumps_is_followed_at_once() -> None:
    poses = [pose_at(0.0, np.zeros(6))] * 30
    motion = followed(poses, np.diag(NOISE**2))[-1]
    there = disturbed(poses[0], np.array([0.6, 0.0, 0.0, 0.1, 0.0, 0.0]))
    now = predicted(motion, 30 * PERIOD_S)
    assert surprise(now, there, np.diag(NOISE**2)) > 100.0
    after = measured(now, there, np.diag(NOISE**2))
    assert rotation_angle(after.T_a_part[:3, :3], there[:3, :3]) < 0.06
    assert np.linalg.norm(after.T_a_part[:3, 3] - there[:3, 3]) < 0.01


def test_a_pose_settled_by_the_same_information_is_a_pose_measured() -> None:
    now = predicted(started(pose_at(0.0, np.zeros(6)), np.diag(NOISE**2), 0.0), PERIOD_S)
    T = disturbed(now.T_a_part, np.array([1e-3, -2e-3, 1e-3, 1e-4, 2e-4, -1e-4]))
    by_measuring = measured(now, T, np.diag(NOISE**2))
    by_settling = settled(now, by_measuring.T_a_part, by_measuring.pose_covariance)
    np.testing.assert_allclose(by_settling.T_a_part, by_measuring.T_a_part, atol=1e-12)
    np.testing.assert_allclose(by_settling.rate, by_measuring.rate, atol=1e-9)
    np.testing.assert_allclose(by_settling.covariance, by_measuring.covariance, rtol=1e-6, atol=1e-12)


def test_time_does_not_run_backwards() -> None:
    with pytest.raises(ValueError, match="expected at least 1"):
        predicted(started(np.eye(4), np.eye(6), 1.0), 0.5)
    with pytest.raises(ValueError, match="expected at least 1"):
        joint_predicted(JointMotion("revolute", np.zeros(2), np.eye(2), 1.0), 0.5)


def state(value: float | None, sigma: float | None = 0.02) -> JointState:
    return JointState("hinge", "revolute", value, None if value is None else sigma, (0.0, 3.0))


def test_where_a_slides_zero_lies_does_not_slow_what_follows_it() -> None:
    sure = replace(state(0.1, 0.002), kind="prismatic")
    unsure = replace(sure, sigma=float(np.hypot(0.002, 0.04)), zero_sigma=0.04)
    one: JointMotion | None = None
    other: JointMotion | None = None
    for k in range(10):
        one = joint_measured(one, replace(sure, value=0.1 + 0.004 * k), k * PERIOD_S)
        other = joint_measured(other, replace(unsure, value=0.1 + 0.004 * k), k * PERIOD_S)
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(other.mean, one.mean, rtol=1e-9)


def test_a_joint_that_moves_evenly_is_followed_with_its_rate_and_one_without_a_state_stays_as_it_was() -> None:
    rng = np.random.default_rng(7)
    joint, errors, own = None, [], []
    for k in range(300):
        true, noise = 0.5 + 0.7 * k * PERIOD_S, float(rng.normal(0.0, 0.02))
        joint = joint_measured(joint, state(true + noise), k * PERIOD_S)
        assert joint is not None
        errors.append(joint.mean[0] - true)
        own.append(noise)
    assert joint is not None
    assert abs(joint.mean[1] - 0.7) < 0.2
    assert np.diff(errors[60:]).std() < 0.5 * np.diff(own[60:]).std()
    assert joint_measured(joint, state(None), 301 * PERIOD_S) is joint
    assert joint_measured(None, state(None), 0.0) is None


def test_jitter_is_the_noise_of_even_motion_and_frames_in_between_end_a_run() -> None:
    rng = np.random.default_rng(8)
    rate = np.array([0.0, 0.0, 0.4, 0.1, 0.0, 0.0])
    poses = [(k, disturbed(pose_at(k * PERIOD_S, rate), rng.normal(0.0, 0.001, 6))) for k in range(4000)]
    figures = jitter(poses)
    assert figures is not None
    # Of three axes together.
    assert abs(figures["translation_mm"] - np.sqrt(3.0)) < 0.1
    assert abs(figures["rotation_deg"] - np.degrees(0.001 * np.sqrt(3.0))) < 0.01
    even = jitter([(k, pose_at(k * PERIOD_S, rate)) for k in range(20)])
    assert even is not None
    assert even["translation_mm"] < 1e-3
    assert jitter([(2 * k, pose) for k, (_, pose) in enumerate(poses)]) is None
