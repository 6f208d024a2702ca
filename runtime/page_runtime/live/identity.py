"""Which object is which: one that was missing and is there again, another one, or one that two tracks follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime.camera import Camera
from page_runtime.category import Category
from page_runtime.equivalents import Renaming, nearest_renaming, poses_of, renamed_pose
from page_runtime.geometry import Array, invert
from page_runtime.live import motion as motions
from page_runtime.live.motion import Motion
from page_runtime.live.near import agreement
from page_runtime.live.result import LiveObject
from page_runtime.live.track import Track, TrackedPart
from page_runtime.pose import ArticulatedPose, NotSeen, PartPose

# Two estimates of one object farther apart than this are not both right: rad, and a part's diagonals.
SAME_ROTATION_RAD = float(np.radians(20.0))
SAME_SHARE = 0.2
# Two tracks nearer to each other than this share of a part's diagonal follow one object; stacked things are farther.
_SAME_BODY = 0.03
# How long an object goes on as it was seen to move; nobody knows where it is carried afterwards.
_COAST_S = 0.4
# The 99 % quantile of chi-square with three degrees of freedom: where a part may be, by the track's own covariance; but
# no farther than one diagonal, where the next object stands.
_PLACE_GATE = 11.3
_FARTHEST_SHARE = 1.0
# And anywhere within this share of its diagonal, where it was put down about where it stood.
_PLACE_SHARE = 0.5
# Sizes that are one: the sides' difference in diagonals, mean over the parts. Of single looks at one object 99 % agree
# to 0.15 (boxes and laptops) and 0.3 (drawers).
_SIZE_SHARE = 0.3


@dataclass(frozen=True, eq=False, slots=True)
class Match:
    """What was found as the object of a track. distance_m: of the nearest part from where it is expected. renaming:
    into the track's names."""

    distance_m: float
    renaming: Renaming


def matched(track: Track, category: Category, found: ArticulatedPose, camera: Camera, time_s: float) -> Match | None:
    """`found` as the object of `track`, which is missing, or None where it must be another one.

    It is the same if a part of it is where it may have moved meanwhile, and its parts have its sizes: other parts may
    have moved about their joints. An object that is carried away unseen, farther than that, counts as another.
    """
    expected = [None if part is None else _coasted(part, time_s) for part in track.parts]
    T_camera_parts = [None if one is None else camera.T_camera_world @ one.T_a_part for one in expected]
    renaming = nearest_renaming(category, poses_of(found), T_camera_parts)
    pairs = [
        (one, before.extents_m, part)
        for one, before, part in zip(expected, track.parts, renamed_pose(category, found, renaming).parts, strict=True)
        if one is not None and before is not None and isinstance(part, PartPose)
    ]
    if not pairs:
        return None
    if np.mean([_size_difference(extents_m, part.extents_m) for _, extents_m, part in pairs]) > _SIZE_SHARE:
        return None
    away = [_distance(one, extents_m, part, camera) for one, extents_m, part in pairs]
    nearest_m = min((distance_m for distance_m, is_within in away if is_within), default=None)
    return None if nearest_m is None else Match(nearest_m, renaming)


def _coasted(part: TrackedPart, time_s: float) -> Motion:
    """Where the part would be by its motion, which nobody knows for long."""
    began_s = part.motion.time_s
    return motions.predicted(part.motion, float(np.clip(time_s, began_s, began_s + _COAST_S)))


def _size_difference(one_m: Array, other_m: Array) -> float:
    """Of two parts' sides (3,) m, in diagonals."""
    return float(2.0 * np.linalg.norm(one_m - other_m) / (np.linalg.norm(one_m) + np.linalg.norm(other_m)))


def _distance(expected: Motion, extents_m: Array, part: PartPose, camera: Camera) -> tuple[float, bool]:
    """Metres from where the part is expected, and whether it may have come from there."""
    T_world_camera = invert(camera.T_camera_world)
    off = (T_world_camera @ part.T_camera_part)[:3, 3] - expected.T_a_part[:3, 3]
    R = T_world_camera[:3, :3]
    spread = expected.pose_covariance[3:, 3:] + R @ part.covariance[3:, 3:] @ R.T
    share = float(np.linalg.norm(off) / np.linalg.norm(extents_m))
    may_have_moved = share <= _FARTHEST_SHARE and off @ np.linalg.solve(spread, off) <= _PLACE_GATE
    return float(np.linalg.norm(off)), share <= _PLACE_SHARE or bool(may_have_moved)


def twins(category: Category, objects: Sequence[LiveObject]) -> set[int]:
    """Numbers of tracks that have come to follow the object of an older one: two bodies are not in one place."""
    kept: list[LiveObject] = []
    found: set[int] = set()
    for one in sorted(objects, key=lambda found: found.number):
        if any(_same_body(category, one.pose, other.pose) for other in kept):
            found.add(one.number)
        else:
            kept.append(one)
    return found


def _same_body(category: Category, one: ArticulatedPose, other: ArticulatedPose) -> bool:
    renamed = renamed_pose(category, one, nearest_renaming(category, poses_of(one), poses_of(other)))
    pairs = zip(renamed.parts, other.parts, strict=True)
    both = any(not isinstance(a, NotSeen) and not isinstance(b, NotSeen) for a, b in pairs)
    return both and agreement(renamed.parts, other.parts, rotation_rad=SAME_ROTATION_RAD, share=_SAME_BODY)
