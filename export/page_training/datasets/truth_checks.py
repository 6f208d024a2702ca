"""Are true poses those of objects of their category? Sizes, joints and states, by what the category says of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime.category import Category, Joint
from page_runtime.joints import AXIS_SIGMA_RAD, joint_residual, joint_state, opposed
from page_runtime.recorded import PartTruth
from page_runtime.similarity import Similarities
from page_training.datasets.findings import Finding, in_places

# Real boxes' hinges are up to 1.6 degrees from the axis of their parts' boxes; axes that are swapped are 90 off.
SAME_AXIS_RAD = float(np.radians(3.0))
# In standard deviations over the category's scenes; real boxes stay below 5.
SAME_PLACE = 8.0
# A state is rounded when written, and limits are where a part touches.
STATE_RAD = float(np.radians(2.0))
BEYOND_LIMITS = {"revolute": float(np.radians(3.0)), "prismatic": 0.005}
# Sizes beyond the category's by this are of another unit; by less, of an unusual object.
ANOTHER_UNIT = 2.0

Placed = tuple[str, tuple[PartTruth, ...]]


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults of one object, in words without numbers, so that those of many objects are counted together."""

    errors: tuple[str, ...]
    warnings: tuple[str, ...]


def check_truths(category: Category, placed: Sequence[Placed]) -> Iterator[Finding]:
    """Findings of the truths of objects, each with the place where it is written."""
    if not placed:
        return
    named = tuple(part.name for part in category.parts)
    strange = [place for place, truths in placed if tuple(truth.name for truth in truths) != named]
    if strange:
        what = f"expected truths of the parts {', '.join(named)} of the category {category.name!r}"
        yield Finding("error", "truths", what, in_places(strange))
        return
    places: dict[tuple[str, str], list[str]] = {}
    for place, truths in placed:
        faults = faults_of(category, truths)
        for severity, words in (("error", faults.errors), ("warning", faults.warnings)):
            for one in words:
                places.setdefault((severity, one), []).append(place)
    for (severity, what), where in places.items():
        counted = f"{what}; {len(where)} of {len(placed)} objects"
        yield Finding("error" if severity == "error" else "warning", "truths", counted, in_places(where))
    if not places:
        yield Finding("fine", "truths", f"sizes, joints and states of {len(placed)} objects are those of the category")


def faults_of(category: Category, truths: Sequence[PartTruth]) -> Faults:
    """What is wrong with the truths of one object, whose parts are the category's."""
    errors, warnings = [], []
    for part, truth in zip(category.parts, truths, strict=True):
        diagonal = float(np.linalg.norm(truth.extents_m))
        low, high = part.diagonal_range_m
        if not low / ANOTHER_UNIT <= diagonal <= high * ANOTHER_UNIT:
            errors.append(f"{part.name}: its diagonal is not {low:g} to {high:g} m; is its unit another one?")
        elif not low <= diagonal <= high:
            warnings.append(f"{part.name}: its diagonal is not {low:g} to {high:g} m, what networks were trained for")
    for joint in category.joints:
        own_errors, own_warnings = _joint_faults(category, joint, truths)
        errors += own_errors
        warnings += own_warnings
    return Faults(tuple(errors), tuple(warnings))


def _joint_faults(category: Category, joint: Joint, truths: Sequence[PartTruth]) -> tuple[list[str], list[str]]:
    if joint.kind == "free":
        return [], []
    pair, extents_unit = pair_of(joint, truths)
    parent, child = (category.parts[k].name for k in (joint.parent, joint.child))
    residual = joint_residual(joint, pair, extents_unit).value
    turned_rad = float(np.linalg.norm(residual[:3]) * AXIS_SIGMA_RAD)
    if opposed(joint, pair) or turned_rad > SAME_AXIS_RAD:
        what = "direction of its axis" if joint.kind == "revolute" else "directions"
        return [f"{joint.name}: {parent} and {child} differ in the {what}; poses or part frames are wrong"], []
    warnings = []
    if len(residual) > 4 and np.linalg.norm(residual[3:-1]) > SAME_PLACE:
        where = (
            f"{joint.name}: {parent} and {child} put it in places farther apart than objects of the category have it"
        )
        warnings.append(where)
    stated = truths[joint.child].joint_state
    if stated is None:
        return [], warnings
    errors = []
    low, high = joint.limits
    slack = BEYOND_LIMITS[joint.kind]
    unit = "rad" if joint.kind == "revolute" else "m"
    if not low - slack <= stated <= high + slack:
        errors.append(f"{joint.name}: its state is out of its limits {low:.3g} to {high:.3g} {unit}")
    if abs(_state_gap(joint, pair, extents_unit, stated)) > _state_margin(joint, pair):
        errors.append(f"{joint.name}: its state is not that of the poses; one of the two is wrong")
    return errors, warnings


def pair_of(joint: Joint, truths: Sequence[PartTruth]) -> tuple[Similarities, np.ndarray]:
    """The joint's two parts as similarities by their diagonals, and their extents in these (2,3)."""
    two = [truths[joint.parent], truths[joint.child]]
    poses = np.array([truth.T_camera_part for truth in two], np.float64)
    extents_m = np.array([truth.extents_m for truth in two], np.float64)
    diagonals = np.sqrt((extents_m**2).sum(axis=1))
    extents_unit = extents_m / diagonals[:, None]
    return Similarities(poses[:, :3, :3], poses[:, :3, 3], diagonals), extents_unit


def _state_gap(joint: Joint, pair: Similarities, extents_unit: np.ndarray, stated: float) -> float:
    gap = stated - joint_state(joint, pair, extents_unit)[0]
    return float(np.remainder(gap + np.pi, 2 * np.pi) - np.pi) if joint.kind == "revolute" else gap


def _state_margin(joint: Joint, pair: Similarities) -> float:
    """rad or m: where a slide begins is known only as well as over the category's objects, not at all without that."""
    if joint.kind == "revolute":
        return STATE_RAD
    if joint.geometry is None:
        return float("inf")
    spread = np.array([joint.geometry.sigma_parent, joint.geometry.sigma_child]) * pair.s[:, None]
    return SAME_PLACE * float(np.linalg.norm(spread @ np.array(joint.axis)))
