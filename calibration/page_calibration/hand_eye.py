"""A camera on a robot: where it is on the hand, or where it stands before the robot.

Both are one equation. A_i is where the moving thing is, B_i where the camera sees a target that stands still to the
other end; X is what is wanted and A_i X B_i = Z is the same for all i:

    eye in hand   A = T_base_hand   X = T_hand_camera   B = T_camera_target   Z = T_base_target
    eye to hand   A = T_hand_base   X = T_base_camera   B = T_camera_target   Z = T_hand_target

Start: Park and Martin, Robot Sensor Calibration, 1994. Then all of X and Z by least squares on what disagrees, turns
and shifts each weighed by their own spread, which is estimated from the disagreement itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from page_calibration.calibration import CalibrationError
from page_calibration.rotation_vectors import rotation_of, vector_of
from page_runtime.geometry import Array, invert, rotation_angle, transform_from

Mount = Literal["eye-in-hand", "eye-to-hand"]
MIN_ROTATIONS = 3
SAME_ROTATION_DEG = 3.0
# Two axes of rotation nearer to parallel than this leave the shift along them open.
MIN_AXES_DEG = 10.0
REWEIGHTINGS = 5


@dataclass(frozen=True, eq=False, slots=True)
class HandEye:
    """X (4,4): T_hand_camera of eye in hand, T_base_camera of eye to hand. Z (4,4): where the target is. start: X
    before the refinement. scatter_m, scatter_rad: (n,) how far each pose puts the target from where all put it.
    deviations: (6,) of X, rad and metres, in the camera's axes."""

    mount: Mount
    X: Array
    Z: Array
    start: Array
    scatter_m: Array
    scatter_rad: Array
    deviations: Array

    @property
    def scatter_rms_m(self) -> float:
        """Rms of the target's scatter along one axis."""
        return float(np.sqrt((self.scatter_m**2).mean() / 3.0))


def solve_hand_eye(T_base_hand: Sequence[Array], T_camera_target: Sequence[Array], *, mount: Mount) -> HandEye:
    """The camera's place from poses of the robot and of the target at the same moments, in the same order.

    CalibrationError when the poses are too few, turn too little, or about one axis only.
    """
    if len(T_base_hand) != len(T_camera_target):
        raise CalibrationError(f"hand-eye: {len(T_base_hand)} poses of the robot, {len(T_camera_target)} of the target")
    A = np.array([T if mount == "eye-in-hand" else invert(T) for T in T_base_hand])
    B = np.array(T_camera_target)
    _require_turns(A)
    start = park_martin(A, B)
    X, Z, deviations = _refined(A, B, start)
    D = invert(Z) @ A @ X @ B
    angles = np.asarray(rotation_angle(D[:, :3, :3], np.broadcast_to(np.eye(3), D[:, :3, :3].shape)))
    return HandEye(mount, X, Z, start, np.linalg.norm(D[:, :3, 3], axis=1), angles, deviations)


def distinct_rotations(A: Sequence[Array] | Array) -> int:
    """How many of the poses turn the hand by more than SAME_ROTATION_DEG against all counted before."""
    kept: list[Array] = []
    for T in A:
        if all(np.degrees(float(rotation_angle(T[:3, :3], R))) > SAME_ROTATION_DEG for R in kept):
            kept.append(T[:3, :3])
    return len(kept)


def _require_turns(A: Array) -> None:
    distinct = distinct_rotations(A) if len(A) else 0
    if distinct < MIN_ROTATIONS:
        raise CalibrationError(
            f"hand-eye: {distinct} different rotations of the hand in {len(A)} poses, {MIN_ROTATIONS} are the least; "
            "turn the hand by 20 degrees or more between poses, about different axes: moving it without turning says "
            "nothing about where the camera is"
        )
    axes = np.array([
        axis / np.linalg.norm(axis)
        for i, j in combinations(range(len(A)), 2)
        if np.linalg.norm(axis := vector_of(A[i, :3, :3].T @ A[j, :3, :3])) > np.radians(SAME_ROTATION_DEG)
    ])  # fmt: skip
    apart = np.degrees(np.arccos(np.clip(np.abs(axes @ axes.T), 0.0, 1.0))).max()
    if apart < MIN_AXES_DEG:
        raise CalibrationError(
            f"hand-eye: all turns of the hand are about one axis (within {apart:.1f} degrees), which leaves the "
            "camera's place along it open; turn the hand about a second axis too"
        )


def park_martin(A: Array, B: Array) -> Array:
    """X of A_i X B_i = constant, (n,4,4) each: rotation by Park and Martin's closed form, then the shift."""
    turns, rows, right = np.zeros((3, 3)), [], []
    pairs = list(combinations(range(len(A)), 2))
    for i, j in pairs:
        motion_a, motion_b = invert(A[j]) @ A[i], B[j] @ invert(B[i])
        turns += np.outer(vector_of(motion_b[:3, :3]), vector_of(motion_a[:3, :3]))
    U, _, Vt = np.linalg.svd(turns)
    R = Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    for i, j in pairs:
        motion_a, motion_b = invert(A[j]) @ A[i], B[j] @ invert(B[i])
        rows.append(motion_a[:3, :3] - np.eye(3))
        right.append(R @ motion_b[:3, 3] - motion_a[:3, 3])
    t = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    return transform_from(R, t)


def _refined(A: Array, B: Array, start: Array) -> tuple[Array, Array, Array]:
    """(X, Z, deviations of X) that make Z^-1 A_i X B_i the identity, by weighted least squares."""
    try:
        from scipy.optimize import least_squares
    except ImportError as error:
        raise CalibrationError("hand-eye needs the extra: pip install 'page-edge[calibration]'") from error

    first = _mean(A @ start @ B)

    def placed(parameters: Array) -> tuple[Array, Array]:
        return start @ _exp(parameters[:6]), first @ _exp(parameters[6:])

    def disagreement(parameters: Array) -> Array:
        X, Z = placed(parameters)
        # In the camera, where the target's pose was measured: B_i against X^-1 A_i^-1 Z.
        D = invert(A @ X) @ Z @ invert(B)
        return np.concatenate([np.array([vector_of(one) for one in D[:, :3, :3]]), D[:, :3, 3]], axis=1)

    parameters = np.zeros(12)
    spread = np.ones(2)
    result = None
    for _ in range(REWEIGHTINGS):
        weights = np.repeat(1.0 / spread, 3)
        result = least_squares(lambda p, w=weights: (disagreement(p) * w).ravel(), parameters)
        parameters = result.x
        left = disagreement(parameters)
        spread = np.array([max(np.sqrt((left[:, k : k + 3] ** 2).mean()), 1e-12) for k in (0, 3)])
    assert result is not None
    X, Z = placed(parameters)
    freedom = max(6 * len(A) - 12, 1)
    covariance = np.linalg.pinv(result.jac.T @ result.jac) * (2.0 * result.cost / freedom)
    return X, Z, np.sqrt(np.diag(covariance)[:6])


def _exp(twist: Array) -> Array:
    """T (4,4) of a small turn (rad) and shift (m)."""
    return transform_from(rotation_of(twist[:3]), twist[3:])


def _mean(T: Array) -> Array:
    """The transform in the middle: chordal mean of rotations, mean of translations."""
    U, _, Vt = np.linalg.svd(T[:, :3, :3].mean(axis=0))
    return transform_from(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt, T[:, :3, 3].mean(axis=0))
