"""Where the parts of an object can be, from one of them and the joints: for objects whose parts make no sense one by
one.

A network tells whose points are whose long before it tells how slim parts of many are turned. But on an object whose
joints and surfaces are known each further part has one unknown, its joint's state. From a part with a pose the states
of its joints are tried one after the other, outwards; every placement is judged by the points of the part that it
places, and the few best, moved onto all points so far (`chain_motion`), go on to the next joint. `chain_fit` then moves
all parts of the best once more, now that the joints give, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from page_runtime.category import Category, Joint, JointGeometry
from page_runtime.chain_motion import Link, settled
from page_runtime.pieces import Piece, Placements, misfits
from page_runtime.similarity import FloatArray, so3_exp

# Tried states: steps of a revolute joint, rad, and of a prismatic one, in diagonals of the part that slides; at most.
_STEP_RAD = 0.22
_STEP_UNIT = 0.06
_MOST_STATES = 30
# Placements that go on to the next joint, and how different they are in some part, in its diagonals.
_KEPT = 6
_DISTINCT = 0.2
# After a part without points, of which nothing but what is beyond it can tell the state: all states of the best one.
_KEPT_UNSEEN = 32
# Turns about its joints that the first part's pose is tried with.
_ROOT_TURNS = 12


def placed_from(
    category: Category, pieces: Sequence[Piece | None], root: int, starts: tuple[FloatArray, FloatArray]
) -> Placements:
    """The best placements of all parts that joints of a known place tie to part `root`, best first, from poses of that
    part: starts R (S,3,3), t (S,3). pieces: of the category's parts, None for one that is not placed; one without
    points is placed where others are beyond it.
    """
    sketches = [None if piece is None else piece.sketch() for piece in pieces]
    first = sketches[root]
    assert first is not None
    count = len(category.parts)
    R, t = _root_poses(category, root, *starts)
    state = Placements(
        np.tile(np.eye(3), (len(R), count, 1, 1)), np.zeros((len(R), count, 3)), np.full((len(R), count), np.nan)
    )
    state.R[:, root], state.t[:, root], state.misfit[:, root] = R, t, misfits(first, R, t)
    state = _best(state, sketches)
    links: list[Link] = []
    pivots: list[FloatArray] = []
    for link in _to_seen(root, _outwards(category, root), sketches):
        piece, parent = sketches[link.other], sketches[link.known]
        geometry = link.joint.geometry
        assert piece is not None
        assert parent is not None
        assert geometry is not None
        R, t = _moved(link.joint, geometry, link.known, state, (parent, piece))
        tried = R.shape[1]
        state = state.take(np.repeat(np.arange(len(state)), tried))
        state.R[:, link.other], state.t[:, link.other] = R.reshape(-1, 3, 3), t.reshape(-1, 3)
        state.misfit[:, link.other] = misfits(piece, state.R[:, link.other], state.t[:, link.other])
        links.append(link)
        pivot = geometry.pivot_parent if link.known == link.joint.parent else geometry.pivot_child
        pivots.append(np.array(pivot) * parent.extents_m)
        if piece.seen:
            state = settled(_best(state, sketches), sketches, root, links, pivots)
        else:
            state = state.take(_in_order(state)[:_KEPT_UNSEEN])
    return state.take(_in_order(state))


def with_unseen(category: Category, pieces: Sequence[Piece | None]) -> list[Piece | None]:
    """The pieces, and for parts without one that hang on others one without points, of the size that its joint gives
    it; None for those without a surface."""
    known = list(pieces)
    joints = [joint for joint in category.joints if joint.kind != "free" and joint.geometry is not None]
    for _ in joints:
        for joint in joints:
            for part, other, sign in ((joint.child, joint.parent, 1.0), (joint.parent, joint.child, -1.0)):
                neighbour, spec = known[other], category.parts[part]
                if known[part] is not None or neighbour is None or spec.template is None or joint.geometry is None:
                    continue
                if len(spec.template.points_unit):
                    size_m = neighbour.diagonal_m * float(np.exp(sign * joint.geometry.log_size_ratio))
                    keypoints = np.asarray(spec.keypoints_unit, np.float64)
                    nothing = np.zeros((0, len(keypoints)))
                    surface = spec.template.stretched(np.asarray(spec.extents_unit, np.float64))
                    known[part] = Piece(np.zeros((0, 3)), nothing, keypoints, size_m, surface)
    return known


def _outwards(category: Category, root: int) -> list[Link]:
    """Joints of a known place, each with the part that is placed before it and the one it places."""
    placed = {root}
    order: list[Link] = []
    joints = [joint for joint in category.joints if joint.kind != "free" and joint.geometry is not None]
    while True:
        ready = [joint for joint in joints if (joint.parent in placed) != (joint.child in placed)]
        if not ready:
            return order
        joint = ready[0]
        known, other = (joint.parent, joint.child) if joint.parent in placed else (joint.child, joint.parent)
        order.append(Link(joint, known, other))
        placed.add(other)


def _to_seen(root: int, links: Sequence[Link], sketches: Sequence[Piece | None]) -> list[Link]:
    """Those of the links outwards that lead to parts with points, through single parts without; what is beyond one of
    these follows it at once, before its states are forgotten."""
    seen = {k for k, piece in enumerate(sketches) if piece is not None and piece.seen}
    reached, passable = {root}, []
    for link in links:
        # Of two parts without points in a row nothing tells the states.
        if link.known in reached and sketches[link.other] is not None and {link.known, link.other} & seen:
            reached.add(link.other)
            passable.append(link)
    leading = [link for link in passable if link.other in seen or any(one.known == link.other for one in passable)]
    placed, order = {root}, []
    while leading:
        ready = [link for link in leading if link.known in placed]
        link = min(ready, key=lambda one: (one.known in seen, one.other not in seen))
        order.append(link)
        leading.remove(link)
        placed.add(link.other)
    return order


def _root_poses(category: Category, root: int, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Each pose, and it turned where it is: about its origin, in the directions of the part's joints."""
    axes = {joint.axis for joint in category.joints if root in (joint.parent, joint.child) and joint.kind == "revolute"}
    angles = np.linspace(0.0, 2.0 * np.pi, _ROOT_TURNS, endpoint=False)[1:, None]
    turns = np.concatenate([np.eye(3)[None], *(so3_exp(angles * np.array(axis)) for axis in sorted(axes))])
    return (R[:, None] @ turns).reshape(-1, 3, 3), np.repeat(t, len(turns), axis=0)


