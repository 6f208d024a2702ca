"""Of the descriptions of an object that look the same, the one nearest to another of it (`symmetry`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from page_runtime.articulation import unknown_reason
from page_runtime.category import Category, Joint, Part
from page_runtime.geometry import Array, apply, rotation_angle, transform_from
from page_runtime.pose import ArticulatedPose, JointState, NotSeen, PartPose
from page_runtime.recorded import PartTruth
from page_runtime.symmetry import nearest_turn, turn_of

# What less can be seen of is not asked for.
VISIBLE_SHARE = 0.1
# What counts for a part that one of two descriptions lacks: neither for nor against them.
_UNKNOWN_RAD = 0.5 * np.pi


@dataclass(frozen=True, eq=False, slots=True)
class Renaming:
    """Another description of an object that looks the same: part k is what was called part order[k], its frame turned
    by turns[k], T' = T turns[k] (K,3,3). Joint j takes the state of joint joints[j], and offsets_rad[j] on top.
    box_turns (K,3,3): what its box is turned by, which is not what a symmetric part is: that has the same box after it.
    """

    order: tuple[int, ...]
    turns: Array
    box_turns: Array
    joints: tuple[int, ...]
    offsets_rad: tuple[float, ...]

    @property
    def changes_nothing(self) -> bool:
        return self.order == tuple(range(len(self.order))) and bool((self.turns == np.eye(3)).all())


@dataclass(frozen=True, eq=False, slots=True)
class Description:
    """One way to say where the object's parts are. truths: in the order of those given. order: (K,) part k of this
    description is what the truth calls part order[k], by the category's indices."""

    truths: tuple[PartTruth, ...]
    order: tuple[int, ...]


def nearest_renaming(
    category: Category,
    described: Sequence[Array | None],
    wanted: Sequence[Array | None],
    *,
    counted: Sequence[bool] | None = None,
) -> Renaming:
    """The renaming that brings the rotations of a description nearest to those wanted.

    described, wanted: (4,4) poses of the parts, in the category's order, None for one that is not known. counted: of
    those described the ones that are asked (default: all).
    """
    counted = counted or (True,) * len(described)
    candidates = [_own(category)]
    if category.interchange is None and not any(part.symmetry for part in category.parts):
        return candidates[0]
    if category.interchange is not None:
        candidates.append(interchanged(category))
    turned = [_turned(category, one, described, wanted) for one in candidates]

    def off_rad(one: Renaming) -> float:
        total = 0.0
        for k, other in enumerate(one.order):
            T, T_wanted = described[other], wanted[k]
            if T is None or T_wanted is None or not counted[other]:
                total += _UNKNOWN_RAD
            else:
                total += float(rotation_angle(T_wanted[:3, :3], T[:3, :3] @ one.turns[k]))
        return total

    return min(turned, key=off_rad)


def _own(category: Category) -> Renaming:
    parts, joints = len(category.parts), len(category.joints)
    still = np.tile(np.eye(3), (parts, 1, 1))
    return Renaming(tuple(range(parts)), still, still, tuple(range(joints)), (0.0,) * joints)


def interchanged(category: Category) -> Renaming:
    """The parts renamed as the category allows it."""
    assert category.interchange is not None
    turns = np.tile(category.interchange.turn, (len(category.parts), 1, 1))
    joints = category.interchanged_joints
    return Renaming(category.interchange.parts, turns, turns, joints, (0.0,) * len(joints))


def _turned(
    category: Category, one: Renaming, described: Sequence[Array | None], wanted: Sequence[Array | None]
) -> Renaming:
    """Symmetric parts turned towards what is wanted, and the states of the joints about whose axes they were."""
    turns, offsets = one.turns.copy(), list(one.offsets_rad)
    for k, part in enumerate(category.parts):
        T, T_wanted = described[one.order[k]], wanted[k]
        if part.symmetry is None or T is None or T_wanted is None:
            continue
        angle = nearest_turn(part.symmetry, (T[:3, :3] @ turns[k]).T @ T_wanted[:3, :3])
        turns[k] = turns[k] @ turn_of(part.symmetry, angle)
        for index, joint in enumerate(category.joints):
            along = float(np.dot(part.symmetry.axis, joint.axis))
            if joint.kind == "revolute" and k in (joint.parent, joint.child) and abs(along) > 1.0 - 1e-6:
                offsets[index] += (1.0 if k == joint.child else -1.0) * along * angle
    return replace(one, turns=turns, offsets_rad=tuple(offsets))


