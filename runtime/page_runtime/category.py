"""What is known of an object category before any frame is seen: its parts, their keypoints, its joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from page_runtime.geometry import Array
from page_runtime.template import Template

JointKind = Literal["free", "revolute", "prismatic"]


@dataclass(frozen=True, eq=False, slots=True)
class Part:
    """A rigid part. Its canonical frame has its origin at the centre of the part's box; `frame` says the axes in words.

    keypoints_unit: (n,3) in units of the part's diagonal, canonical frame; the first `Category.num_voted` are voted,
    all of them enter the pose refinement (METHOD 10, 11). extents_unit: (3,) mean extents of the category's parts
    divided by their diagonal. diagonal_range_m: smallest and largest plausible diagonal. template: the surface that the
    pose is fitted to at the end, None for a pose from radii alone.
    """

    name: str
    frame: str
    keypoints_unit: Array
    extents_unit: Array
    diagonal_range_m: tuple[float, float]
    template: Template | None = None

    def __post_init__(self) -> None:
        keypoints = np.asarray(self.keypoints_unit, dtype=float)
        extents = np.asarray(self.extents_unit, dtype=float)
        if keypoints.ndim != 2 or keypoints.shape[1] != 3 or len(keypoints) < 3 or not np.isfinite(keypoints).all():
            raise ValueError(
                f"Part {self.name!r}.keypoints_unit: expected finite (n>=3, 3), got shape {keypoints.shape}"
            )
        if extents.shape != (3,) or not (extents > 0).all():
            raise ValueError(
                f"Part {self.name!r}.extents_unit: expected three positive numbers, got {extents.tolist()}"
            )
        low, high = self.diagonal_range_m
        if not 0 < low < high:
            raise ValueError(
                f"Part {self.name!r}.diagonal_range_m: expected 0 < low < high, got {self.diagonal_range_m}"
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


@dataclass(frozen=True, eq=False, slots=True)
class Category:
    """A category of articulated objects; network class k is parts[k], the last class is background.

    num_voted: how many leading keypoints of every part are voted. region_radius_m: points farther than this from the
    region's centre cannot belong to the object.
    """

    name: str
    parts: tuple[Part, ...]
    joints: tuple[Joint, ...]
    num_voted: int
    region_radius_m: float

    def __post_init__(self) -> None:
        if not self.parts:
            raise ValueError(f"Category {self.name!r}: expected at least one part")
        if not 0 < self.region_radius_m < 100:
            raise ValueError(f"Category {self.name!r}: expected region_radius_m in metres, got {self.region_radius_m}")
        counts = {len(part.keypoints_unit) for part in self.parts}
        if len(counts) != 1 or not 3 <= self.num_voted <= min(counts):
            raise ValueError(
                f"Category {self.name!r}: expected as many keypoints in every part and 3 <= num_voted <= that, "
                f"got {sorted(counts)} keypoints and num_voted {self.num_voted}"
            )
        for joint in self.joints:
            if not {joint.parent, joint.child} <= set(range(len(self.parts))):
                raise ValueError(f"Joint {joint.name!r}: {joint.parent} or {joint.child} is no part index")

    @property
    def num_keypoints(self) -> int:
        """Keypoints of every part, voted or not."""
        return len(self.parts[0].keypoints_unit)

    @property
    def joints_mirror(self) -> bool:
        """Whether the joints of an object seen in a mirror, x of every part frame reversed, are those of the category
        at the same states: hinges along x, slides across it."""
        return all(
            np.allclose(joint.axis[1:], 0.0)
            if joint.kind == "revolute"
            else joint.kind == "free" or joint.axis[0] == 0.0
            for joint in self.joints
        )
