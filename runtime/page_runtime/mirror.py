"""A second opinion: the same object in a mirror.

A network trained on mirror images as well (the bundle says so) has two answers for every frame, and where the first is
wrong the second often is not: it makes its mistakes by other pixels. The mirror reverses x of the camera; what it shows
is an object of the same category, x of whose part frames is reversed too, so that T' = F T F with F = diag(-1, 1, 1).
Joint states stay as they are: a hinge along x turns by the same angle, what slides does so along y or z.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from page_runtime.camera import Camera
from page_runtime.category import Category
from page_runtime.geometry import Array, apply
from page_runtime.pose import ArticulatedPose, NotSeen, PartPose
from page_runtime.sampling import RegionSample

MIRROR = np.array([-1.0, 1.0, 1.0])
# A rotation vector is an axial one: of it the mirror reverses the other two.
_TWIST = np.concatenate([-MIRROR, MIRROR])


def mirrored_sample(sample: RegionSample) -> RegionSample:
    """The sample as the mirror shows it; point i stays point i. Its camera has no place in the world."""
    size = sample.image.shape[1]
    pixels = sample.pixels.copy()
    pixels[:, 0] = (size - 1) - pixels[:, 0]
    K = sample.camera.K.copy()
    K[0, 1:] = -K[0, 1], (size - 1) - K[0, 2]
    flip = MIRROR.astype(sample.points_camera.dtype)
    return replace(
        sample,
        image=np.ascontiguousarray(sample.image[:, ::-1]),
        points_camera=sample.points_camera * flip,
        pixels=pixels,
        center_camera=sample.center_camera * flip,
        camera=Camera(K, sample.camera.width, sample.camera.height),
    )


def mirrored_pose(pose: ArticulatedPose, category: Category) -> ArticulatedPose:
    """What is before the mirror, of the pose of its image (and the other way round)."""
    parts = tuple(
        part if isinstance(part, NotSeen) else _mirrored_part(part, spec.keypoints_unit)
        for part, spec in zip(pose.parts, category.parts, strict=True)
    )
    return replace(pose, parts=parts)


def _mirrored_part(part: PartPose, keypoints_unit: Array) -> PartPose:
    T_camera_part = part.T_camera_part.copy()
    T_camera_part[:3, :3] *= np.outer(MIRROR, MIRROR)
    T_camera_part[:3, 3] *= MIRROR
    return replace(
        part,
        T_camera_part=T_camera_part,
        keypoints_camera=apply(T_camera_part, float(np.linalg.norm(part.extents_m)) * keypoints_unit),
        covariance=part.covariance * np.outer(_TWIST, _TWIST),
    )
