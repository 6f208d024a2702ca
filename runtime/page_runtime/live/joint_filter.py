"""The states of an object's joints over time, each by itself: a constant-velocity Kalman filter in one dimension.

Two parts' errors have much in common that their joint's state does not see, and a hinge may rest while its object is
carried about: so a state is filtered by itself, not read off the filtered poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_runtime.category import JointKind
from page_runtime.pose import JointState
from page_runtime.similarity import FloatArray

# Of the acceleration that is not foreseen, rad/s^2 or m/s^2.
ACCELERATION = {"revolute": 4.0, "prismatic": 0.8, "free": 4.0}
START_RATE = {"revolute": 1.0, "prismatic": 0.3, "free": 1.0}
_SURPRISE = 6.6
_MOST_SURPRISE = 100.0


@dataclass(frozen=True, eq=False, slots=True)
class JointMotion:
    """mean: (2,) state and rate; covariance (2,2); rad or m, and the same a second."""

    kind: JointKind
    mean: FloatArray
    covariance: FloatArray
    time_s: float


def joint_measured(before: JointMotion | None, state: JointState, time_s: float) -> JointMotion | None:
    """The joint with one more measured state, which is not before its last one; as it was where there is none."""
    if state.value is None or state.sigma is None:
        return before
    # Where a slide's zero lies is the same error in every frame: no measurement is the worse for it beside the others.
    variance = state.sigma**2 - state.zero_sigma**2
    if before is None:
        covariance = np.diag([variance, START_RATE[state.kind] ** 2])
        return JointMotion(state.kind, np.array([state.value, 0.0]), covariance, time_s)
    now = joint_predicted(before, time_s)
    off, spread = state.value - now.mean[0], now.covariance[0, 0] + variance
    forgotten = float(np.clip(off * off / spread / _SURPRISE, 1.0, _MOST_SURPRISE))
    prior = now.covariance * forgotten
    gain = prior[:, 0] / (prior[0, 0] + variance)
    return JointMotion(state.kind, now.mean + gain * off, prior - np.outer(gain, prior[0]), time_s)


def joint_predicted(joint: JointMotion, time_s: float) -> JointMotion:
    """The joint at `time_s`, moving on as it did."""
    step_s = time_s - joint.time_s
    if step_s < 0.0:
        raise ValueError(f"time_s: expected at least {joint.time_s}, the joint's own time, got {time_s}")
    transition = np.array([[1.0, step_s], [0.0, 1.0]])
    push = np.array([0.5 * step_s**2, step_s]) * ACCELERATION[joint.kind]
    covariance = transition @ joint.covariance @ transition.T + np.outer(push, push)
    return JointMotion(joint.kind, transition @ joint.mean, covariance, time_s)
