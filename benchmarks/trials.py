"""A trial: synthetic parts scored and registered by `page_runtime`, or posed the paper's way, and the errors."""

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from benchmarks.figures import figure, median
from benchmarks.synthetic import NUM_VOTED, SHAPES, Noise, suite
from numpy.typing import NDArray
from tests.synthetic_parts import SyntheticPart

from page_runtime.geometry import rotation_angle, transform_from
from page_runtime.registration import Ambiguous, Observed, Registration, register_part
from page_runtime.scoring import ONE_SIDED, TWO_SIDED, KeypointVotes, VoteRule, score_keypoints
from page_runtime.similarity import umeyama

FloatArray = NDArray[np.float64]

RuleName = Literal["two-sided", "one-sided"]

# Eq. 16 and the paper's Algorithm 1, by the names of the dense accumulator.
RULES: dict[RuleName, VoteRule] = {"two-sided": TWO_SIDED, "one-sided": ONE_SIDED}
SCALE_RANGE_M = (0.15, 1.1)
# A voxel farther from the truth belongs to another mode: medians of keypoint errors are over the others.
WRONG_PEAK_M = 0.06


@dataclass(frozen=True, slots=True)
class Setting:
    """Parts of a suite and how they are scored. num_points: of one part; voxel_m: rho."""

    distance: str = "mid"
    voxel_m: float = 0.005
    num_points: int = 512
    noise: Noise = field(default_factory=Noise)
    shapes: tuple[str, ...] = SHAPES
    parts: int = 16
    repeats: int = 3
    seed: int = 0

    def suite(self) -> list[SyntheticPart]:
        return suite(self.parts, self.distance, self.num_points, self.noise, seed=self.seed, shapes=self.shapes)


def score(part: SyntheticPart, voxel_m: float, **options: Any) -> tuple[KeypointVotes, ...]:
    return score_keypoints(part.points_camera, part.radii_m[:, :NUM_VOTED], voxel_m=voxel_m, **options)


def register(part: SyntheticPart, votes: tuple[KeypointVotes, ...], **options: Any) -> Registration | Ambiguous | str:
    """Pose by `page_runtime`; options as in `observed`."""
    return register_part(observed(part, votes, **options))


def observed(
    part: SyntheticPart,
    votes: tuple[KeypointVotes, ...],
    keypoints: int | None = None,
    box: bool = True,
    side_logits: FloatArray | None = None,
    kappa_scale: float = 1.0,
) -> Observed:
    """What a registration is given: the radii of the first `keypoints`; without `box`, one that holds every point."""
    return Observed(
        part.points_camera,
        part.radii_m[:, :keypoints],
        kappa_scale * part.keypoints_unit[:keypoints],
        votes,
        part.extents_unit if box else np.full(3, 100.0),
        SCALE_RANGE_M,
        side_logits,
    )


def argmax_kabsch(
    part: SyntheticPart, votes: tuple[KeypointVotes, ...], *, kappa_scale: float = 1.0
) -> FloatArray | None:
    """T_camera_part the paper's way: Kabsch of the metric keypoints to their first arg-max voxels."""
    if any(not one.peaks for one in votes):
        return None
    source = kappa_scale * part.scale_m * part.keypoints_unit[: len(votes)]
    target = np.array([one.peaks[0].voxel_camera for one in votes])
    R = umeyama(source[None], target[None]).R[0]
    return np.asarray(transform_from(R, target.mean(axis=0) - R @ source.mean(axis=0)), np.float64)


def pose_errors(T_camera_part: FloatArray | None, part: SyntheticPart) -> tuple[float, float, float]:
    """Degrees, millimetres of the origin, mean millimetres of the visible points (ADD); infinite without a pose."""
    if T_camera_part is None:
        return math.inf, math.inf, math.inf
    R, t = T_camera_part[:3, :3], T_camera_part[:3, 3]
    moved = (part.points_camera - part.t) @ part.R @ R.T + t - part.points_camera
    return (
        float(np.degrees(rotation_angle(R, part.R))),
        float(1e3 * np.linalg.norm(t - part.t)),
        float(1e3 * np.linalg.norm(moved, axis=1).mean()),
    )


def transform_of(result: Registration | Ambiguous | str) -> FloatArray | None:
    return result.T_camera_part if isinstance(result, Registration) else None


def pose_figures(errors: list[tuple[float, float, float]]) -> dict[str, Any]:
    """Medians with a missing pose as an infinite error, and the share of those missing."""
    rotation_deg, translation_mm, add_mm = np.array(errors).T
    return {
        "rotation_deg": median(rotation_deg),
        "translation_mm": median(translation_mm),
        "add_mm": median(add_mm),
        "add_p90_mm": figure(np.percentile(add_mm, 90, method="lower")),
        "without_pose": figure(np.mean(~np.isfinite(add_mm))),
    }
