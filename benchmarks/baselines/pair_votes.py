"""A part's pose from what its pairs of points say: centre, axes and size by accumulated votes (CPPF, `pairs`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from benchmarks.baselines.pairs import ALONG, OFF, SIZE, TURN, PairOutputs, voted_axes
from numpy.typing import NDArray

from page_runtime.bundle import BundleMetadata
from page_runtime.pose import ArticulatedPose
from page_runtime.sampling import RegionSample
from page_runtime.similarity import Similarities
from page_training.regressed import members_of, plain_pose

FloatArray = NDArray[np.float64]

MAX_PAIRS = 1024
MIN_PAIRS = 8
# Of the part's guessed diagonal: nearer points give a line that noise turns; an edge of the accumulator's voxels.
MIN_APART, VOXEL = 0.05, 1 / 40
DIRECTIONS = 10_000
AROUND = 720
# A pair votes for directions whose angle is this near to what it says.
TOLERANCE_RAD = np.radians(2.5)
# Directions with so much of the most votes, as near as this to the one that has them, are averaged.
LEVEL, NEAR_RAD = 0.9, np.radians(5.0)


@dataclass(frozen=True, slots=True)
class PairVotes:
    """Of one part, Q pairs: one (Q,3) m their first points, line (Q,3) unit vectors to the second ones, along and off
    (Q,) m, turns_rad (Q,2), away (2,) the probability that either axis points away from the camera, diagonal_m."""

    one: FloatArray
    line: FloatArray
    along: FloatArray
    off: FloatArray
    turns_rad: FloatArray
    away: FloatArray
    diagonal_m: float


def pair_pose(metadata: BundleMetadata, sample: RegionSample, outputs: PairOutputs) -> ArticulatedPose:
    """Each part where the votes of its pairs put it."""
    category = metadata.category
    axes = voted_axes(category).numpy()
    placed: list[Similarities | str] = []
    for k in range(len(category.parts)):
        votes = votes_of(k, metadata, sample, outputs)
        placed.append(votes if isinstance(votes, str) else voted_similarity(votes, axes[k]))
    return plain_pose(category, members_of(sample, outputs), placed, outputs)


def votes_of(part: int, metadata: BundleMetadata, sample: RegionSample, outputs: PairOutputs) -> PairVotes | str:
    """What the pairs of a part say, or why that is not enough. Points that repeat others begin or end no pair."""
    first, second = outputs.first[0].numpy(), outputs.second[0].numpy()
    own = (outputs.owner[0].numpy() == part) & (np.maximum(first, second) < sample.num_distinct)
    guessed_m = float(outputs.guessed[0, part]) * metadata.category.region_radius_m
    points = sample.points_camera.astype(np.float64)
    line = points[second] - points[first]
    length = np.linalg.norm(line, axis=1)
    chosen = np.flatnonzero(own & (length > MIN_APART * guessed_m))[:MAX_PAIRS]
    if len(chosen) < MIN_PAIRS:
        return f"no pose: {len(chosen)} pairs of its points are far enough apart, {MIN_PAIRS} are needed"
    sizes = outputs.sizes[0, chosen].softmax(-1).sum(0)
    return PairVotes(
        one=points[first[chosen]],
        line=line[chosen] / length[chosen, None],
        along=guessed_m * ALONG.values(outputs.along[0, chosen].numpy()),
        off=guessed_m * OFF.values(outputs.off[0, chosen].numpy()),
        turns_rad=TURN.values(outputs.turns[0, chosen].numpy()),
        away=outputs.sides[0, chosen].mean(0).sigmoid().numpy().astype(np.float64),
        diagonal_m=guessed_m * float(np.exp(SIZE.values(sizes.log().numpy()))),
    )


def voted_similarity(votes: PairVotes, axes: NDArray[np.int64]) -> Similarities:
    """axes: which two of the part's axes `votes.turns_rad` are of. The second is sought at right angles to the first,
    and the third is theirs by the right-hand rule."""
    first = voted_direction(sphere(DIRECTIONS), votes.line, votes.turns_rad[:, 0], votes.away[0])
    second = voted_direction(circle(first, AROUND), votes.line, votes.turns_rad[:, 1], votes.away[1])
    second = second - (second @ first) * first
    R = np.empty((3, 3))
    third = 3 - int(axes.sum())
    even = (axes[1] - axes[0]) % 3 == 1
    R[:, axes[0]], R[:, axes[1]] = first, second / np.linalg.norm(second)
    R[:, third] = np.cross(R[:, axes[0]], R[:, axes[1]]) * (1.0 if even else -1.0)
    return Similarities(R[None], voted_center(votes)[None], np.array([votes.diagonal_m]))


def voted_center(votes: PairVotes) -> FloatArray:
    """(3,) m: every pair votes for all of the circle that it says the centre is on, a voxel apart; the mean of the
    votes in the voxel with the most of them and in those around it."""
    voxel_m = VOXEL * votes.diagonal_m
    counts = np.ceil(2.0 * np.pi * votes.off / voxel_m).clip(1, 1024).astype(np.intp)
    pair = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts, counts)
    angle = 2.0 * np.pi * within / counts[pair]
    across, beyond = orthogonal_to(votes.line)
    middle = votes.one + votes.along[:, None] * votes.line
    turned = np.cos(angle)[:, None] * across[pair] + np.sin(angle)[:, None] * beyond[pair]
    voted = middle[pair] + votes.off[pair, None] * turned
    cell = np.floor((voted - voted.min(axis=0)) / voxel_m).astype(np.int64)
    size = cell.max(axis=0) + 1
    _, at, weight = np.unique(np.ravel_multi_index(tuple(cell.T), tuple(size)), return_index=True, return_counts=True)
    near = (np.abs(cell - cell[at[weight.argmax()]]) <= 1).all(axis=1)
    return voted[near].mean(axis=0)


def voted_direction(candidates: FloatArray, line: FloatArray, turn_rad: FloatArray, away: float) -> FloatArray:
    """(3,) of the candidates (M,3) the one that most lines (Q,3) make the angles turn_rad (Q,) with, its votes
    weighted by the probability of its side, and averaged with those beside it that have nearly as many."""
    cosine = candidates @ line.T
    nearest, farthest = np.maximum(turn_rad - TOLERANCE_RAD, 0.0), np.minimum(turn_rad + TOLERANCE_RAD, np.pi)
    votes = ((cosine <= np.cos(nearest)) & (cosine >= np.cos(farthest))).sum(axis=1)
    weighted = votes * np.where(candidates[:, 2] > 0.0, away, 1.0 - away)
    best = candidates[weighted.argmax()]
    near = (candidates @ best > np.cos(NEAR_RAD)) & (votes >= LEVEL * votes[weighted.argmax()])
    mean = candidates[near].mean(axis=0)
    return mean / np.linalg.norm(mean)


def sphere(count: int) -> FloatArray:
    """(count,3) unit vectors spread evenly, by the golden angle."""
    index = np.arange(count)
    z = 1.0 - (2.0 * index + 1.0) / count
    angle = index * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def circle(axis: FloatArray, count: int) -> FloatArray:
    """(count,3) unit vectors at right angles to `axis` (3,), spread evenly."""
    across, beyond = orthogonal_to(axis[None])
    angle = 2.0 * np.pi * np.arange(count)[:, None] / count
    return np.cos(angle) * across + np.sin(angle) * beyond


def orthogonal_to(line: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two (Q,3) unit vectors at right angles to each of the unit vectors (Q,3) and to each other."""
    aside = np.eye(3)[np.abs(line).argmin(axis=1)]
    across: FloatArray = np.cross(line, aside)
    across = across / np.linalg.norm(across, axis=1, keepdims=True)
    beyond: FloatArray = np.cross(line, across)
    return across, beyond