def _states(joint: Joint, diagonal_m: float) -> FloatArray:
    """What is tried of a joint."""
    low, high = joint.limits
    if joint.kind == "revolute":
        high = min(high, low + 2.0 * np.pi)
    step = _STEP_RAD if joint.kind == "revolute" else _STEP_UNIT * diagonal_m
    return np.linspace(low, high, int(np.clip(np.ceil((high - low) / step) + 1, 2, _MOST_STATES)))


def _moved(
    joint: Joint, geometry: JointGeometry, known: int, state: Placements, pieces: tuple[Piece, Piece]
) -> tuple[FloatArray, FloatArray]:
    """R (C,S,3,3), t (C,S,3) of a joint's other part in each of its S states; pieces: of the known part and of it."""
    from_parent = known == joint.parent
    parent, child = pieces if from_parent else pieces[::-1]
    at_parent, at_child = (
        np.array(geometry.pivot_parent) * parent.extents_m,
        np.array(geometry.pivot_child) * child.extents_m,
    )
    axis, states = np.array(joint.axis), _states(joint, child.diagonal_m)
    if joint.kind == "revolute":
        turns, slid = so3_exp(states[:, None] * axis), np.zeros((len(states), 3))
    else:
        turns, slid = np.tile(np.eye(3), (len(states), 1, 1)), states[:, None] * axis
    R, t = state.R[:, known, None], state.t[:, known, None]
    if from_parent:
        R_other = R @ turns
        return R_other, t + (R @ (at_parent + slid)[..., None])[..., 0] - R_other @ at_child
    R_other = R @ turns.transpose(0, 2, 1)
    return R_other, t + R[:, 0, None] @ at_child - (R_other @ (at_parent + slid)[..., None])[..., 0]


def _in_order(state: Placements) -> NDArray[np.intp]:
    """The placements, best first."""
    return np.argsort(np.nansum(state.misfit, axis=1), kind="stable")


def _best(state: Placements, sketches: Sequence[Piece | None]) -> Placements:
    """The _KEPT best placements that differ, best first."""
    left, chosen = _in_order(state), []
    sizes = np.array([1.0 if piece is None else piece.diagonal_m for piece in sketches])
    while len(left) and len(chosen) < _KEPT:
        best = left[0]
        chosen.append(best)
        apart = np.linalg.norm(state.t[left] - state.t[best], axis=2) / sizes
        turned = np.linalg.norm(state.R[left] - state.R[best], axis=(2, 3)) / np.sqrt(8.0)
        left = left[(apart + turned).max(axis=1) > _DISTINCT]
    return state.take(np.array(chosen, np.intp))
