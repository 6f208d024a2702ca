"""What an estimate is: for every part a pose, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass

from page_runtime.category import Category, JointKind
from page_runtime.geometry import Array

NO_REGION = "not seen: nothing says where the object is in this frame; pass --region"


@dataclass(frozen=True, eq=False, slots=True)
class PartPose:
    """The 6D pose of one part and how much stands behind it.

    T_camera_part: (4,4), rotation and metres. extents_m: (3,) full size of the part's box: the size head's proportions
    at the fitted scale. keypoints_camera: (n,3). scores: (n_voted,) share of the voting points at each keypoint's
    highest peak (Eq. 17), which on a flat part may be the mirror image the registration rejected. confidence: [0,1],
    the probability that the pose is within 5 degrees and 5 cm where the bundle is calibrated (`confidence`), else
    inlier_share, the share of radii that agree with the pose. runner_up_ratio: support of the second distinct
    pose over this one's, 1 = as good. vote_gap: 0 certifies that the peaks are the dense accumulator's; else that many
    more votes may have been missed within the scorer's budget. num_points: points behind the pose. residual_m: robust
    standard deviation of the radius residuals. covariance: (6,6) of a small rotation [rad] about the part's origin
    and a translation [m], both in camera axes. disagreement: how far its joints' other parts were from what the joints
    allow, root mean square in standard deviations, the largest of its joints; 0 without any, infinite where the pose
    is a half turn of the part's own.
    """

    name: str
    T_camera_part: Array
    extents_m: Array
    keypoints_camera: Array
    scores: Array
    confidence: float
    inlier_share: float
    runner_up_ratio: float
    vote_gap: int
    num_points: int
    residual_m: float
    covariance: Array
    disagreement: float = 0.0


@dataclass(frozen=True, slots=True)
class NotSeen:
    """No pose for this part; `reason` is a sentence."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class JointState:
    """One joint of the object. value: rad of a revolute joint, m of a prismatic one, the angle between the parts [rad]
    of a free one; None if there is none and `reason` says why. sigma: its standard deviation, the same unit;
    zero_sigma: what of it is the same in every frame of an object, as a slide's zero lies elsewhere on each. limits:
    those of the category. disagreement: how far the parts' own poses were from what the joint and its limits allow, in
    standard deviations; None when a part is missing or nothing couples them."""

    name: str
    kind: JointKind
    value: float | None
    sigma: float | None
    limits: tuple[float, float]
    reason: str = ""
    disagreement: float | None = None
    zero_sigma: float = 0.0

    @property
    def unit(self) -> str:
        return "m" if self.kind == "prismatic" else "rad"


@dataclass(frozen=True, eq=False, slots=True)
class ArticulatedPose:
    """All parts and joints of one object in one frame, in the category's order; stage_ms: wall time by stage, of all
    looks together; looks: how many the estimate took (`estimator.estimate`), of which this is the likeliest answer."""

    parts: tuple[PartPose | NotSeen, ...]
    joints: tuple[JointState, ...]
    stage_ms: dict[str, float]
    looks: int = 1


def not_seen(category: Category, reason: str) -> ArticulatedPose:
    """The estimate of an object nothing was computed for: every part and joint with the same reason."""
    return ArticulatedPose(
        tuple(NotSeen(part.name, reason) for part in category.parts),
        tuple(JointState(joint.name, joint.kind, None, None, joint.limits, reason) for joint in category.joints),
        {},
    )
