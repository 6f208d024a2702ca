"""What an estimate is: for every part a pose, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass

from page_runtime.geometry import Array


@dataclass(frozen=True, eq=False, slots=True)
class PartPose:
    """The 6D pose of one part and how much stands behind it.

    T_camera_part: (4,4), rotation and metres. extents_m: (3,) full size of the part's box. keypoints_camera: (n,3).
    scores: (n_voted,) share of the part's points that voted for the chosen keypoint (Eq. 17). confidence: [0,1], not
    yet calibrated: the share of radii that agree with the pose. num_points: points behind it. residual_m: robust
    standard deviation of the radius residuals. covariance: (6,6) of a small rotation [rad] about the part's origin
    and a translation [m], both in camera axes.
    """

    name: str
    T_camera_part: Array
    extents_m: Array
    keypoints_camera: Array
    scores: Array
    confidence: float
    num_points: int
    residual_m: float
    covariance: Array


@dataclass(frozen=True, slots=True)
class NotSeen:
    """No pose for this part; `reason` is a sentence."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False, slots=True)
class ArticulatedPose:
    """All parts of one object in one frame, in the category's order; stage_ms: wall time by stage."""

    parts: tuple[PartPose | NotSeen, ...]
    stage_ms: dict[str, float]
