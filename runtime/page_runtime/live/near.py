"""Estimates that start from an expected pose: by the network without a search, and by depth alone.

Both answer as `estimator.estimate` does, with the same meaning of every number, or say why they cannot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.articulation import PartEvidence, articulate
from page_runtime.bundle import BundleMetadata
from page_runtime.category import Category, Part
from page_runtime.geometry import apply, rotation_angle
from page_runtime.icp import fit_limit_m, refine_to_template
from page_runtime.live.prior import PartPrior, Prior
from page_runtime.live.vote_window import votes_near
from page_runtime.neighbours import nearest
from page_runtime.network import NetworkOutput
from page_runtime.part_poses import (
    MAX_VOTERS,
    answered_points,
    members_of,
    observed_parts,
    pose_from_output,
    pose_from_registrations,
    seen_parts,
)
from page_runtime.pose import ArticulatedPose, NotSeen, PartPose
from page_runtime.registration import Observed, register_near
from page_runtime.sampling import RegionSample
from page_runtime.similarity import Similarities
from page_runtime.stopwatch import Stopwatch

# The first so many points of a sample are enough to fit two to seven parts to.
_FIT_POINTS = 1024
_REFERENCE_POINTS = 768
# From a good start the last rounds of `icp` are enough.
_FIT_ROUNDS = (160, 160, 256)
# A point farther from every surface expected is of something that has come since.
_REACH_M = 0.02
# More points than this share beyond that, or of another colour (levels of 255), and the object is elsewhere.
_MOST_STRANGE = 0.1
_SPACINGS = 4.0
_OTHER_COLOR = 50
_MOST_REPAINTED = 0.3
# Of the points that a part had when the network last saw it: with fewer something is before it, or it has turned away.
_LEAST_SHARE = 0.4
# A part of fewer points is too small to be fitted: where most others are, it goes as its motion and its joints say.
_LEAST_POINTS = 24
# A part that has so many may be fitted or not, as its points lie: without a fit it is one of those.
_SURE_POINTS = 60


def pose_near(
    metadata: BundleMetadata, sample: RegionSample, output: NetworkOutput, prior: Prior, watch: Stopwatch
) -> ArticulatedPose:
    """As `part_poses.pose_from_output`, from where the parts are expected instead of a search for their keypoints.

    A part that the network sees and `prior` does not know needs the search, and all of them are searched then.
    """
    category = metadata.category
    points, members = answered_points(sample, output), members_of(output, sample.num_distinct)
    seen = seen_parts(members)
    expected = {k: part for k, part in enumerate(prior.parts) if part is not None}
    if not seen or not set(seen) <= expected.keys():
        return pose_from_output(metadata, sample, output, watch)
    votes = {
        k: votes_near(
            points[members[k][:MAX_VOTERS]],
            output.radii_m[members[k][:MAX_VOTERS], : category.num_voted],
            _placed(expected[k].evidence, category.parts[k])[: category.num_voted],
            voxel_m=metadata.voxel_m,
        )
        for k in seen
    }
    watch.stage("scoring")
    observed = observed_parts(category, points, members, votes, output)
    found = [(k, one) for k, one in enumerate(observed) if isinstance(one, Observed)]
    starts = [_similarity(expected[k].evidence) for k, _ in found]
    ratios = [expected[k].last.runner_up_ratio for k, _ in found]
    registered = iter(register_near([one for _, one in found], starts, ratios))
    registrations = [one if isinstance(one, str) else next(registered) for one in observed]
    watch.stage("registration")
    return pose_from_registrations(metadata, observed, registrations, watch)


def _placed(evidence: PartEvidence, part: Part) -> NDArray[np.floating]:
    """(n,3) m, the part's keypoints."""
    return apply(evidence.T_camera_part, evidence.scale_m * part.keypoints_unit)


def _similarity(evidence: PartEvidence) -> Similarities:
    T = np.asarray(evidence.T_camera_part, np.float64)
    return Similarities(T[None, :3, :3], T[None, :3, 3], np.array([evidence.scale_m]))


@dataclass(frozen=True, eq=False, slots=True)
class Fitted:
    """A pose from depth alone, and what became of each part: its evidence as the joints allow it, None for one that was
    not expected."""

    pose: ArticulatedPose
    evidence: tuple[PartEvidence | None, ...]


