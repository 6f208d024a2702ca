"""Placements of parts that joints tie together, moved onto their points without leaving the joints' axes and places.

States of joints are tried in steps, and what is left of each step turns all parts beyond it: after three joints a part
can be so far off that no state of its own fits. So the few placements that go on are moved in between, by Gauss-Newton
over the pose of the first part and the states of all joints, each part's points to the planes of their nearest samples.

A motion of a part is a screw (w, v) in camera axes: x moves by w cross x + v. That of a point along a normal n is then
w . (x cross n) + v . n, so the normal equations of a part's points are 6 x 6 whatever moves it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime.category import Joint
from page_runtime.pieces import Piece, Placements, misfits, to_samples
from page_runtime.similarity import FloatArray, skew, so3_exp

# How far off a point may be and still count fully, m and diagonals of its part.
_GATE_M = 0.01
_GATE_UNIT = 0.06
_ROUNDS = 2
# Motions are drawn towards none at all, rad and m: pairs change with the pose.
_STEP_RAD = 0.2
_STEP_M = 0.04


@dataclass(frozen=True, slots=True)
class Link:
    """A joint, the part placed before it and the one that it places."""

    joint: Joint
    known: int
    other: int


def settled(
    state: Placements, sketches: Sequence[Piece | None], root: int, links: Sequence[Link], pivots: Sequence[FloatArray]
) -> Placements:
    """The placements after a few rounds, with their misfits. links: outwards from part `root`, those that are placed;
    pivots: (3,) m of each joint in the frame of its part `known`."""
    R, t = state.R.copy(), state.t.copy()
    parts = [root, *(link.other for link in links)]
    own = [(k, piece) for k in parts if (piece := sketches[k]) is not None and piece.seen]
    beyond = _beyond(links)
    for _ in range(_ROUNDS):
        screws = _screws(R, t, root, links, pivots)
        hessian = np.tile(
            np.diag([_STEP_RAD**-2] * 3 + [_STEP_M**-2] * 3 + [_stiffness(one) for one in links]), (len(R), 1, 1)
        )
        gradient = np.zeros((len(R), hessian.shape[1]))
        for k, piece in own:
            mine = screws * np.array([1.0] * 6 + [k in far for far in beyond])
            square, pull = _normal_equations(piece, R[:, k], t[:, k])
            across = mine.transpose(0, 2, 1)
            hessian += across @ square @ mine
            gradient += (across @ pull[..., None])[..., 0]
        steps = np.linalg.solve(hessian, gradient[..., None])[..., 0]
        for index in reversed(range(len(links))):
            far = sorted(beyond[index])
            _move(R, t, far, screws[:, :, 6 + index] * steps[:, 6 + index, None])
        _move(R, t, parts, (screws[:, :, :6] @ steps[:, :6, None])[..., 0])
    misfit = state.misfit.copy()
    for k, piece in own:
        misfit[:, k] = misfits(piece, R[:, k], t[:, k])
    return Placements(R, t, misfit)


def _stiffness(link: Link) -> float:
    return (_STEP_RAD if link.joint.kind == "revolute" else _STEP_M) ** -2


def _beyond(links: Sequence[Link]) -> list[set[int]]:
    """For each link the parts that move with its state."""
    far: list[set[int]] = [{link.other} for link in links]
    for index in reversed(range(len(links))):
        for later in range(index + 1, len(links)):
            if links[later].known == links[index].other:
                far[index] |= far[later]
    return far


def _screws(R: FloatArray, t: FloatArray, root: int, links: Sequence[Link], pivots: Sequence[FloatArray]) -> FloatArray:
    """(C,6,6+J): turns about part `root`'s origin and its shifts, then each joint's motion."""
    screws = np.zeros((len(R), 6, 6 + len(links)))
    screws[:, :3, :3] = screws[:, 3:, 3:6] = np.eye(3)
    # About c: w cross (x - c), so v = -w cross c = c cross w.
    screws[:, 3:, :3] = skew(t[:, root])
    for index, (link, pivot) in enumerate(zip(links, pivots, strict=True)):
        axis = R[:, link.known] @ np.array(link.joint.axis)
        if link.joint.kind == "prismatic":
            screws[:, 3:, 6 + index] = axis
            continue
        place = t[:, link.known] + R[:, link.known] @ pivot
        screws[:, :3, 6 + index] = axis
        screws[:, 3:, 6 + index] = (skew(place) @ axis[..., None])[..., 0]
    return screws


def _normal_equations(piece: Piece, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(C,6,6) and (C,6) of the motion along their planes' normals that takes the planes to a part's points."""
    gate2 = max(_GATE_M, _GATE_UNIT * piece.diagonal_m) ** 2
    own, squares = to_samples(piece, R, t, gate2)
    nearest = squares.argmin(axis=2)
    away = own - piece.diagonal_m * piece.surface.points_unit[nearest]
    facing = piece.surface.normals_unit[nearest]
    residual = np.einsum("cnk,cnk->cn", facing, away)
    weight = 1.0 / (1.0 + np.einsum("cnk,cnk->cn", away, away) / gate2) ** 2 / gate2
    normals = facing @ R.transpose(0, 2, 1)
    motion = np.concatenate([(skew(piece.points) @ normals[..., None])[..., 0], normals], axis=2)
    weighted = (motion * weight[..., None]).transpose(0, 2, 1)
    return weighted @ motion, (weighted @ residual[..., None])[..., 0]


def _move(R: FloatArray, t: FloatArray, parts: Sequence[int], screw: FloatArray) -> None:
    """Move parts of each placement by its screw (C,6), in place: a turn about the screw's axis, or a shift."""
    turn, shift = screw[:, :3], screw[:, 3:]
    angle2 = np.maximum(np.einsum("ck,ck->c", turn, turn), 1e-18)[:, None]
    # A point of the axis, and what shifts along it.
    middle = (skew(turn) @ shift[..., None])[..., 0] / angle2
    along = np.where(angle2 > 1e-17, turn * np.einsum("ck,ck->c", turn, shift)[:, None] / angle2, shift)
    middle = np.where(angle2 > 1e-17, middle, 0.0)
    Q = so3_exp(turn)[:, None]
    R[:, parts] = Q @ R[:, parts]
    t[:, parts] = (Q @ (t[:, parts] - middle[:, None])[..., None])[..., 0] + (middle + along)[:, None]
