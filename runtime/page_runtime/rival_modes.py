"""Other places where a keypoint nearly has its most votes: mirror images above all.

The radii of a flat part fit the mirror image of a keypoint as well (METHOD 12), those of a thin one a ring of places,
and the votes cannot tell. Such places follow from the best one by symmetries of the part's points, so they are looked
for there, and where multilateration started, instead of in all of space: keeping every voxel with 95 % of the most
votes cost `branch_and_bound` half as many evaluations again, and listed the keypoint of a flat part no more often.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from page_runtime import multilateration
from page_runtime.branch_and_bound import WINDOW
from page_runtime.multilateration import Anchors, FloatArray
from page_runtime.vote_race import Found
from page_runtime.vote_shells import Float32Array, IntArray, Shells, bands, count, exact_count, lifted

# A candidate nearer to the best voxel, or to one before it, is part of the same mode.
_SEPARATION_ETAS = 3.0
# A keypoint close to the plane of a flat part has one long mode instead of two: how far along the normal to look.
_ALONG_NORMAL_ETAS = (-7.0, -4.0, 4.0, 7.0)
_ROUNDS = 4
# Of a rival's votes, in the voxel of the candidate; one beside it may have more.
_PROMISING = 0.85


def candidate_places(
    places: FloatArray, seeds: FloatArray, anchors: Anchors, radii_m: FloatArray, eta_m: float
) -> FloatArray:
    """(P, n, C, 3) m: where other modes of each part's keypoints may be, given the best places (P, n, 3) m, the seeds
    of multilateration (P, n, S, 3) m and radii (P, n, m) m. The points are `stacked`.

    A flat part is its own mirror image in its plane, a long one after any turn about its axis: the images in the two
    planes through the longest axis, and after turns by 90, 180 and 270 degrees, refined on the radii; the seeds;
    then points on either side along the normal.
    """
    _, axes = multilateration.principal_axes(anchors.relative)
    x, y, z = np.moveaxis((places - anchors.origin) @ axes, -1, 0)
    images = [(x, y, -z), (x, -y, z), (x, -y, -z), (x, -z, y), (x, z, -y)]
    local = np.stack([np.stack(image, axis=-1) for image in images], axis=2)
    starts = local.reshape(len(places), -1, 3) @ axes.mT + anchors.origin
    schedule_m = [max(2.0 * eta_m, 0.1 * 0.5**k) for k in range(_ROUNDS)]
    repeated = np.repeat(radii_m, len(images), axis=1)
    refined = multilateration.refine_positions(starts, anchors, repeated, schedule_m).reshape(local.shape)
    steps = eta_m * np.array(_ALONG_NORMAL_ETAS)
    aside = places[:, :, None] + steps[:, None] * axes[:, None, None, :, 2]
    return np.concatenate((refined, seeds, aside), axis=2)


def rival_voxels(
    shells: Shells, founds: Sequence[Found], candidates: FloatArray, rival_share: float
) -> list[tuple[IntArray, IntArray]]:
    """For each of J keypoints voxels (R, 3) of rivals and their votes (R,), most first, from candidate places
    (J, C, 3) m.

    A rival has at least rival_share of the most votes, and the most of the voxels around it.
    """
    best = np.array([found.voxels[0] if len(found.voxels) else [0, 0, 0] for found in founds], np.int64)
    most = np.array([found.votes for found in founds])
    # A candidate may have diverged; 2^40 voxels is far from any, yet exact in int64 and float64.
    voxels = np.rint(np.clip(candidates / shells.voxel_m, -(2.0**40), 2.0**40)).astype(np.int64)
    apart = _apart(np.concatenate((best[:, None], voxels), axis=1))[:, 1:]
    # What is farther off than any radius reaches has no votes, and would cost the others digits.
    near = np.abs(voxels - shells.origin.T[:, None]).max(axis=2) * shells.voxel_m <= _farthest_m(shells)[:, None]
    owner, place = np.nonzero(apart & near)
    voxels = voxels[owner, place] - shells.origin.T[owner]
    reach_m = np.zeros(len(founds))
    np.maximum.at(reach_m, owner, shells.voxel_m * (np.linalg.norm(voxels, axis=1) + 2.0))
    certain = bands(shells, 0.0, reach_m, at_least=False)
    required = np.ceil(rival_share * most - 1e-9)  # the small term keeps 0.95 * 100 from rounding up to 96
    promising = _counted(shells, certain, voxels, owner) >= _PROMISING * required[owner]
    voxels, owner = voxels[promising], owner[promising]
    around = (voxels[:, None] + WINDOW.T).reshape(-1, 3)
    votes = _counted(shells, certain, around, np.repeat(owner, len(WINDOW.T))).reshape(len(voxels), len(WINDOW.T))
    rows, at = np.arange(len(voxels)), votes.argmax(axis=1)
    voxels, votes = around.reshape(*votes.shape, 3)[rows, at] + shells.origin.T[owner], votes[rows, at]
    enough = (votes >= required[owner]) & (most[owner] > 0)
    voxels, owner = voxels[enough], owner[enough]
    votes = exact_count(shells, (voxels - shells.origin.T[owner]).T, owner)
    rivals = []
    for j in range(len(founds)):
        mine = np.flatnonzero(owner == j)
        mine = mine[np.argsort(-votes[mine], kind="stable")]
        rivals.append((voxels[mine], votes[mine]))
    return rivals


def _farthest_m(shells: Shells) -> FloatArray:
    """(J,) m from its origin: no voxel beyond has a vote for the keypoint."""
    outer = np.where(np.isfinite(shells.radii_m), shells.norm + shells.radii_m, 0.0)
    outer += shells.rule.bounds_m(shells.voxel_m)[1]
    return np.maximum.reduceat(outer, shells.starts[:-1])


def _apart(voxels: IntArray) -> NDArray[np.bool_]:
    """(J, C): which of the voxels (J, C, 3) are _SEPARATION_ETAS from every earlier one that is."""
    apart = np.ones(voxels.shape[:2], np.bool_)
    for k in range(1, voxels.shape[1]):
        away = (voxels[:, :k] - voxels[:, k, None]).astype(np.float64)
        near = np.einsum("jck,jck->jc", away, away) <= 3.0 * _SEPARATION_ETAS**2
        apart[:, k] = ~(near & apart[:, :k]).any(axis=1)
    return apart


def _counted(shells: Shells, certain: Float32Array, voxels: IntArray, owner: NDArray[np.intp]) -> IntArray:
    """Votes (M,) of voxels (M, 3), counted from their origins, that float32 is certain of."""
    return count(shells, certain, lifted(shells, voxels.T, 0), owner)