def renamed_pose(category: Category, pose: ArticulatedPose, renaming: Renaming) -> ArticulatedPose:
    """The same estimate in the other words."""
    if renaming.changes_nothing:
        return pose
    parts = tuple(
        _renamed_part(pose.parts[other], spec, turn, box_turn)
        for other, spec, turn, box_turn in zip(
            renaming.order, category.parts, renaming.turns, renaming.box_turns, strict=True
        )
    )
    seen = [k for k, part in enumerate(parts) if isinstance(part, PartPose)]
    joints: list[JointState] = []
    for joint, index, offset in zip(category.joints, renaming.joints, renaming.offsets_rad, strict=True):
        state = pose.joints[index]
        value = state.value if state.value is None or not offset else _whole_turns_off(state.value + offset, joint)
        reason = state.reason and unknown_reason(joint, category, seen)
        joints.append(replace(state, name=joint.name, value=value, limits=joint.limits, reason=reason))
    return replace(pose, parts=parts, joints=tuple(joints))


def _whole_turns_off(angle_rad: float, joint: Joint) -> float:
    """The same angle, nearest to the middle of the joint's range."""
    middle = 0.5 * sum(joint.limits)
    return angle_rad - 2.0 * np.pi * round((angle_rad - middle) / (2.0 * np.pi))


def _renamed_part(part: PartPose | NotSeen, spec: Part, turn: Array, box_turn: Array) -> PartPose | NotSeen:
    return replace(part, name=spec.name) if isinstance(part, NotSeen) else turned_part(part, spec, turn, box_turn)


def turned_extents(extents: Array, turn: Array) -> Array:
    """(3,) sides of a box that looks the same in a frame turned by `turn` (3,3); its diagonal stays."""
    return np.sqrt((turn**2).T @ extents**2)


def turned_part(part: PartPose, spec: Part, turn: Array, box_turn: Array) -> PartPose:
    """The pose as that of `spec`, its frame turned: T' = T turn, and its box by `box_turn`."""
    T_camera_part = part.T_camera_part @ transform_from(turn, np.zeros(3))
    extents_m = turned_extents(part.extents_m, box_turn)
    keypoints_camera = apply(T_camera_part, float(np.linalg.norm(extents_m)) * spec.keypoints_unit)
    return replace(
        part,
        name=spec.name,
        T_camera_part=T_camera_part,
        extents_m=extents_m,
        keypoints_camera=keypoints_camera,
    )


def is_visible(truth: PartTruth) -> bool:
    """Whether the part is seen enough to be asked for."""
    return truth.visible_share is None or truth.visible_share >= VISIBLE_SHARE


def nearest_truths(category: Category, pose: ArticulatedPose, truths: Sequence[PartTruth]) -> tuple[PartTruth, ...]:
    """The truths of `nearest_description`."""
    return nearest_description(category, pose, truths).truths


def poses_of(pose: ArticulatedPose) -> list[Array | None]:
    """(4,4) of each part, None for one that has none."""
    return [part.T_camera_part if isinstance(part, PartPose) else None for part in pose.parts]


def nearest_description(category: Category, pose: ArticulatedPose, truths: Sequence[PartTruth]) -> Description:
    """Of the descriptions of the true object that look the same the one whose rotations are nearest to the estimate's,
    joint states included, in the order of `truths`."""
    by_name = {truth.name: truth for truth in truths}
    true = [by_name[part.name] for part in category.parts]
    estimates = {part.name: part.T_camera_part for part in pose.parts if isinstance(part, PartPose)}
    renaming = nearest_renaming(
        category,
        [truth.T_camera_part for truth in true],
        [estimates.get(part.name) for part in category.parts],
        counted=[is_visible(truth) for truth in true],
    )
    if renaming.changes_nothing:
        return Description(tuple(truths), renaming.order)
    state_of: dict[int, float | None] = {}
    for joint, index, offset in zip(category.joints, renaming.joints, renaming.offsets_rad, strict=True):
        state = true[category.joints[index].child].joint_state
        state_of[joint.child] = None if state is None else state + offset
    renamed = {}
    for k, (part, other) in enumerate(zip(category.parts, renaming.order, strict=True)):
        T_camera_part = true[other].T_camera_part @ transform_from(renaming.turns[k], np.zeros(3))
        renamed[part.name] = replace(
            true[other], name=part.name, T_camera_part=T_camera_part, joint_state=state_of.get(k)
        )
    return Description(tuple(renamed[truth.name] for truth in truths), renaming.order)
