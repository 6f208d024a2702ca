"""Where a rigid part is, how it moves, and how sure that is: a constant-velocity filter on SE(3).

The state is a pose T_a_b with a rate (angular and linear velocity, axes of frame a). Errors are twelve numbers: a small
rotation about the part's origin [rad] and a translation [m], both in axes of a, as everywhere in this project, and
the errors of the rates. Between frames an unknown acceleration, white and constant over the step, acts (the discrete
white-noise acceleration model of Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 6.3.2); a measured pose updates the state as in an error-state Kalman filter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from page_runtime.geometry import Array, transform_from
from page_runtime.similarity import FloatArray, so3_exp, so3_log

# Of the acceleration that is not foreseen: what a hand does to an object it carries or slides.
ROTATION_ACCELERATION = 4.0
TRANSLATION_ACCELERATION = 0.8
# Before anything is known of a motion: turning [rad/s], moving [m/s].
START_RATES = (1.0, 0.3)
# The 99 % quantile of chi-square with six degrees of freedom: above it a motion is not the foreseen one.
SURPRISE = 16.8
_FREEDOM = 6.0
_MOST_FORGOTTEN = 1e4


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """T_a_part (4,4); rate (6,), rad/s and m/s in axes of a; covariance (12,12) of pose step and rate; time_s."""

    T_a_part: Array
    rate: FloatArray
    covariance: FloatArray
    time_s: float

    @property
    def pose_covariance(self) -> FloatArray:
        """(6,6) of the pose's step."""
        return self.covariance[:6, :6]


def started(T_a_part: Array, covariance: FloatArray, time_s: float) -> Motion:
    """A motion of which one pose is known, with its covariance (6,6)."""
    whole = np.zeros((12, 12))
    whole[:6, :6] = covariance
    whole[range(6, 12), range(6, 12)] = np.repeat(START_RATES, 3) ** 2
    return Motion(np.asarray(T_a_part, np.float64), np.zeros(6), whole, time_s)


def predicted(motion: Motion, time_s: float) -> Motion:
    """The motion at `time_s`, not before its own time (ValueError)."""
    step_s = time_s - motion.time_s
    if step_s < 0.0:
        raise ValueError(f"time_s: expected at least {motion.time_s}, the motion's own time, got {time_s}")
    turn = so3_exp(motion.rate[None, :3] * step_s)[0]
    R = turn @ motion.T_a_part[:3, :3]
    t = motion.T_a_part[:3, 3] + motion.rate[3:] * step_s
    transition = np.eye(12)
    transition[:3, :3] = turn
    transition[:6, 6:] = step_s * np.eye(6)
    covariance = transition @ motion.covariance @ transition.T + _unforeseen(step_s)
    return Motion(transform_from(R, t), motion.rate, covariance, time_s)


def _unforeseen(step_s: float) -> FloatArray:
    """(12,12) covariance of what an acceleration, constant over the step, adds to pose and rate."""
    variance = np.repeat([ROTATION_ACCELERATION, TRANSLATION_ACCELERATION], 3) ** 2
    noise = np.zeros((12, 12))
    noise[range(6), range(6)] = 0.25 * step_s**4 * variance
    noise[range(6), range(6, 12)] = noise[range(6, 12), range(6)] = 0.5 * step_s**3 * variance
    noise[range(6, 12), range(6, 12)] = step_s**2 * variance
    return noise


def step_between(T_a_from: Array, T_a_to: Array) -> FloatArray:
    """(6,) the step that leads from one pose to the other."""
    turn = so3_log((T_a_to[:3, :3] @ T_a_from[:3, :3].T)[None])[0]
    return np.concatenate([turn, T_a_to[:3, 3] - T_a_from[:3, 3]])


def surprise(motion: Motion, T_a_part: Array, covariance: FloatArray) -> float:
    """Squared deviation of a measured pose with its covariance (6,6) from the motion at the same time: for a motion as
    foreseen chi-square with six degrees of freedom."""
    step = step_between(motion.T_a_part, T_a_part)
    return float(step @ np.linalg.solve(motion.pose_covariance + covariance, step))


def measured(motion: Motion, T_a_part: Array, covariance: FloatArray) -> Motion:
    """The motion with a pose measured at its time. covariance: (6,6) of the measurement.

    A measurement that surprises says that the motion is not what was foreseen: what is known of it is then forgotten
    first (a fading memory), the more the larger the surprise, so that a sudden start or stop is followed at once.
    """
    excess = surprise(motion, T_a_part, covariance)
    if excess > SURPRISE:
        forgotten = min((excess / _FREEDOM) ** 2, _MOST_FORGOTTEN)
        motion = replace(motion, covariance=motion.covariance * forgotten)
    step = step_between(motion.T_a_part, T_a_part)
    spread = motion.pose_covariance + covariance
    gain = np.linalg.solve(spread, motion.covariance[:6]).T
    rest = np.eye(12)
    rest[:, :6] -= gain
    # Joseph's form stays symmetric and positive.
    updated = rest @ motion.covariance @ rest.T + gain @ covariance @ gain.T
    return _moved(motion, gain @ step, updated)


def settled(motion: Motion, T_a_part: Array, covariance: FloatArray) -> Motion:
    """The motion whose pose is now known to be this, covariance (6,6), by something that the motion was the prior of:
    its rate follows as far as pose and rate were correlated."""
    step = step_between(motion.T_a_part, T_a_part)
    gain = np.linalg.solve(motion.pose_covariance, motion.covariance[:6]).T
    updated = motion.covariance - gain @ (motion.pose_covariance - covariance) @ gain.T
    return _moved(motion, gain @ step, 0.5 * (updated + updated.T))


def _moved(motion: Motion, step: FloatArray, covariance: FloatArray) -> Motion:
    R = so3_exp(step[None, :3])[0] @ motion.T_a_part[:3, :3]
    t = motion.T_a_part[:3, 3] + step[3:6]
    # That errors are counted from the new pose now changes the covariance by second order in the step.
    return Motion(transform_from(R, t), motion.rate + step[6:], covariance, motion.time_s)
