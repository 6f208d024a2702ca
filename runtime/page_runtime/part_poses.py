"""From the network's answer for the points of a region to the pose of every part: the second half of an estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.alternatives import Settled, settle
from page_runtime.articulation import Articulation, PartEvidence, articulate
from page_runtime.bundle import BundleMetadata
from page_runtime.category import Category, Part
from page_runtime.chain_fit import WholePose
from page_runtime.confidence import ConfidenceModel, features
from page_runtime.geometry import apply
from page_runtime.icp import refine_to_template
from page_runtime.network import NetworkOutput
from page_runtime.pose import ArticulatedPose, JointState, NotSeen, PartPose
from page_runtime.registration import Ambiguous, Observed, Registration, register_parts, registered_at
from page_runtime.sampling import RegionSample
from page_runtime.scoring import KeypointVotes, score_parts
from page_runtime.stopwatch import Stopwatch
from page_runtime.template import Template
from page_runtime.uncertainty import with_common_error
from page_runtime.whole_object import whole_instead

MIN_PART_POINTS = 12
MAX_VOTERS = 512
# Of a frame: two to three times what the votes of 2048 points need; a bound where radii agree on nothing.
MAX_EVALUATIONS = 40_000_000
# Of the votes. Radii of trained networks give 0.75 and more; those that agree on less are not worth the whole budget.
FULL_SHARE = 0.4


def pose_from_output(
    metadata: BundleMetadata,
    sample: RegionSample,
    output: NetworkOutput,
    watch: Stopwatch | None = None,
    *,
    max_voters: int = MAX_VOTERS,
) -> ArticulatedPose:
    """The second half of `estimate`: from the network's answer for the points of `sample` to poses."""
    watch = watch or Stopwatch()
    points = answered_points(sample, output)
    members = members_of(output, sample.num_distinct)
    votes = votes_of(members, points, output, metadata, max_voters=max_voters)
    watch.stage("scoring")
    observed = observed_parts(metadata.category, points, members, votes, output)
    registered = iter(register_parts([one for one in observed if isinstance(one, Observed)]))
    registrations = [one if isinstance(one, str) else next(registered) for one in observed]
    watch.stage("registration")
    return pose_from_registrations(metadata, observed, registrations, watch)


def pose_from_registrations(
    metadata: BundleMetadata,
    observed: Sequence[Observed | str],
    registrations: Sequence[Registration | Ambiguous | str],
    watch: Stopwatch,
) -> ArticulatedPose:
    """From each part's own pose, or the reason why it has none, to the object: the template, the joints, confidence."""
    category = metadata.category
    found = [
        _found(part, one, registration)
        for part, one, registration in zip(category.parts, observed, registrations, strict=True)
    ]
    watch.stage("icp")
    settled, articulation = _articulated(category, found)
    whole = whole_instead(category, observed, [_poses_of(one) for one in found], articulation)
    if whole is not None:
        found = [_found_in(whole, k, observed[k]) or found[k] for k in range(len(found))]
        settled, articulation = _articulated(category, found)
    parts: list[PartPose | NotSeen] = []
    for index, (part, one, choice) in enumerate(zip(category.parts, found, settled, strict=True)):
        evidence = articulation.parts[index]
        if isinstance(one, str) or choice is None or evidence is None:
            parts.append(NotSeen(part.name, one if isinstance(one, str) else one.ambiguity))
            continue
        disagreement = float("inf") if choice.turned else _disagreement(index, category, articulation.joints)
        pose = _part_pose(part, one, one.registrations[choice.index], evidence, disagreement)
        parts.append(_with_confidence(pose, metadata.confidence))
    watch.stage("articulation")
    return ArticulatedPose(tuple(parts), articulation.joints, watch.stage_ms)


def _articulated(category: Category, found: Sequence[_Found | str]) -> tuple[tuple[Settled | None, ...], Articulation]:
    """Of each part's poses the one that the joints allow, and all of these as the joints allow them."""
    settled = settle(category, [_poses_of(one) for one in found])
    taken = [one.evidence if one is not None and one.decided else None for one in settled]
    return settled, articulate(category, taken)


