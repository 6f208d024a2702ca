"""Of the descriptions of an object that look the same, the one an estimate is nearest to (`symmetry`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from page_runtime.category import Category
from page_runtime.geometry import rotation_angle, transform_from
from page_runtime.pose import ArticulatedPose, PartPose
from page_runtime.recorded import PartTruth
from page_runtime.symmetry import nearest_turn, turn_of

# What less can be seen of is not asked for.
VISIBLE_SHARE = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class Description:
    """One way to say where the object's parts are. truths: in the order of those given. order: (K,) part k of this
    description is what the truth calls part order[k], by the category's indices."""

    truths: tuple[PartTruth, ...]
    order: tuple[int, ...]


def is_visible(truth: PartTruth) -> bool:
    """Whether the part is seen enough to be asked for."""
    return truth.visible_share is None or truth.visible_share >= VISIBLE_SHARE


def nearest_truths(category: Category, pose: ArticulatedPose, truths: Sequence[PartTruth]) -> tuple[PartTruth, ...]:
    """The truths of `nearest_description`."""
    return nearest_description(category, pose, truths).truths


def nearest_description(category: Category, pose: ArticulatedPose, truths: Sequence[PartTruth]) -> Description:
    """Of the descriptions of the true object that look the same the one whose rotations are nearest to the estimate's,
    joint states included, in the order of `truths`."""
    own = tuple(range(len(category.parts)))
    if category.interchange is None and not any(part.symmetry for part in category.parts):
        return Description(tuple(truths), own)
    estimates = {part.name: part for part in pose.parts if isinstance(part, PartPose)}
    true = {truth.name: truth for truth in truths}
    described = [(true, own)]
    if category.interchange is not None:
        described.append((_interchanged(category, true), category.interchange.parts))
    turned = [(_turned(category, one, estimates), order) for one, order in described]
    best, order = min(turned, key=lambda one: sum(
        float(rotation_angle(estimates[name].T_camera_part[:3, :3], truth.T_camera_part[:3, :3]))
        for name, truth in one[0].items() if name in estimates and is_visible(truth)
    ))  # fmt: skip
    return Description(tuple(best[truth.name] for truth in truths), order)


def _interchanged(category: Category, truths: dict[str, PartTruth]) -> dict[str, PartTruth]:
    """The same object with its parts renamed."""
    assert category.interchange is not None
    turn = transform_from(category.interchange.turn, np.zeros(3))
    states = {
        category.joints[own].child: truths[category.parts[category.joints[other].child].name].joint_state
        for own, other in enumerate(category.interchanged_joints)
    }
    renamed = {}
    for k, part in enumerate(category.parts):
        other = truths[category.parts[category.interchange.parts[k]].name]
        T_camera_part = other.T_camera_part @ turn
        renamed[part.name] = replace(other, name=part.name, T_camera_part=T_camera_part, joint_state=states.get(k))
    return renamed


def _turned(category: Category, truths: dict[str, PartTruth], estimates: dict[str, PartPose]) -> dict[str, PartTruth]:
    """Symmetric parts turned towards the estimate, and the states of the joints about whose axes they were."""
    turned = dict(truths)
    for k, part in enumerate(category.parts):
        if part.symmetry is None or part.name not in estimates:
            continue
        truth, T_estimate = turned[part.name], estimates[part.name].T_camera_part
        angle = nearest_turn(part.symmetry, truth.T_camera_part[:3, :3].T @ T_estimate[:3, :3])
        T = truth.T_camera_part @ transform_from(turn_of(part.symmetry, angle), np.zeros(3))
        turned[part.name] = replace(truth, T_camera_part=T)
        for joint in category.joints:
            along = float(np.dot(part.symmetry.axis, joint.axis))
            if joint.kind != "revolute" or k not in (joint.parent, joint.child) or abs(along) < 1.0 - 1e-6:
                continue
            child = category.parts[joint.child].name
            state = turned[child].joint_state
            if state is not None:
                sense = 1.0 if k == joint.child else -1.0
                turned[child] = replace(turned[child], joint_state=state + sense * along * angle)
    return turned
