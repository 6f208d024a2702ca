"""One object followed over time: what is known of it, and what the next frame adds to that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.articulation import PartEvidence
from page_runtime.camera import Camera
from page_runtime.category import Category, Part
from page_runtime.geometry import Array, apply, invert, transform_from
from page_runtime.live import motion as motions
from page_runtime.live.joint_filter import JointMotion, joint_measured
from page_runtime.live.motion import Motion
from page_runtime.live.near import Fitted
from page_runtime.live.prior import PartPrior, Prior, Surface
from page_runtime.pose import ArticulatedPose, JointState, NotSeen, PartPose
from page_runtime.similarity import FloatArray

# An object has one size: an estimate of it counts as one of at most so many.
_MOST_SIZES = 60
_SCALE_SIGMA = 0.01
# On the covariance of a measured pose: of 4 and 9, and of two accelerations, 9 with these halves the jitter on moving
# boxes and laptops without poses that lag.
_MEASURED_INFLATION = 9.0
# Beyond this from where it was foreseen a part is not fitted to depth alone: rad, and its diagonals.
_FAR_RAD = 0.25
_FAR_SHARE = 0.1
# A part that was not seen for so long is forgotten.
_FORGOTTEN_S = 1.0


@dataclass(frozen=True, eq=False, slots=True)
class TrackedPart:
    """motion: in the world (`Camera.T_camera_world`; the camera's frame where that is the identity). extents_m: (3,)
    mean of num_sizes estimates. last: the pose as the network last saw it, and the surface it was made of."""

    motion: Motion
    extents_m: Array
    num_sizes: int
    last: PartPose
    surface: Surface
    seen_s: float


@dataclass(frozen=True, eq=False, slots=True)
class Observation:
    """What the network made of a frame. surfaces: of each part, None without a pose; background_camera: (m,3) m, points
    that are of no part."""

    pose: ArticulatedPose
    surfaces: Sequence[Surface | None]
    background_camera: NDArray[np.float32]


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """One object. number: its own, never given twice. parts, joints: in the category's order. background_world: (m,3)
    m. time_s: of its last frame. fits: frames by depth alone since the network's last. checked_s: when a full search
    last agreed. missed: frames in a row without it. doubts: full searches in a row that found it otherwise. steady:
    whether most of its parts moved as foreseen when the network last saw it."""

    number: int
    parts: tuple[TrackedPart | None, ...]
    joints: tuple[JointMotion | None, ...]
    background_world: NDArray[np.float32]
    time_s: float
    checked_s: float
    fits: int = 0
    missed: int = 0
    doubts: int = 0
    steady: bool = True


def begun(number: int, category: Category, observed: Observation, camera: Camera, time_s: float) -> Track:
    """The track of an object that a full search found."""
    nothing = Track(
        number,
        (None,) * len(category.parts),
        (None,) * len(category.joints),
        np.empty((0, 3), np.float32),
        time_s,
        checked_s=time_s,
    )
    return with_observation(nothing, observed, camera, time_s)


def prior_of(track: Track, camera: Camera, time_s: float) -> Prior:
    """The object as it is expected at `time_s`."""
    T_camera_world = camera.T_camera_world
    parts = tuple(None if part is None else _prior(part, T_camera_world, time_s) for part in track.parts)
    return Prior(parts, apply(T_camera_world, track.background_world).astype(np.float32))


def with_observation(track: Track, observed: Observation, camera: Camera, time_s: float) -> Track:
    """The track after the network saw the object."""
    T_world_camera = invert(camera.T_camera_world)
    parts = tuple(
        _observed(before, part, surface, T_world_camera, time_s)
        for before, part, surface in zip(track.parts, observed.pose.parts, observed.surfaces, strict=True)
    )
    strayed = [
        _strayed(before, part, T_world_camera, time_s)
        for before, part in zip(track.parts, observed.pose.parts, strict=True)
        if isinstance(part, PartPose)
    ]
    return replace(
        track,
        parts=parts,
        # One part of many that was seen wrong is held by the others.
        steady=2 * sum(strayed) < max(len(strayed), 1),
        joints=_joints(track, observed.pose.joints, time_s),
        background_world=apply(T_world_camera, observed.background_camera).astype(np.float32),
        time_s=time_s,
        fits=0,
        missed=0,
    )


def with_fit(track: Track, fitted: Fitted, camera: Camera, time_s: float) -> Track:
    """The track after its parts were fitted to depth, with this track's prior at that time."""
    T_world_camera = invert(camera.T_camera_world)
    parts = tuple(
        part if part is None or one is None else _settled(part, one, T_world_camera, time_s)
        for part, one in zip(track.parts, fitted.evidence, strict=True)
    )
    joints = _joints(track, fitted.pose.joints, time_s)
    return replace(track, parts=parts, joints=joints, time_s=time_s, fits=track.fits + 1, missed=0)


def filtered_pose(track: Track, category: Category, pose: ArticulatedPose, camera: Camera) -> ArticulatedPose:
    """`pose`, of the track's last frame, with the filtered poses, sizes and joint states in place of its own."""
    parts = tuple(
        own if isinstance(own, NotSeen) or part is None else _reported(own, part, spec, camera.T_camera_world)
        for own, part, spec in zip(pose.parts, track.parts, category.parts, strict=True)
    )
    joints = tuple(
        state
        if joint is None or state.value is None
        else replace(state, value=float(joint.mean[0]), sigma=float(np.sqrt(joint.covariance[0, 0])))
        for state, joint in zip(pose.joints, track.joints, strict=True)
    )
    return replace(pose, parts=parts, joints=joints)


def joint_rates(track: Track) -> tuple[float | None, ...]:
    """Of every joint, rad/s or m/s; None for one without a state."""
    return tuple(None if joint is None else float(joint.mean[1]) for joint in track.joints)


def _prior(part: TrackedPart, T_camera_world: Array, time_s: float) -> PartPrior:
    now = motions.predicted(part.motion, max(time_s, part.motion.time_s))
    covariance = np.diag(np.repeat([0.0, _SCALE_SIGMA**2], [6, 1]))
    covariance[:6, :6] = _turned(now.pose_covariance, T_camera_world[:3, :3])
    scale_m = float(np.linalg.norm(part.extents_m))
    evidence = PartEvidence(
        T_camera_world @ now.T_a_part, scale_m, covariance, np.asarray(part.extents_m / scale_m, np.float64)
    )
    return PartPrior(evidence, part.last, part.surface)


def _observed(
    before: TrackedPart | None,
    part: PartPose | NotSeen,
    surface: Surface | None,
    T_world_camera: Array,
    time_s: float,
) -> TrackedPart | None:
    if isinstance(part, NotSeen) or surface is None:
        return None if before is None or time_s - before.seen_s > _FORGOTTEN_S else before
    T_world_part = T_world_camera @ part.T_camera_part
    covariance = _MEASURED_INFLATION * _turned(part.covariance, T_world_camera[:3, :3])
    if before is None:
        return TrackedPart(motions.started(T_world_part, covariance, time_s), part.extents_m, 1, part, surface, time_s)
    now = motions.predicted(before.motion, max(time_s, before.motion.time_s))
    count = min(before.num_sizes + 1, _MOST_SIZES)
    extents_m = before.extents_m + (part.extents_m - before.extents_m) / count
    return TrackedPart(motions.measured(now, T_world_part, covariance), extents_m, count, part, surface, time_s)


def _strayed(before: TrackedPart | None, part: PartPose, T_world_camera: Array, time_s: float) -> bool:
    """Whether a part is so far from where it was foreseen that depth alone would not have found it."""
    if before is None:
        return False
    now = motions.predicted(before.motion, max(time_s, before.motion.time_s))
    step = motions.step_between(now.T_a_part, T_world_camera @ part.T_camera_part)
    far_m = _FAR_SHARE * float(np.linalg.norm(before.extents_m))
    return bool(np.linalg.norm(step[:3]) > _FAR_RAD or np.linalg.norm(step[3:]) > far_m)


def _settled(part: TrackedPart, evidence: PartEvidence, T_world_camera: Array, time_s: float) -> TrackedPart:
    now = motions.predicted(part.motion, max(time_s, part.motion.time_s))
    covariance = _turned(evidence.covariance[:6, :6], T_world_camera[:3, :3])
    T_world_part = T_world_camera @ evidence.T_camera_part
    return replace(part, motion=motions.settled(now, T_world_part, covariance), seen_s=time_s)


def _joints(track: Track, states: Sequence[JointState], time_s: float) -> tuple[JointMotion | None, ...]:
    return tuple(
        joint_measured(before, state, max(time_s, before.time_s) if before is not None else time_s)
        for before, state in zip(track.joints, states, strict=True)
    )


def _reported(own: PartPose, part: TrackedPart, spec: Part, T_camera_world: Array) -> PartPose:
    T_camera_part = T_camera_world @ part.motion.T_a_part
    scale_m = float(np.linalg.norm(part.extents_m))
    return replace(
        own,
        T_camera_part=transform_from(T_camera_part[:3, :3], T_camera_part[:3, 3]),
        extents_m=part.extents_m,
        keypoints_camera=apply(T_camera_part, scale_m * spec.keypoints_unit),
        covariance=_turned(part.motion.pose_covariance, T_camera_world[:3, :3]),
    )


def _turned(covariance: Array, R_a_b: Array) -> FloatArray:
    """(6,6) of a step in axes of b, in axes of a."""
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = R_a_b
    return turn @ covariance @ turn.T
