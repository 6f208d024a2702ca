"""Which of a part's possible poses is the one the object's joints allow.

A part may come with two poses between which its own evidence does not decide. And a network that mistakes the front of
a part for its back is sure of a pose that is a half turn wrong: the part's box stays where it is, so nothing of the
part itself objects, but its neighbour on the hinge does. Each part's poses and their half turns are tried together, and
the cheapest combination is taken; a half turn must explain much more than it costs. What a symmetric part looks the
same after costs nothing: of a gripper's two ways to be called the same, its joint's limits may allow but one.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from page_runtime.articulation import CONTRADICTION, PartEvidence, joint_disagreement, limit_excess
from page_runtime.category import Category, Joint
from page_runtime.geometry import Array
from page_runtime.similarity import FloatArray
from page_runtime.symmetry import Symmetry, turn_of

# Costs are squared deviations: those of a joint, of at most _MOST, or a half turn's own.
_HALF_TURN = 30.0
_MOST = 400.0
# Between two poses the joints decide when they differ by this.
_MARGIN = 9.0
_MAX_COMBINATIONS = 2**16
# Of a part that looks the same after any turn, so many are tried.
_ANY_TURNS = 12
_HALF_TURNS = tuple(np.diag(signs) for signs in ((1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0)))


@dataclass(frozen=True, eq=False, slots=True)
class Settled:
    """The pose taken of one part. index: which of those given; turned: by a half turn; decided: whether the joints tell
    it from the others given (always for the only one)."""

    evidence: PartEvidence
    index: int
    turned: bool
    decided: bool


def settle(category: Category, poses: Sequence[Sequence[PartEvidence]]) -> tuple[Settled | None, ...]:
    """One of the poses given of each part, or a half turn of it. poses: for each part of the category, best first,
    empty when it has none; None for these.

    Where every part has one pose and no joint is contradicted they stay as they are, and where more than
    _MAX_COMBINATIONS would have to be compared: the joints decide nothing then.
    """
    joints = [joint for joint in category.joints if joint.kind != "free" and poses[joint.parent] and poses[joint.child]]
    first = tuple(None if not own else Settled(own[0], 0, turned=False, decided=len(own) == 1) for own in poses)
    unclear = any(len(own) > 1 for own in poses)
    contradicted = [joint for joint in joints if _contradicted(joint, poses[joint.parent][0], poses[joint.child][0])]
    if not joints or not (unclear or contradicted):
        return first
    doubtful = {k for joint in contradicted for k in (joint.parent, joint.child)}
    options = [
        _options(own, part.symmetry, with_turns=k in doubtful)
        for k, (own, part) in enumerate(zip(poses, category.parts, strict=True))
    ]
    if np.prod([max(1, len(own)) for own in options], dtype=float) > _MAX_COMBINATIONS:
        options = [own[: len(given)] for own, given in zip(options, poses, strict=True)]
    if np.prod([max(1, len(own)) for own in options], dtype=float) > _MAX_COMBINATIONS:
        return first
    total = _total_cost(joints, options)
    best = np.unravel_index(int(total.argmin()), total.shape)
    settled: list[Settled | None] = []
    for k, (own, given) in enumerate(zip(options, poses, strict=True)):
        if not own:
            settled.append(None)
            continue
        chosen = own[best[k]]
        others = [i for i, option in enumerate(own) if option.index != chosen.index]
        gap = float(np.take(total, others, axis=k).min() - total.min()) if others else np.inf
        settled.append(replace(chosen, decided=len(given) == 1 or gap >= _MARGIN))
    return tuple(settled)


def _options(own: Sequence[PartEvidence], symmetry: Symmetry | None, *, with_turns: bool) -> list[Settled]:
    """The poses given, then those that look the same, then their half turns about the part's own axes."""
    options = [Settled(evidence, index, turned=False, decided=False) for index, evidence in enumerate(own)]
    if with_turns and symmetry is not None:
        count = symmetry.fold or _ANY_TURNS
        options += [
            Settled(_turned(evidence, turn_of(symmetry, 2.0 * np.pi * k / count)), index, turned=False, decided=False)
            for index, evidence in enumerate(own)
            for k in range(1, count)
        ]
    if with_turns:
        options += [
            Settled(_turned(evidence, turn), index, turned=True, decided=False)
            for index, evidence in enumerate(own)
            for turn in _HALF_TURNS
        ]
    return options


def _turned(evidence: PartEvidence, turn: Array) -> PartEvidence:
    T = evidence.T_camera_part.copy()
    T[:3, :3] = T[:3, :3] @ turn
    return replace(evidence, T_camera_part=T)


def _total_cost(joints: Sequence[Joint], options: Sequence[Sequence[Settled]]) -> FloatArray:
    """Cost of every combination, one axis a part (of length 1 where it has no pose)."""
    counts = [max(1, len(own)) for own in options]
    total = np.zeros(counts)
    for k, own in enumerate(options):
        cost = np.array([_HALF_TURN * option.turned for option in own] or [0.0])
        total = total + cost.reshape([-1 if axis == k else 1 for axis in range(len(counts))])
    for joint in joints:
        table = np.empty((counts[joint.parent], counts[joint.child]))
        for i, j in itertools.product(*map(range, table.shape)):
            table[i, j] = _cost(joint, options[joint.parent][i], options[joint.child][j])
        if joint.parent > joint.child:
            table = table.T
        shape = [counts[k] if k in (joint.parent, joint.child) else 1 for k in range(len(counts))]
        total = total + table.reshape(shape)
    return total


def _contradicted(joint: Joint, parent: PartEvidence, child: PartEvidence) -> bool:
    return not max(joint_disagreement(joint, parent, child)[0], limit_excess(joint, parent, child)) <= CONTRADICTION


def _cost(joint: Joint, parent: Settled, child: Settled) -> float:
    """Of two poses under a joint; _MOST where they contradict it, as then neither is an explanation.

    But poses as they were given that only overstep a limit cost what they overstep it by: a lid that is told a few
    degrees more than closed is no reason to turn box and lid about.
    """
    rms, number = joint_disagreement(joint, parent.evidence, child.evidence)
    beyond = limit_excess(joint, parent.evidence, child.evidence)
    if not rms <= CONTRADICTION or (beyond > CONTRADICTION and (parent.turned or child.turned)):
        return _MOST
    return min(rms * rms * number + beyond * beyond, _MOST)
