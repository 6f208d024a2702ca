"""How well a part's evidence supports a pose, and which of many poses are the best distinct ones.

A pose is supported by the radii it explains, by the points that lie in the part's box and, where the part is planar, by
the sides of the keypoints. Support tells mirror images apart, which radii alone do not (METHOD 12).
"""

import numpy as np
from numpy.typing import NDArray

from page_runtime import multilateration
from page_runtime.multilateration import FloatArray
from page_runtime.pose_refinement import Evidence
from page_runtime.similarity import Similarities

# At most so many distinct poses are worth refining.
_MAX_DISTINCT = 3
# Lengths in units of the part's diagonal. Poses whose keypoints are closer than _DISTINCT, root mean
# square, refine one another: correlated errors make several minima about as good some 0.15 apart, which is
# no ambiguity.
_DISTINCT = 0.25
_BOX_MARGIN = 0.08
# Larger residuals do not count in the scale of the others.
SUPPORT_GATE = 0.2


def support_of(poses: Similarities, evidence: Evidence) -> FloatArray:
    """(C,) in [0, 1]: inlier mass of the radii x points in the box x agreement of the sides."""
    anchors = evidence.anchors
    place = poses.place(evidence.keypoints_unit) - anchors.origin
    num_poses, num_keypoints, _ = place.shape
    distance = multilateration.distances(place.reshape(-1, 3), anchors)
    residuals = distance.reshape(num_poses, num_keypoints, -1) - evidence.radii_m
    size_m = float(np.median(poses.s))
    scales = multilateration.gated_scales(
        residuals.reshape(num_poses * num_keypoints, -1), SUPPORT_GATE * size_m, 1e-3 * size_m
    )
    # One scale for all poses, the best one's: with its own each pose would excuse its errors.
    ratio = residuals / scales.reshape(num_poses, num_keypoints, 1).min(axis=0)
    mass = np.mean(1.0 / (1.0 + ratio * ratio), axis=(1, 2))
    points = anchors.relative - (poses.t - anchors.origin)[:, None]
    canonical = np.abs(points @ poses.R) / poses.s[:, None, None]
    boxed = np.mean((canonical <= 0.5 * evidence.extents_unit + _BOX_MARGIN).all(axis=2), axis=1)
    agreement = np.zeros(num_poses)
    if evidence.sides is not None:
        num_voted = evidence.sides.shape[1]
        heights = (place[:, :num_voted] @ evidence.normal)[:, :, None]
        heights = heights - anchors.relative @ evidence.normal
        towards = np.tanh(heights / (0.02 * size_m))
        agreement = np.mean(towards * evidence.sides.T, axis=(1, 2))
    return mass * (0.2 + 0.8 * boxed) * (0.5 + 0.5 * agreement)


def distinct_best(poses: Similarities, support: FloatArray, kappa: FloatArray) -> NDArray[np.intp]:
    """Indices of poses, best supported first, each distinct in its keypoints from those before it."""
    place = poses.place(kappa)
    order = np.argsort(-support, kind="stable")
    chosen: list[int] = []
    while len(order) and len(chosen) < _MAX_DISTINCT:
        chosen.append(int(order[0]))
        apart = np.sqrt(np.mean(np.sum((place[order] - place[order[0]]) ** 2, axis=2), axis=1))
        order = order[apart > _DISTINCT * poses.s[chosen[-1]]]
    return np.array(chosen, np.intp)


def ranked_by_support(poses: Similarities, evidence: Evidence) -> tuple[Similarities, float]:
    """The distinct poses, best supported first, and the second one's support over the first one's."""
    support = support_of(poses, evidence)
    order = distinct_best(poses, support, evidence.keypoints_unit)
    ratio = float(support[order[1]] / max(support[order[0]], 1e-12)) if len(order) > 1 else 0.0
    return poses.take(order), ratio