@dataclass(frozen=True, eq=False, slots=True)
class _Found:
    """One part by itself: one registration, or two and why neither is the one; evidence of each."""

    votes: tuple[KeypointVotes, ...]
    registrations: tuple[Registration, ...]
    evidence: tuple[PartEvidence, ...]
    ambiguity: str
    num_points: int


@dataclass(frozen=True, eq=False, slots=True)
class LabelledPoints:
    """What a look at a region said of its points. points_camera (A,3) m; pixels (A,): which of the frame's pixels, row
    by row; members: for each part its rows of these."""

    points_camera: NDArray[np.float32]
    pixels: NDArray[np.intp]
    members: tuple[NDArray[np.intp], ...]

    def in_order(self, order: Sequence[int]) -> LabelledPoints:
        """Part k is what was called part order[k]."""
        return replace(self, members=tuple(self.members[k] for k in order))


def labelled_points(sample: RegionSample, output: NetworkOutput) -> LabelledPoints:
    """The points of the sample that the network answered for, with its answer."""
    points = answered_points(sample, output)
    return LabelledPoints(points, sample.source_index[: len(points)], tuple(members_of(output, sample.num_distinct)))


def answered_points(sample: RegionSample, output: NetworkOutput) -> NDArray[np.float32]:
    """(A,3) m: the points of the sample that the network answered for, none twice."""
    return sample.points_camera[: sample.num_distinct][: len(output.part_logits)]


def members_of(output: NetworkOutput, num_distinct: int) -> list[NDArray[np.intp]]:
    """For each part the indices of its points among the first `num_distinct`."""
    labels = output.part_logits[:num_distinct].argmax(axis=1)
    return [np.flatnonzero(labels == index) for index in range(output.part_logits.shape[1] - 1)]


def seen_parts(members: Sequence[NDArray[np.intp]]) -> list[int]:
    """The parts with enough points."""
    return [index for index, own in enumerate(members) if len(own) >= MIN_PART_POINTS]


def votes_of(
    members: Sequence[NDArray[np.intp]],
    points_camera: NDArray[np.float32],
    output: NetworkOutput,
    metadata: BundleMetadata,
    *,
    max_voters: int = MAX_VOTERS,
) -> dict[int, tuple[KeypointVotes, ...]]:
    """The votes of every part with enough points, by its index; `members` are the points of each part."""
    num_voted = metadata.category.num_voted
    seen = seen_parts(members)
    # A prefix of the progressive order covers the part evenly.
    voters = [members[index][:max_voters] for index in seen]
    votes = score_parts(
        [(points_camera[own], output.radii_m[own, :num_voted]) for own in voters],
        voxel_m=metadata.voxel_m,
        max_evaluations=MAX_EVALUATIONS // max(1, num_voted * len(seen)),
        full_share=FULL_SHARE,
    )
    return dict(zip(seen, votes, strict=True))


def observed_parts(
    category: Category,
    points_camera: NDArray[np.float32],
    members: Sequence[NDArray[np.intp]],
    votes: Mapping[int, tuple[KeypointVotes, ...]],
    output: NetworkOutput,
) -> list[Observed | str]:
    """What is known of every part before its pose, or the reason why there can be none."""
    return [
        _observed(part, index, points_camera, members[index], votes.get(index), output)
        for index, part in enumerate(category.parts)
    ]


def _observed(
    part: Part,
    index: int,
    points_camera: NDArray[np.float32],
    members: NDArray[np.intp],
    votes: tuple[KeypointVotes, ...] | None,
    output: NetworkOutput,
) -> Observed | str:
    """What the pose of a part is found from (`members` indexes points and outputs alike), or why there is none."""
    if votes is None:
        return f"not seen: {len(members)} of {len(points_camera)} points belong to it, {MIN_PART_POINTS} are needed"
    extents_m = output.extents_m[index].astype(np.float64)
    if not (np.isfinite(extents_m).all() and (extents_m > 0.0).all()):
        return f"the network gives it no size: {extents_m.tolist()} m"
    return Observed(
        points_camera[members],
        output.radii_m[members],
        part.keypoints_unit,
        votes,
        extents_m / np.linalg.norm(extents_m),
        part.diagonal_range_m,
        output.side_logits[members],
        float(np.linalg.norm(extents_m)),
    )