def fit_near(
    category: Category, sample: RegionSample, colors: NDArray[np.uint8], prior: Prior, watch: Stopwatch
) -> Fitted | str:
    """Every expected part fitted to the points of `sample` that are nearest to its surface, or why that is not enough.

    colors: (N,3) uint8 RGB of the sample's points. The expected pose is the prior that `icp` holds the pose with, so
    the answer is the most probable pose under both. What stands where nothing is expected, and points of another colour
    than the surface had there, say that the object is elsewhere: depth alone would then slide a part along itself.
    confidence, scores and inliers are those of the last answer of the network, as this has nothing new to say of them.
    """
    points = sample.points_camera[: min(sample.num_distinct, _FIT_POINTS)]
    members, doubt = _members(points, colors[: len(points)], sample.center_camera, prior)
    watch.stage("registration")
    if doubt:
        return doubt
    evidence: list[PartEvidence | None] = []
    carried = 0
    for part, own, spec in zip(prior.parts, members, category.parts, strict=True):
        if part is None:
            evidence.append(None)
            continue
        found = _fitted(part, points[own], spec, len(points) / _FIT_POINTS)
        watch.stage("icp")
        if isinstance(found, str):
            return f"{spec.name}: {found}"
        evidence.append(part.evidence if found is None else found)
        carried += found is None
    if 2 * carried >= len(prior.known):
        return f"{carried} of its parts have too few points"
    articulation = articulate(category, evidence)
    parts = tuple(
        NotSeen(spec.name, "not seen: it was not when the network last looked")
        if part is None or one is None
        else _part_pose(part, one, spec, len(own))
        for part, one, own, spec in zip(prior.parts, articulation.parts, members, category.parts, strict=True)
    )
    watch.stage("articulation")
    return Fitted(ArticulatedPose(parts, articulation.joints, watch.stage_ms), articulation.parts)


def _members(
    points_camera: NDArray[np.float32], colors: NDArray[np.uint8], center_camera: NDArray[np.float32], prior: Prior
) -> tuple[list[NDArray[np.intp]], str]:
    """For each part the points whose nearest expected surface is its own; and what speaks against all of them."""
    nowhere, unseen = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
    placed = [nowhere if part is None else part.surface_camera[:_REFERENCE_POINTS] for part in prior.parts]
    placed.append(prior.background_camera[:_REFERENCE_POINTS])
    painted = [unseen if part is None else part.surface.colors[:_REFERENCE_POINTS] for part in prior.parts]
    painted.append(np.zeros(placed[-1].shape, np.uint8))
    reference = np.concatenate(placed) - center_camera
    owner = np.repeat(np.arange(len(placed)), [len(surface) for surface in placed])
    queries = points_camera - center_camera
    index = nearest(queries, reference, 1)[:, 0]
    away = queries - reference[index]
    distance_m = np.sqrt(np.einsum("nk,nk->n", away, away))
    near = distance_m <= _REACH_M
    of_part = near & (owner[index] < len(prior.parts))
    # A background far away has few points, far from each other.
    strange = float(np.mean(distance_m > max(_REACH_M, _SPACINGS * float(np.median(distance_m)))))
    change = np.abs(np.concatenate(painted)[index[of_part]].astype(np.int16) - colors[of_part]).max(axis=1)
    repainted = float(np.mean(change > _OTHER_COLOR)) if len(change) else 0.0
    doubt = ""
    if strange > _MOST_STRANGE:
        doubt = f"{100 * strange:.0f} % of the points are where nothing was"
    elif repainted > _MOST_REPAINTED:
        doubt = f"{100 * repainted:.0f} % of its points have another colour than its surface had there"
    return [np.flatnonzero(near & (owner[index] == k)) for k in range(len(prior.parts))], doubt


def _fitted(
    part: PartPrior, points_camera: NDArray[np.float32], spec: Part, share_of_sample: float
) -> PartEvidence | str | None:
    """The part by its points; what speaks against that, or None where they are too few to say anything."""
    expected = round(share_of_sample * len(part.surface))
    needed = max(1, round(_LEAST_SHARE * expected))
    if len(points_camera) < needed:
        return f"{len(points_camera)} points are near it, {needed} are needed"
    if len(points_camera) < _LEAST_POINTS:
        return None
    if spec.template is None:
        return "there is no template to fit"
    evidence = part.evidence
    fit = refine_to_template(
        points_camera,
        evidence.T_camera_part,
        evidence.scale_m,
        evidence.covariance[:6, :6],
        spec.template,
        extents_unit=evidence.extents_unit,
        rounds=_FIT_ROUNDS,
    )
    no_better = fit.residual_after_m >= fit.residual_before_m
    if not fit.accepted and not (no_better and fit.residual_before_m <= fit_limit_m(evidence.scale_m)):
        return fit.reason if expected >= _SURE_POINTS else None
    covariance = evidence.covariance.copy()
    covariance[:6, :6] = fit.covariance
    return replace(evidence, T_camera_part=fit.T_camera_part, covariance=covariance)


def _part_pose(part: PartPrior, evidence: PartEvidence, spec: Part, num_points: int) -> PartPose:
    return replace(
        part.last,
        T_camera_part=evidence.T_camera_part,
        extents_m=evidence.extents_unit * evidence.scale_m,
        keypoints_camera=_placed(evidence, spec),
        num_points=num_points,
        covariance=evidence.covariance[:6, :6],
    )


def agreement(one: Sequence[object], other: Sequence[object], *, rotation_rad: float, share: float) -> bool:
    """Whether two estimates of an object give no part poses farther apart than this: rad, and of its diagonal."""
    for a, b in zip(one, other, strict=True):
        if not (isinstance(a, PartPose) and isinstance(b, PartPose)):
            continue
        turn_rad = float(rotation_angle(a.T_camera_part[:3, :3], b.T_camera_part[:3, :3]))
        apart_m = float(np.linalg.norm(a.T_camera_part[:3, 3] - b.T_camera_part[:3, 3]))
        if turn_rad > rotation_rad or apart_m > share * np.linalg.norm(a.extents_m):
            return False
    return True
