"""Objects of any category as boxes on exact joints, seen by an exact camera: truth, depth and masks agree by making."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import toy
from page_runtime.category import Category, Joint
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array, apply, rotation_about, transform_from
from page_runtime.recorded import Instance, PartTruth, RecordedFrame

Masks = tuple[NDArray[np.bool_], ...]


def extents_of(category: Category) -> list[Array]:
    """(3,) m of each part: the category's mean proportions, in the proportions of its joints."""
    low, high = category.parts[0].diagonal_range_m
    diagonals = {0: float(np.sqrt(low * high))}
    for joint in category.joints:
        assert joint.geometry is not None
        diagonals[joint.child] = diagonals[joint.parent] * float(np.exp(joint.geometry.log_size_ratio))
    return [diagonals[k] * part.extents_unit for k, part in enumerate(category.parts)]


def pivots(joint: Joint, extents: list[Array]) -> tuple[Array, Array]:
    """(3,) m, the joint's point in either part's frame."""
    assert joint.geometry is not None
    return (
        np.array(joint.geometry.pivot_parent) * extents[joint.parent],
        np.array(joint.geometry.pivot_child) * extents[joint.child],
    )


def posed_object(category: Category, share: float = 0.4, yaw_rad: float = 0.5) -> tuple[PartTruth, ...]:
    """An object whose joints are at `share` of their range, before the camera of `toy` and wholly in its picture."""
    extents = extents_of(category)
    poses = {0: np.eye(4)}
    states: dict[int, float] = {}
    for joint in category.joints:
        state = joint.limits[0] + share * (joint.limits[1] - joint.limits[0])
        if joint.kind == "prismatic":
            state = share * float(extents[joint.child][1])
        turn, slide = (state, 0.0) if joint.kind == "revolute" else (0.0, state)
        R = rotation_about(np.array(joint.axis), turn)
        at_parent, at_child = pivots(joint, extents)
        moved = transform_from(R, at_parent - R @ at_child + slide * np.array(joint.axis))
        poses[joint.child] = poses[joint.parent] @ moved
        states[joint.child] = state
    signs = np.array(list(np.ndindex(2, 2, 2))) - 0.5
    corners = np.concatenate([apply(poses[k], signs * e) for k, e in enumerate(extents)])
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    radius = float(np.linalg.norm(corners - middle, axis=1).max())
    R = toy.part_poses(yaw_rad=yaw_rad)[0][:3, :3]
    place = np.array([0.15, 0.1, 3.6]) * radius
    T_camera_root = transform_from(R, place - R @ middle)
    return tuple(
        PartTruth(part.name, T_camera_root @ poses[k], extents[k], None, states.get(k))
        for k, part in enumerate(category.parts)
    )


def seen_object(truths: tuple[PartTruth, ...]) -> tuple[RecordedFrame, Masks]:
    """The object alone before a wall, with the masks of its parts (H,W)."""
    camera = toy.toy_camera()
    rows, columns = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays(np.stack([columns, rows], axis=-1).astype(float))
    depths = [toy.ray_depth(rays, truth.T_camera_part, truth.extents_m) for truth in truths]
    wall_m = 1.8 * float(truths[0].T_camera_part[2, 3])
    depth = np.min([*depths, np.full_like(depths[0], wall_m)], axis=0)
    label = np.argmin([*depths, np.full_like(depths[0], wall_m)], axis=0)
    masks = tuple(label == k for k in range(len(truths)))
    color = np.random.default_rng(0).integers(40, 220, (len(truths) + 1, 3)).astype(np.uint8)[label]
    v, u = np.nonzero(label < len(truths))
    region = int(u.min()), int(v.min()), int(np.ptp(u)) + 1, int(np.ptp(v)) + 1
    shares = [float(mask.sum() / np.isfinite(d).sum()) for mask, d in zip(masks, depths, strict=True)]
    known = tuple(
        PartTruth(t.name, t.T_camera_part, t.extents_m, share, t.joint_state)
        for t, share in zip(truths, shares, strict=True)
    )
    return RecordedFrame(RgbdFrame(color, depth.astype(np.float32), camera), (Instance(region, known),)), masks
