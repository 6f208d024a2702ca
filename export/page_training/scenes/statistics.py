"""What a category's description says of its instances, measured on objects of its scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime.category import JointGeometry
from page_runtime.geometry import Array
from page_training.scenes.articulated import ArticulatedObject

# Never surer than this of a joint's place, in diagonals of its parts, and of relative sizes.
LEAST_SIGMA = 0.003
LEAST_SIZE_SIGMA = 0.005
# A diagonal outside of what was measured by this factor is still plausible.
DIAGONAL_MARGIN = 1.35


@dataclass(frozen=True, eq=False, slots=True)
class PartStatistics:
    """extents_unit: (3,) mean extents over their diagonal. diagonal_range_m: plausible diagonals."""

    extents_unit: Array
    diagonal_range_m: tuple[float, float]


def part_statistics(objects: Sequence[ArticulatedObject], part: int) -> PartStatistics:
    """Of one part over objects of a category."""
    extents = np.array([item.parts[part].extents_m for item in objects])
    diagonals = np.linalg.norm(extents, axis=1)
    mean = (extents / diagonals[:, None]).mean(axis=0)
    low, high = float(diagonals.min()), float(diagonals.max())
    return PartStatistics(mean / np.linalg.norm(mean), (low / DIAGONAL_MARGIN, high * DIAGONAL_MARGIN))


def joint_geometry(objects: Sequence[ArticulatedObject], joint: int) -> JointGeometry:
    """Where one joint is on either part, and how sure that is, over objects of a category."""
    sides, sigmas, diagonals = [], [], []
    for child in (False, True):
        fractions, shares = [], []
        for item in objects:
            model = item.joints[joint]
            extents = item.parts[_end(item, joint, child=child)].extents_m
            fractions.append((model.pivot_child if child else model.pivot_parent) / extents)
            shares.append(extents / np.linalg.norm(extents))
        diagonals.append([np.linalg.norm(item.parts[_end(item, joint, child=child)].extents_m) for item in objects])
        spread = np.std(fractions, axis=0) * np.mean(shares, axis=0)
        sides.append(_triple(np.mean(fractions, axis=0)))
        sigmas.append(_triple(np.maximum(spread, LEAST_SIGMA)))
    ratios = np.log(np.array(diagonals[1]) / np.array(diagonals[0]))
    return JointGeometry(
        pivot_parent=sides[0],
        pivot_child=sides[1],
        sigma_parent=sigmas[0],
        sigma_child=sigmas[1],
        log_size_ratio=float(ratios.mean()),
        log_size_sigma=max(float(ratios.std()), LEAST_SIZE_SIGMA),
    )


def _end(item: ArticulatedObject, joint: int, *, child: bool) -> int:
    model = item.joints[joint].joint
    return model.child if child else model.parent


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
