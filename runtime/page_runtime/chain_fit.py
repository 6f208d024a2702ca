"""All parts of an object moved at once onto their points, held together by its joints.

The Gauss-Newton step of `icp` for every part, without stretch, and the residuals of `joints` in one system: a part
that its points leave free to turn is held by its neighbours, as in `articulation`, but its points are paired anew in
each round, so that it may start far off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime.category import Category
from page_runtime.chain import placed_from, with_unseen
from page_runtime.icp import SENSOR_SIGMA_M, normal_equations
from page_runtime.joints import joint_residual, pair_columns
from page_runtime.pieces import Piece, Placements, misfits
from page_runtime.similarity import FloatArray, Similarities
from page_runtime.surface_pairs import Placed, paired

# Pairs further apart than this, in diagonals, round by round: first of a sketch of each part, then of all its points,
# until no step is longer than _SETTLED, rad and diagonals.
_DRAWN_GATES = (0.3, 0.25, 0.2, 0.16, 0.13, 0.1)
_FITTED_GATES = (0.1,) * 10
_SETTLED = 0.004
_LOG_SCALE_SIGMA = 0.03
# A round's steps are drawn towards none at all, rad and diagonals: pairs change with the pose.
_STEP_SIGMA = 0.3
_SIZE = 7
_NO_STRETCH = np.zeros(3)
# Parts that the search begins from, one after the other, and how many of its ends are drawn near their points. Of eight
# links of a half-trained network (a Panda, 50 validation frames) 15 % were within 5 degrees and 5 cm with four and two,
# 12 % with four and one; one by one it had been 5 %.
_ROOTS, _DRAWN = 4, 2


@dataclass(frozen=True, eq=False, slots=True)
class WholePose:
    """poses: of the parts in `parts`, s their diagonals; covariances (k,7,7) as in `icp`; extents_unit (k,3); misfit
    (k,) of each."""

    parts: tuple[int, ...]
    poses: Similarities
    covariances: FloatArray
    extents_unit: FloatArray
    misfit: FloatArray


def whole_pose(
    category: Category, pieces: Sequence[Piece | None], known: Mapping[int, Similarities]
) -> WholePose | None:
    """The pose of all parts with points that joints of a known place tie together, of the group of such parts that
    explains most where there are several; None where no part has a pose.

    known: poses of parts by themselves; it begins with the _ROOTS of them that have the most points.
    """
    bodies = with_unseen(category, pieces)
    roots = sorted((k for k in known if pieces[k] is not None), key=lambda k: -len(_piece(pieces, k).points))
    placed = [placed_from(category, bodies, root, (known[root].R, known[root].t)) for root in roots[:_ROOTS]]
    likely = sorted(placed, key=lambda one: _unexplained(one.misfit[0], pieces))[:_DRAWN]
    drawn = [_drawn(category, bodies, pieces, placements) for placements in likely]
    best = min(drawn, key=lambda one: one.unexplained, default=None)
    return None if best is None else _fitted(category, bodies, best)


def _unexplained(misfit: FloatArray, pieces: Sequence[Piece | None]) -> float:
    """Of all parts with points; misfit (K,), NaN where a part is not placed, which counts whole."""
    seen = np.array([piece is not None for piece in pieces])
    return float(np.where(np.isnan(misfit), 1.0, misfit)[seen].sum())


@dataclass(frozen=True, eq=False, slots=True)
class _Drawn:
    """Poses of some parts, s their diagonals, and what they leave unexplained of all."""

    parts: tuple[int, ...]
    poses: Similarities
    unexplained: float


def _drawn(
    category: Category, bodies: Sequence[Piece | None], pieces: Sequence[Piece | None], placements: Placements
) -> _Drawn:
    """The best placement, moved near its points by a sketch of each part."""
    misfit = placements.misfit[0].copy()
    parts = tuple(np.flatnonzero(~np.isnan(misfit)).tolist())
    sketches = [_piece(bodies, k).sketch() for k in parts]
    sizes = np.array([piece.diagonal_m for piece in sketches])
    start = Similarities(placements.R[0, parts], placements.t[0, parts], sizes)
    poses, _ = _moved(category, parts, sketches, start, _DRAWN_GATES)
    misfit[list(parts)] = _misfits(sketches, poses)
    return _Drawn(parts, poses, _unexplained(misfit, pieces))


def _fitted(category: Category, bodies: Sequence[Piece | None], drawn: _Drawn) -> WholePose:
    """What was drawn near, moved onto all of its points; of the parts that have some."""
    own = [_piece(bodies, k) for k in drawn.parts]
    poses, hessian = _moved(category, drawn.parts, own, drawn.poses, _FITTED_GATES)
    sizes = np.array([piece.diagonal_m for piece in own])
    # A part that nothing holds any more may be turned anyhow and be anywhere near.
    floor = np.ones((len(own), _SIZE))
    floor[:, :3], floor[:, 3:6] = np.pi**-2, sizes[:, None] ** -2
    inverse = np.asarray(np.linalg.inv(hessian + np.diag(floor.reshape(-1))), np.float64)
    seen = [i for i, piece in enumerate(own) if piece.seen]
    blocks = [slice(_SIZE * i, _SIZE * (i + 1)) for i in seen]
    shown = poses.take(np.array(seen))
    return WholePose(
        parts=tuple(drawn.parts[i] for i in seen),
        poses=shown,
        covariances=np.array([inverse[block, block] for block in blocks]),
        extents_unit=np.array([own[i].surface.extents_unit for i in seen]),
        misfit=_misfits([own[i].sketch() for i in seen], shown),
    )


def _misfits(sketches: Sequence[Piece], poses: Similarities) -> FloatArray:
    return np.array([misfits(one, poses.R[i : i + 1], poses.t[i : i + 1])[0] for i, one in enumerate(sketches)])


def _moved(
    category: Category, parts: Sequence[int], own: Sequence[Piece], poses: Similarities, gates: Sequence[float]
) -> tuple[Similarities, FloatArray]:
    """The poses after a round a gate, fewer where they settle, and the last round's Hessian."""
    sizes = np.array([piece.diagonal_m for piece in own])
    rows = {k: i for i, k in enumerate(parts)}
    joints = [joint for joint in category.joints if joint.parent in rows and joint.child in rows]
    extents = np.array([piece.surface.extents_unit for piece in own])
    restraint = np.zeros((len(own), _SIZE))
    restraint[:, :3], restraint[:, 3:6] = _STEP_SIGMA**-2, (_STEP_SIGMA * sizes[:, None]) ** -2
    hessian = np.eye(_SIZE * len(own))
    for gate in gates:
        hessian, gradient = _system(own, poses, sizes, gate)
        for joint in joints:
            pair = [rows[joint.parent], rows[joint.child]]
            residual = joint_residual(joint, poses.take(np.array(pair)), extents[pair])
            residual.add_to(hessian, gradient, pair_columns(pair))
        bounded = hessian + np.diag(restraint.reshape(-1))
        steps = np.asarray(np.linalg.solve(bounded, gradient), np.float64).reshape(-1, _SIZE)
        poses = poses.moved(-steps)
        longest = max(np.abs(steps[:, :3]).max(), (np.abs(steps[:, 3:6]) / sizes[:, None]).max())
        if gate == gates[-1] and longest <= _SETTLED:
            break
    return poses, hessian