def _found(part: Part, observed: Observed | str, registration: Registration | Ambiguous | str) -> _Found | str:
    """One part with its poses fitted to the category's template, or why it has none."""
    if isinstance(observed, str):
        return observed
    if isinstance(registration, str):
        return registration
    poses, ambiguity = (
        (registration.poses, registration.reason) if isinstance(registration, Ambiguous) else ((registration,), "")
    )
    extents_unit = np.asarray(observed.extents_unit, np.float64)
    evidence = tuple(
        PartEvidence(pose.T_camera_part, pose.scale_m, with_common_error(pose.covariance, pose.scale_m), extents_unit)
        for pose in poses
    )
    if part.template is not None:
        evidence = tuple(_fitted(one, observed.points_camera, part.template) for one in evidence)
    return _Found(observed.votes, poses, evidence, ambiguity, len(observed.points_camera))


def _poses_of(found: _Found | str) -> tuple[PartEvidence, ...]:
    return () if isinstance(found, str) else found.evidence


def _found_in(whole: WholePose, index: int, observed: Observed | str) -> _Found | None:
    """A part as the whole object has it, None where it has not."""
    if index not in whole.parts or isinstance(observed, str):
        return None
    row = whole.parts.index(index)
    pose = whole.poses.take(np.array([row]))
    registration = registered_at(observed, pose)
    if isinstance(registration, str):
        return None
    covariance = with_common_error(whole.covariances[row], registration.scale_m)
    evidence = PartEvidence(registration.T_camera_part, registration.scale_m, covariance, whole.extents_unit[row])
    return _Found(observed.votes, (registration,), (evidence,), "", len(observed.points_camera))


def _fitted(evidence: PartEvidence, points_camera: NDArray[np.floating], template: Template) -> PartEvidence:
    """By the part's points and the category's template, where that is for the better."""
    fit = refine_to_template(
        points_camera,
        evidence.T_camera_part,
        evidence.scale_m,
        evidence.covariance,
        template,
        extents_unit=evidence.extents_unit,
    )
    if not fit.accepted:
        return evidence
    scale_m = float(np.linalg.norm(fit.extents_m))
    return PartEvidence(fit.T_camera_part, scale_m, fit.covariance, fit.extents_m / scale_m)


def _part_pose(
    part: Part, found: _Found, registration: Registration, evidence: PartEvidence, disagreement: float
) -> PartPose:
    """`registration`: the one taken; `evidence`: of the part as its joints allow it."""
    return PartPose(
        name=part.name,
        T_camera_part=evidence.T_camera_part,
        extents_m=evidence.extents_unit * evidence.scale_m,
        keypoints_camera=apply(evidence.T_camera_part, evidence.scale_m * part.keypoints_unit),
        scores=np.array([vote.peaks[0].share if vote.peaks else 0.0 for vote in found.votes]),
        confidence=registration.inlier_share,
        inlier_share=registration.inlier_share,
        runner_up_ratio=registration.runner_up_ratio,
        vote_gap=max(vote.gap for vote in found.votes),
        num_points=found.num_points,
        residual_m=registration.residual_m,
        covariance=evidence.covariance[:6, :6],
        disagreement=disagreement,
    )


def _disagreement(index: int, category: Category, states: Sequence[JointState]) -> float:
    """The largest of part `index`'s joints, 0 where none is known."""
    known = [
        state.disagreement
        for joint, state in zip(category.joints, states, strict=True)
        if index in (joint.parent, joint.child) and state.disagreement is not None
    ]
    return max(known, default=0.0)


def _with_confidence(pose: PartPose, model: ConfidenceModel | None) -> PartPose:
    return pose if model is None else replace(pose, confidence=model.probability(features(pose)))
