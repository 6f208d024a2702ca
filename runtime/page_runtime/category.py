"""What is known of an object category before any frame is seen: its parts, their keypoints, its joints."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from page_runtime.geometry import Array
from page_runtime.symmetry import Interchange, Mirror, Symmetry
from page_runtime.template import Template

JointKind = Literal["free", "revolute", "prismatic"]
# Of keypoints, in diagonals: farther ones say nothing of a turn that their distance does not drown.
MOST_UNIT = 10.0
# Least distance of any keypoint from the line that fits them best, in diagonals: points on a line leave a turn open.
LEAST_SPREAD = 0.01
# Of objects this runtime is for: a warehouse is none.
MOST_M = 100.0
MAX_PARTS = 32


@dataclass(frozen=True, eq=False, slots=True)
class Part:
    """A rigid part. Its canonical frame has its origin at the centre of the part's box; `frame` says the axes in words.

    keypoints_unit: (n,3) in units of the part's diagonal, canonical frame; the first `Category.num_voted` are voted,
    all of them enter the pose refinement (METHOD 10, 11). extents_unit: (3,) mean extents of the category's parts
    divided by their diagonal. diagonal_range_m: smallest and largest plausible diagonal. template: the surface that the
    pose is fitted to at the end, None for a pose from radii alone. symmetry: turns that change nothing, None for none.
    """

    name: str
    frame: str
    keypoints_unit: Array
    extents_unit: Array
    diagonal_range_m: tuple[float, float]
    template: Template | None = None
    symmetry: Symmetry | None = None

    def __post_init__(self) -> None:
        keypoints = np.asarray(self.keypoints_unit, dtype=float)
        extents = np.asarray(self.extents_unit, dtype=float)
        if keypoints.ndim != 2 or keypoints.shape[1] != 3 or len(keypoints) < 3 or not np.isfinite(keypoints).all():
            raise ValueError(
                f"Part {self.name!r}.keypoints_unit: expected finite (n>=3, 3), got shape {keypoints.shape}"
            )
        *_, line = np.linalg.svd(keypoints - keypoints.mean(axis=0), full_matrices=False)
        spread = float(np.linalg.norm((keypoints - keypoints.mean(axis=0)) @ line[1:].T, axis=1).max())
        if np.abs(keypoints).max() > MOST_UNIT or spread < LEAST_SPREAD:
            raise ValueError(
                f"Part {self.name!r}.keypoints_unit: expected keypoints within {MOST_UNIT:g} diagonals and up to "
                f"{LEAST_SPREAD:g} or more off one line, got {np.abs(keypoints).max():.3g} and {spread:.3g}"
            )
        _require_printable(self.name, "a part's name")
        _require_printable(self.frame, f"Part {self.name!r}.frame")
        if extents.shape != (3,) or not ((extents > 0) & np.isfinite(extents)).all():
            raise ValueError(
                f"Part {self.name!r}.extents_unit: expected three positive numbers, got {extents.tolist()}"
            )
        low, high = self.diagonal_range_m
        if not 0 < low < high <= MOST_M:
            raise ValueError(
                f"Part {self.name!r}.diagonal_range_m: expected 0 < low < high <= {MOST_M:g}, "
                f"got {self.diagonal_range_m}"
            )
        object.__setattr__(self, "keypoints_unit", keypoints)
        object.__setattr__(self, "extents_unit", extents)


@dataclass(frozen=True, slots=True)
class JointGeometry:
    """Where a joint is on either part and how sure that is over the category's instances.

    pivot_parent, pivot_child: (3,) the joint's point at state 0, in either part's frame in fractions of its extents:
    (0, 0.5, 0) is the middle of the +y face. sigma_parent, sigma_child: (3,) standard deviations of that, in the
    part's diagonals along its axes. log_size_ratio, log_size_sigma: natural logarithm of the child's diagonal over the
    parent's, mean and standard deviation.
    """

    pivot_parent: tuple[float, float, float]
    pivot_child: tuple[float, float, float]
    sigma_parent: tuple[float, float, float]
    sigma_child: tuple[float, float, float]
    log_size_ratio: float
    log_size_sigma: float

    def __post_init__(self) -> None:
        numbers = (*self.pivot_parent, *self.pivot_child, *self.sigma_parent, *self.sigma_child)
        if not np.isfinite([*numbers, self.log_size_ratio, self.log_size_sigma]).all():
            raise ValueError("JointGeometry: expected finite numbers")
        if min(*self.sigma_parent, *self.sigma_child, self.log_size_sigma) <= 0.0:
            raise ValueError("JointGeometry: expected standard deviations > 0; give what is exact a small one, 0.001")


@dataclass(frozen=True, eq=False, slots=True)
class Joint:
    """How part `child` moves against part `parent` (indices into Category.parts).

    axis: (3,) unit vector in the parent's frame, the same in the child's at state 0; a revolute state is the angle in
    radians by the right-hand rule, a prismatic one metres along the axis. limits: (low, high) of the state. geometry:
    None when only the axis is known.
    """

    name: str
    parent: int
    child: int
    kind: JointKind
    axis: tuple[float, float, float]
    limits: tuple[float, float]
    geometry: JointGeometry | None = None

    def __post_init__(self) -> None:
        _require_printable(self.name, "a joint's name")
        if self.parent == self.child:
            raise ValueError(f"Joint {self.name!r}: expected two parts, got part {self.parent} against itself")
        if self.kind != "free" and not abs(float(np.linalg.norm(self.axis)) - 1.0) < 1e-3:
            raise ValueError(f"Joint {self.name!r}.axis: expected a unit vector, got {self.axis}")
        low, high = self.limits
        if not (np.isfinite(self.limits).all() and low <= high):
            raise ValueError(f"Joint {self.name!r}.limits: expected finite low <= high, got {self.limits}")


@dataclass(frozen=True, eq=False, slots=True)
class Category:
    """A category of articulated objects; network class k is parts[k], the last class is background.

    num_voted: how many leading keypoints of every part are voted. region_radius_m: points farther than this from the
    region's centre cannot belong to the object. mirror: how its objects look in a mirror, None where a mirror shows
    objects of another kind. interchange: parts that cannot be told from each other, None where all can. focused:
    whether its objects are so thin that points are taken again where a first look saw them (`focus`).
    """

    name: str
    parts: tuple[Part, ...]
    joints: tuple[Joint, ...]
    num_voted: int
    region_radius_m: float
    mirror: Mirror | None = field(default_factory=Mirror)
    interchange: Interchange | None = None
    focused: bool = False

    def __post_init__(self) -> None:
        if not 1 <= len(self.parts) <= MAX_PARTS:
            raise ValueError(f"Category {self.name!r}: expected 1 to {MAX_PARTS} parts, got {len(self.parts)}")
        _require_printable(self.name, "a category's name")
        if len({part.name for part in self.parts}) != len(self.parts):
            raise ValueError(
                f"Category {self.name!r}: expected a name for each part, got {[part.name for part in self.parts]}"
            )
        if not 0 < self.region_radius_m < MOST_M:
            raise ValueError(f"Category {self.name!r}: expected region_radius_m in metres, got {self.region_radius_m}")
        counts = {len(part.keypoints_unit) for part in self.parts}
        if len(counts) != 1 or not 3 <= self.num_voted <= min(counts):
            raise ValueError(
                f"Category {self.name!r}: expected as many keypoints in every part and 3 <= num_voted <= that, "
                f"got {sorted(counts)} keypoints and num_voted {self.num_voted}"
            )
        if len({joint.name for joint in self.joints}) != len(self.joints):
            raise ValueError(
                f"Category {self.name!r}: expected a name for each joint, got {[joint.name for joint in self.joints]}"
            )
        for joint in self.joints:
            if not {joint.parent, joint.child} <= set(range(len(self.parts))):
                raise ValueError(f"Joint {joint.name!r}: {joint.parent} or {joint.child} is no part index")
        _require_tree(self.name, self.joints)
        for name, one in (("mirror", self.mirror), ("interchange", self.interchange)):
            if one is not None and len(one.parts) not in (0, len(self.parts)):
                raise ValueError(f"Category {self.name!r}.{name}: expected {len(self.parts)} parts, got {one.parts}")
        if self.interchange is not None:
            _ = self.interchanged_joints

    @property
    def num_keypoints(self) -> int:
        """Keypoints of every part, voted or not."""
        return len(self.parts[0].keypoints_unit)

    @property
    def mirror_joints(self) -> tuple[tuple[int, float], ...] | None:
        """For each joint the one that a mirror shows in its place, and 1 or -1, what its state is multiplied by; None
        where what a mirror shows is not of the category.

        A reflection F of the part frames makes of a turn by q about a one by q about -F a, of a slide along a one along
        F a (`mirror`).
        """
        if self.mirror is None:
            return None
        order, reversal = self.mirror.order(len(self.parts)), self.mirror.reversal
        found = [
            _joint_like(
                self.joints,
                (order[joint.parent], order[joint.child]),
                joint.kind,
                np.array(joint.axis) * (-reversal if joint.kind == "revolute" else reversal),
                joint.limits,
            )
            for joint in self.joints
        ]
        known = tuple(one for one in found if one is not None)
        return known if len(known) == len(found) else None

    @property
    def joints_mirror(self) -> bool:
        """Whether what a mirror shows of an object is one of the category."""
        return self.mirror_joints is not None

    @property
    def interchanged_joints(self) -> tuple[int, ...]:
        """For each joint the one that takes its place when the parts are renamed (`interchange`); a ValueError where
        the joints do not allow that."""
        assert self.interchange is not None
        order, turn, found = self.interchange.parts, self.interchange.turn, []
        for joint in self.joints:
            ends, axis = (order[joint.parent], order[joint.child]), turn @ np.array(joint.axis)
            same = _joint_like(self.joints, ends, joint.kind, axis, joint.limits)
            # Seen from the other part a joint turns, or slides, the other way.
            back = _joint_like(self.joints, (ends[1], ends[0]), joint.kind, -axis, joint.limits)
            image = same or back
            if image is None or image[1] < 0.0:
                raise ValueError(
                    f"Category {self.name!r}.interchange: joint {joint.name!r} would have to move another way; "
                    "expected joints that stay what they are when the parts are renamed"
                )
            found.append(image[0])
        return tuple(found)


def _require_printable(text: str, what: str) -> None:
    """It is shown in terminals, which take commands from what is not printable."""
    if not text.isprintable():
        raise ValueError(f"{what}: expected printable characters only, got {text!r}")


def _require_tree(name: str, joints: tuple[Joint, ...]) -> None:
    """ValueError where a part has two parents, or is its own ancestor."""
    parent_of: dict[int, int] = {}
    for joint in joints:
        if joint.child in parent_of:
            raise ValueError(f"Category {name!r}: joint {joint.name!r} gives part {joint.child} a second parent")
        parent_of[joint.child] = joint.parent
    for part in parent_of:
        seen, at = {part}, parent_of[part]
        while at in parent_of and at not in seen:
            seen.add(at)
            at = parent_of[at]
        if at in seen:
            raise ValueError(f"Category {name!r}: expected joints that form a tree, got a loop through part {at}")


def _joint_like(
    joints: tuple[Joint, ...], ends: tuple[int, int], kind: JointKind, axis: Array, limits: tuple[float, float]
) -> tuple[int, float] | None:
    """Index of the joint between these parts that moves about `axis`, and 1.0, or -1.0 where the other way."""
    for index, joint in enumerate(joints):
        if (joint.parent, joint.child) != ends or joint.kind != kind:
            continue
        for sign in (1.0, -1.0):
            same_range = np.allclose(sorted(sign * limit for limit in limits), joint.limits)
            if kind == "free" or (np.allclose(joint.axis, sign * axis) and same_range):
                return index, sign
    return None