def _system(own: Sequence[Piece], poses: Similarities, sizes: FloatArray, gate: float) -> tuple[FloatArray, FloatArray]:
    """Hessian and gradient of all points and the sizes' prior."""
    hessian, gradient = np.zeros((_SIZE * len(own),) * 2), np.zeros(_SIZE * len(own))
    for i, piece in enumerate(own):
        block = slice(_SIZE * i, _SIZE * (i + 1))
        placed = Placed(poses.take(np.array([i])), _NO_STRETCH)
        gate_m = gate * piece.diagonal_m
        pairs = paired(piece.points, placed, piece.surface, gate_m)
        if pairs is not None and len(pairs.residuals):
            by_points, pull = normal_equations(pairs, placed, gate_m, SENSOR_SIGMA_M)
            hessian[block, block], gradient[block] = by_points[:_SIZE, :_SIZE], pull[:_SIZE]
        scale = _SIZE * i + 6
        hessian[scale, scale] += _LOG_SCALE_SIGMA**-2
        gradient[scale] += np.log(poses.s[i] / sizes[i]) * _LOG_SCALE_SIGMA**-2
    return hessian, gradient


def _piece(pieces: Sequence[Piece | None], index: int) -> Piece:
    piece = pieces[index]
    assert piece is not None
    return piece
