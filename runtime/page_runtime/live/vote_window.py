"""Votes around a place that is nearly right: what `scoring` would count there, without the search."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from page_runtime.scoring import TWO_SIDED, KeypointVotes, Peak, VoteRule

# Voxels to either side of the place's own: five a side.
_REACH = 2
_OFFSETS = np.stack(np.meshgrid(*3 * [np.arange(-_REACH, _REACH + 1)], indexing="ij"), axis=-1).reshape(-1, 3)


def votes_near(
    points_camera: NDArray[np.floating],
    radii_m: NDArray[np.floating],
    places_camera: NDArray[np.floating],
    *,
    voxel_m: float,
    rule: VoteRule = TWO_SIDED,
) -> tuple[KeypointVotes, ...]:
    """The votes (Eq. 16-18) of the n keypoints of one part in the voxels around places_camera (n, 3) m.

    points_camera: (N, 3) m; radii_m: (N, n) m. Of equal voxels the first in C order, as in `scoring`; `gap` is the
    votes that are not there, as nothing is known of other voxels. Radii and points that are not finite do not vote.
    """
    points, radii = np.asarray(points_camera, np.float64), np.asarray(radii_m, np.float64)
    lowest_m, highest_m = rule.bounds_m(voxel_m)
    found = []
    for place, own in zip(np.asarray(places_camera, np.float64), radii.T, strict=True):
        voxels = np.rint(place / voxel_m) + _OFFSETS
        centres = voxels * voxel_m
        relative = points - place
        away = centres - place
        squares = (
            np.einsum("nk,nk->n", relative, relative)
            - 2.0 * away @ relative.T
            + np.einsum("vk,vk->v", away, away)[:, None]
        )
        excess = np.sqrt(np.maximum(squares, 0.0)) - own
        counts = np.count_nonzero((excess >= lowest_m) & (excess <= highest_m), axis=1)
        best = int(counts.argmax())
        most, total = int(counts[best]), len(points)
        peak = Peak(place, centres[best], most, most / max(total, 1))
        found.append(
            KeypointVotes(
                peaks=(peak,) if most else (),
                max_votes=most,
                ties_camera=centres[counts == most],
                evaluations=counts.size * total,
                gap=total - most,
                reason="" if most else "no voxel around the expected place has a vote",
            )
        )
    return tuple(found)
