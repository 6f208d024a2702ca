"""Candidate poses of a part: combinations of its keypoints' modes, three at a time."""

import itertools
from dataclasses import dataclass

import numpy as np

from page_runtime import multilateration
from page_runtime.multilateration import Anchors, FloatArray
from page_runtime.scoring import KeypointVotes
from page_runtime.similarity import Similarities, umeyama

# Lengths in units of the part's diagonal. Modes closer than _APART are one mode; a triangle's corners may
# miss their modes by _MISFIT.
_APART = 0.05
_MISFIT = 0.1

_MAX_MODES = 3
_MAX_TRIPLES = 5


@dataclass(frozen=True, eq=False, slots=True)
class Evidence:
    """Everything a pose is judged by. anchors: m points; radii_m (n, m); keypoints_unit (n, 3);
    extents_unit (3,); sides (m, v), tanh(logit / 2), or None where they do not apply; normal (3,) of a
    planar part, to the camera."""

    anchors: Anchors
    radii_m: FloatArray
    keypoints_unit: FloatArray
    extents_unit: FloatArray
    sides: FloatArray | None
    normal: FloatArray

    def thinned(self, count: int) -> "Evidence":
        """The same with at most `count` of the points."""
        chosen = multilateration.thinned(len(self.anchors.norm2), count)
        anchors = multilateration.anchors_from(self.anchors.relative[chosen] + self.anchors.origin)
        sides = None if self.sides is None else self.sides[chosen]
        return Evidence(anchors, self.radii_m[:, chosen], self.keypoints_unit, self.extents_unit, sides, self.normal)


def candidates(
    evidence: Evidence, votes: tuple[KeypointVotes, ...], scale_range_m: tuple[float, float]
) -> Similarities:
    """Poses of all combinations of modes of the triples whose scale and triangle are possible."""
    kappa, (low, high) = evidence.keypoints_unit, scale_range_m
    modes = _modes(evidence, votes, apart_m=_APART * low)
    triples, places = [], []
    for triple in _triples(kappa, len(votes)):
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


def _modes(evidence: Evidence, votes: tuple[KeypointVotes, ...], apart_m: float) -> list[list[FloatArray]]:
    """For each keypoint one to _MAX_MODES positions (3,) m: peaks first, then what multilateration adds."""
    anchors, radii_m = evidence.anchors, evidence.radii_m
    starts = multilateration.linear_hypotheses(anchors, radii_m).reshape(-1, 3)
    repeated = np.repeat(radii_m, 3, axis=0)
    schedule_m = [max(0.02, 0.2 * 0.5**k) for k in range(6)]
    refined = multilateration.refine_positions(starts, anchors, repeated, schedule_m)
    residuals = multilateration.distances(refined - anchors.origin, anchors) - repeated
    scales = multilateration.gated_scales(residuals, 0.1, 0.002).reshape(-1, 3).min(axis=1)
    mass = np.mean(1.0 / (1.0 + (residuals / np.repeat(scales, 3)[:, None]) ** 2), axis=1).reshape(-1, 3)
    refined = refined.reshape(-1, 3, 3)
    modes = []
    for j, order in enumerate(np.argsort(-mass, axis=1, kind="stable")):
        found = [peak.position_camera for peak in votes[j].peaks[:_MAX_MODES]] if j < len(votes) else []
        for k in order[mass[j, order] >= 0.7 * mass[j].max()]:
            if len(found) < _MAX_MODES and all(np.linalg.norm(refined[j, k] - other) > apart_m for other in found):
                found.append(refined[j, k])
        modes.append(found)
    return modes


def _triples(kappa: FloatArray, num_voted: int) -> list[tuple[int, int, int]]:
    """The voted keypoints, then the largest triangles that share no side with a triangle before them."""
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
    return chosen
