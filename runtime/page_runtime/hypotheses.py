"""Candidate poses of a part: combinations of its keypoints' modes, three at a time."""

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from page_runtime import multilateration
from page_runtime.multilateration import FloatArray
from page_runtime.pose_refinement import Evidence, stacked_radii
from page_runtime.scoring import KeypointVotes
from page_runtime.similarity import Similarities, umeyama

# Lengths in units of the part's diagonal. Modes closer than _APART are one mode; a triangle's corners may
# miss their modes by _MISFIT.
_APART = 0.05
_MISFIT = 0.1

_MAX_MODES = 3
_MAX_TRIPLES = 5


def candidates(
    keypoints_unit: FloatArray,
    modes: Sequence[Sequence[FloatArray]],
    num_voted: int,
    scale_range_m: tuple[float, float],
) -> Similarities:
    """Poses of all combinations of modes of the triples whose scale and triangle are possible.

    keypoints_unit: (n, 3); modes: for each of them positions (3,) m; num_voted: the first ones, of which there are
    votes.
    """
    kappa, (low, high) = keypoints_unit, scale_range_m
    triples, places = [], []
    for triple in _triples(kappa.tobytes(), num_voted):
        for combination in itertools.product(*(modes[j] for j in triple)):
            triples.append(triple)
            places.append(combination)
    source, target = kappa[np.array(triples)], np.array(places)
    poses = umeyama(source, target)
    placed = poses.s[:, None, None] * (source @ poses.R.transpose(0, 2, 1)) + poses.t[:, None]
    misfit = np.sqrt(np.mean(np.sum((placed - target) ** 2, axis=2), axis=1))
    # Three noisy modes know the scale worse than all radii will; the limits proper are applied to the result.
    possible = (poses.s >= 0.85 * low) & (poses.s <= 1.15 * high) & (misfit <= _MISFIT * poses.s)
    return poses.take(possible)


def modes_of(
    parts: Sequence[Evidence], votes: Sequence[tuple[KeypointVotes, ...]], smallest_m: Sequence[float]
) -> list[list[list[FloatArray]]]:
    """For each keypoint of each part one to _MAX_MODES positions (3,) m: peaks first, then what multilateration adds.

    smallest_m: the least diagonal each part may have.
    """
    if not parts:
        return []
    stack = stacked_radii(parts)
    anchors, num_parts = stack.anchors, len(parts)
    starts = multilateration.linear_hypotheses(anchors, stack.radii_m).reshape(num_parts, -1, 3)
    repeated = np.repeat(stack.radii_m, 3, axis=1)
    schedule_m = [max(0.02, 0.2 * 0.5**k) for k in range(6)]
    places = multilateration.refine_positions(starts, anchors, repeated, schedule_m)
    residuals = multilateration.distances(places - anchors.origin, anchors) - repeated
    scales = multilateration.gated_scales(residuals, 0.1, 0.002).reshape(num_parts, -1, 3).min(axis=2)
    # Radii that a part does not have are far from any, and have no mass.
    mass = np.sum(1.0 / (1.0 + (residuals / np.repeat(scales, 3, axis=1)[..., None]) ** 2), axis=2)
    places, mass = places.reshape(num_parts, -1, 3, 3), mass.reshape(num_parts, -1, 3)
    return [
        [
            _modes([peak.position_camera for peak in one.peaks] if one else [], at, mass_at, _APART * low_m)
            for one, at, mass_at in itertools.zip_longest(own_votes, own_places, own_mass)
        ]
        for own_votes, own_places, own_mass, low_m in zip(votes, places, mass, smallest_m, strict=True)
    ]


def _modes(peaks: list[FloatArray], places: FloatArray, mass: FloatArray, apart_m: float) -> list[FloatArray]:
    """The peaks and those of the places (3, 3) m with enough mass (3,) that are apart from the others."""
    found = peaks[:_MAX_MODES]
    for k in np.argsort(-mass, kind="stable"):
        if mass[k] < 0.7 * mass.max() or len(found) == _MAX_MODES:
            break
        if all(math.dist(places[k], other) > apart_m for other in found):
            found.append(places[k])
    return found


@lru_cache(maxsize=64)
def _triples(keypoints_unit: bytes, num_voted: int) -> tuple[tuple[int, int, int], ...]:
    """The voted keypoints, then the largest triangles that share no side with a triangle before them.

    keypoints_unit: the bytes of (n, 3) float64, which a category's parts have in every frame.
    """
    kappa = np.frombuffer(keypoints_unit).reshape(-1, 3)
    triples = np.array(list(itertools.combinations(range(len(kappa)), 3)))
    first, second = kappa[triples[:, 1]] - kappa[triples[:, 0]], kappa[triples[:, 2]] - kappa[triples[:, 0]]
    # Lagrange's identity: the squared area of the parallelogram.
    lengths = np.einsum("tk,tk->t", first, first) * np.einsum("tk,tk->t", second, second)
    areas = np.sqrt(np.maximum(lengths - np.einsum("tk,tk->t", first, second) ** 2, 0.0))
    if areas.max() <= 1e-4:
        raise ValueError("keypoints_unit: expected keypoints that span a plane, got collinear ones; choose others")
    chosen: list[tuple[int, int, int]] = []
    for k in np.lexsort((-areas, triples[:, 2] >= num_voted)):
        triple = (int(triples[k, 0]), int(triples[k, 1]), int(triples[k, 2]))
        if areas[k] > 0.1 * areas.max() and all(len({*triple, *other}) > 4 for other in chosen):
            chosen.append(triple)
            if len(chosen) == _MAX_TRIPLES:
                break
    return tuple(chosen)
