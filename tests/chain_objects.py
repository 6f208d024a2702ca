"""A chain of bars on exact joints, and what can be seen of each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from page_runtime.category import Category, Joint, JointGeometry, JointKind, Part
from page_runtime.chain_fit import WholePose
from page_runtime.geometry import rotation_about, rotation_angle, transform_from
from page_runtime.pieces import Piece
from page_runtime.similarity import FloatArray as Array
from page_runtime.similarity import Similarities, so3_exp
from page_runtime.template import Template
from synthetic_parts import box_template

KEYPOINTS = 0.35 * np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1], [0.0, 0, 1.5], [0, 0, -1.5]])
PIVOTS = ((0.0, 0.0, 0.45), (0.0, 0.0, -0.45))
SIGMA = (0.002, 0.002, 0.002)
AXES = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
STATES = (0.9, -0.8, 1.1)


def shape() -> tuple[Template, float]:
    """A bar with a bump on one end of one side, so that no turn leaves it as it is; and its diagonal."""
    bar, bump = (box_template(np.array(size)) for size in ((0.08, 0.06, 0.24), (0.05, 0.06, 0.07)))
    points = np.concatenate([bar.points_unit, bump.points_unit + np.array([0.0, 0.06, 0.08])])
    normals = np.concatenate([bar.normals_unit, bump.normals_unit])
    low, high = points.min(axis=0), points.max(axis=0)
    diagonal_m = float(np.linalg.norm(high - low))
    return Template((points - (low + high) / 2) / diagonal_m, normals, (high - low) / diagonal_m), diagonal_m


TEMPLATE, DIAGONAL_M = shape()


def chain_of(kinds: tuple[JointKind, ...]) -> Category:
    part = Part("0", "", KEYPOINTS, TEMPLATE.extents_unit, (0.1, 1.0), TEMPLATE)
    geometry = JointGeometry(*PIVOTS, SIGMA, SIGMA, 0.0, 0.01)
    return Category(
        name="chain",
        parts=tuple(replace(part, name=str(k)) for k in range(len(kinds) + 1)),
        joints=tuple(
            Joint(f"j{k}", k, k + 1, kind, AXES[k % 2], (-2.0, 2.0) if kind == "revolute" else (0.0, 0.12), geometry)
            for k, kind in enumerate(kinds)
        ),
        num_voted=3,
        region_radius_m=1.0,
    )


def posed(category: Category, states: tuple[float, ...], T_camera_root: Array) -> list[Array]:
    T = [T_camera_root]
    extents_m = DIAGONAL_M * TEMPLATE.extents_unit
    for joint, state in zip(category.joints, states, strict=False):
        axis = np.array(joint.axis)
        turn = rotation_about(axis, state) if joint.kind == "revolute" else np.eye(3)
        shift = state * axis if joint.kind == "prismatic" else np.zeros(3)
        parent, child = (np.array(pivot) * extents_m for pivot in PIVOTS)
        T.append(T[-1] @ transform_from(turn, parent + shift - turn @ child))
    return T


def root_pose(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    T = transform_from(so3_exp(rng.normal(size=(1, 3)))[0], np.array([*rng.uniform(-0.1, 0.1, 2), 1.1]))
    return np.asarray(T, np.float64)


def piece(T: Array, seed: int = 0, *, told: bool = False) -> Piece:
    """What can be seen of a part, with depth noise. Its radii say where it is and, unless `told`, nothing of how it is
    turned: to its middle from everywhere."""
    rng = np.random.default_rng([seed, round(1e6 * abs(T[0, 3]))])
    points = DIAGONAL_M * TEMPLATE.points_unit @ T[:3, :3].T + T[:3, 3]
    facing = np.einsum("mk,mk->m", TEMPLATE.normals_unit @ T[:3, :3].T, points) < 0.0
    points = points[facing][rng.permutation(int(facing.sum()))[:120]] + rng.normal(scale=0.0015, size=(120, 3))
    keypoints = DIAGONAL_M * KEYPOINTS * (1.0 if told else 0.0) @ T[:3, :3].T + T[:3, 3]
    radii = np.linalg.norm(points[:, None] - keypoints, axis=2)
    return Piece(points, radii, KEYPOINTS, DIAGONAL_M, TEMPLATE)


def similarity(T: Array) -> Similarities:
    return Similarities(T[None, :3, :3], T[None, :3, 3], np.array([DIAGONAL_M]))


def errors(whole: WholePose, T: list[Array]) -> tuple[float, float]:
    """The largest, deg and mm."""
    turned = [
        np.degrees(float(rotation_angle(R, T[k][:3, :3]))) for k, R in zip(whole.parts, whole.poses.R, strict=True)
    ]
    off = [1e3 * np.linalg.norm(t - T[k][:3, 3]) for k, t in zip(whole.parts, whole.poses.t, strict=True)]
    return max(turned), float(max(off))
