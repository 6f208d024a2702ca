"""Where the parts of an object can be, from one of them and the joints: for objects whose parts make no sense one by
one.

A network tells whose points are whose long before it tells how slim parts of many are turned. But on an object whose
joints and surfaces are known each further part has one unknown, its joint's state. From a part with a pose the states
of its joints are tried one after the other, outwards; every placement is judged by the points of the part that it
places, and the few best go on to the next joint. `chain_fit` then moves all parts of the best at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.category import Category, Joint, JointGeometry
from page_runtime.multilateration import thinned
from page_runtime.similarity import FloatArray, so3_exp
from page_runtime.surface_pairs import NORMAL_WEIGHT, distance_features
from page_runtime.template import Template

# Of a part, enough to tell placements apart.
_POINTS = 40
_SAMPLES = 160
# Where a point stops to tell how far off a part is: of the sensor and the network's cut, and of a diagonal.
_NEAR_M = 0.006
_NEAR_UNIT = 0.03
# Radii err in common, and say least where a part's pose is in doubt.
_RADIUS_UNIT = 0.1
_RADIUS_SHARE = 0.3
# Tried states: steps of a revolute joint, rad, and of a prismatic one, in diagonals of the part that slides; at most.
_STEP_RAD = 0.22
_STEP_UNIT = 0.06
_MOST_STATES = 30
# Placements that go on to the next joint, and how different they are in some part, in its diagonals.
_KEPT = 6
_DISTINCT = 0.2
# Turns about its joints that the first part's pose is tried with.
_ROOT_TURNS = 12


@dataclass(frozen=True, eq=False, slots=True)
class Piece:
    """What a part is placed by. points (m,3) m, camera; radii_m (m,n) to keypoints_unit (n,3); diagonal_m, and surface,
    stretched to its box."""

    points: FloatArray
    radii_m: FloatArray
    keypoints_unit: FloatArray
    diagonal_m: float
    surface: Template

    @property
    def extents_m(self) -> FloatArray:
        return self.diagonal_m * self.surface.extents_unit

    def sketch(self) -> Piece:
        """With as many points and samples as tell placements apart."""
        some = thinned(len(self.points), _POINTS)
        few = thinned(len(self.surface.points_unit), _SAMPLES)
        surface = Template(self.surface.points_unit[few], self.surface.normals_unit[few], self.surface.extents_unit)
        return replace(self, points=self.points[some], radii_m=self.radii_m[some], surface=surface)


@dataclass(frozen=True, eq=False, slots=True)
class Placements:
    """C ways to place the K parts. R (C,K,3,3), t (C,K,3) m; misfit (C,K) of each part, NaN where it is not placed."""

    R: FloatArray
    t: FloatArray
    misfit: FloatArray

    def __len__(self) -> int:
        return len(self.R)

    def take(self, chosen: NDArray[np.intp]) -> Placements:
        return Placements(self.R[chosen], self.t[chosen], self.misfit[chosen])


def misfits(piece: Piece, R: FloatArray, t: FloatArray) -> FloatArray:
    """(C,) in [0, 1] of poses R (C,3,3), t (C,3): how far the part's points are from the side of its surface that faces
    the camera, and its keypoints from where the radii have them; each point counts at most 1."""
    size = piece.diagonal_m
    near2 = max(_NEAR_M, _NEAR_UNIT * size) ** 2
    places, normals = size * piece.surface.points_unit, piece.surface.normals_unit
    own = (piece.points - t[:, None]) @ R
    camera = -(t[:, None] @ R)[:, 0]
    # A point near a side that faces away is as far off as one that is only just near.
    averted = np.einsum("mk,mk->m", normals, places) - camera @ normals.T > 0.0
    penalty = np.float32((1.0 + NORMAL_WEIGHT) * near2)
    products, features = distance_features(own, places, normals)
    squares = (products.reshape(-1, products.shape[-1]) @ features).reshape(*own.shape[:2], -1)
    squares += penalty * averted[:, None]
    least = squares.min(axis=2) + np.einsum("cnk,cnk->cn", own, own)
    # Samples stand further apart than points are off their surface.
    least = np.maximum(least / (1.0 + NORMAL_WEIGHT), 0.0)
    surface = np.mean(least / (least + near2), axis=1)
    keypoints = size * piece.keypoints_unit
    reach2 = np.einsum("cnk,cnk->cn", own, own)[..., None] + np.einsum("nk,nk->n", keypoints, keypoints)
    reach = np.sqrt(np.maximum(reach2 - 2.0 * (own @ keypoints.T), 0.0))
    ratio2 = ((reach - piece.radii_m) / (_RADIUS_UNIT * size)) ** 2
    radial = np.mean(ratio2 / (1.0 + ratio2), axis=(1, 2))
    total = (1.0 - _RADIUS_SHARE) * surface + _RADIUS_SHARE * radial
    # A place that is no number fits nothing.
    return np.nan_to_num(np.asarray(total, np.float64), nan=1.0)


def placed_from(
    category: Category, pieces: Sequence[Piece | None], root: int, starts: tuple[FloatArray, FloatArray]
) -> Placements:
    """The best placements of all parts that joints of a known place tie to part `root`, best first, from poses of that
    part: starts R (S,3,3), t (S,3). pieces: of the category's parts, None for one without points, which is not placed.
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
    for joint, known, other in _outwards(category, root):
        piece, parent = sketches[other], sketches[known]
        if piece is None or parent is None or np.isnan(state.misfit[0, known]):
            continue
        assert joint.geometry is not None
        R, t = _moved(joint, joint.geometry, known, state, (parent, piece))
        tried = R.shape[1]
        state = state.take(np.repeat(np.arange(len(state)), tried))
        state.R[:, other], state.t[:, other] = R.reshape(-1, 3, 3), t.reshape(-1, 3)
        state.misfit[:, other] = misfits(piece, state.R[:, other], state.t[:, other])
        state = _best(state, sketches)
    return state


def _outwards(category: Category, root: int) -> list[tuple[Joint, int, int]]:
    """Joints of a known place, each with the part that is placed before it and the one it places."""
    placed, order = {root}, []
    joints = [joint for joint in category.joints if joint.kind != "free" and joint.geometry is not None]
    while True:
        ready = [joint for joint in joints if (joint.parent in placed) != (joint.child in placed)]
        if not ready:
            return order
        joint = ready[0]
        known, other = (joint.parent, joint.child) if joint.parent in placed else (joint.child, joint.parent)
        order.append((joint, known, other))
        placed.add(other)


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


def _best(state: Placements, sketches: Sequence[Piece | None]) -> Placements:
    """The _KEPT best placements that differ, best first."""
    total = np.nansum(state.misfit, axis=1)
    left, chosen = np.argsort(total, kind="stable"), []
    sizes = np.array([1.0 if piece is None else piece.diagonal_m for piece in sketches])
    while len(left) and len(chosen) < _KEPT:
        best = left[0]
        chosen.append(best)
        apart = np.linalg.norm(state.t[left] - state.t[best], axis=2) / sizes
        turned = np.linalg.norm(state.R[left] - state.R[best], axis=(2, 3)) / np.sqrt(8.0)
        left = left[(apart + turned).max(axis=1) > _DISTINCT]
    return state.take(np.array(chosen, np.intp))
