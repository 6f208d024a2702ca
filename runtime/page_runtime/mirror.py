"""A second opinion: the same object in a mirror.

A network trained on mirror images as well (the bundle says so) has two answers for every frame, and where the first is
wrong the second often is not: it makes its mistakes by other pixels. The mirror reverses x of the camera; what it shows
is an object of the same category, each part in the place of its own image (`symmetry.Mirror`), one axis of the part
frames reversed too, so that T' = M T F with M = diag(-1, 1, 1) and F the reversal of that axis. Joint states stay as
they are, or change their sign where a joint then turns the other way (`Category.mirror_joints`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from page_runtime.articulation import unknown_reason
from page_runtime.camera import Camera
from page_runtime.category import Category, Part
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


def mirror_order(category: Category) -> tuple[int, ...]:
    """For each part the one that a mirror shows in its place; a ValueError for a category whose objects a mirror shows
    as others."""
    if category.mirror is None or category.mirror_joints is None:
        raise ValueError(f"mirror: expected a category that is its own mirror image, got {category.name!r}")
    return category.mirror.order(len(category.parts))


def mirrored_pose(pose: ArticulatedPose, category: Category) -> ArticulatedPose:
    """What is before the mirror, of the pose of its image (and the other way round); a ValueError for a category whose
    objects a mirror shows as others."""
    order, images = mirror_order(category), category.mirror_joints
    assert category.mirror is not None
    assert images is not None
    reversal = category.mirror.reversal
    parts = tuple(
        replace(part, name=spec.name) if isinstance(part, NotSeen) else _mirrored_part(part, spec, reversal)
        for part, spec in zip((pose.parts[k] for k in order), category.parts, strict=True)
    )
    seen = [k for k, part in enumerate(parts) if isinstance(part, PartPose)]
    joints = tuple(
        replace(
            pose.joints[index],
            name=joint.name,
            value=_times(pose.joints[index].value, sign),
            limits=joint.limits,
            reason=pose.joints[index].reason and unknown_reason(joint, category, seen),
        )
        for joint, (index, sign) in zip(category.joints, images, strict=True)
    )
    return replace(pose, parts=parts, joints=joints)


def _times(value: float | None, sign: float) -> float | None:
    return None if value is None else sign * value


def _mirrored_part(part: PartPose, spec: Part, reversal: Array) -> PartPose:
    T_camera_part = part.T_camera_part.copy()
    T_camera_part[:3, :3] *= np.outer(MIRROR, reversal)
    T_camera_part[:3, 3] *= MIRROR
    return replace(
        part,
        name=spec.name,
        T_camera_part=T_camera_part,
        keypoints_camera=apply(T_camera_part, float(np.linalg.norm(part.extents_m)) * spec.keypoints_unit),
        covariance=part.covariance * np.outer(_TWIST, _TWIST),
    )
