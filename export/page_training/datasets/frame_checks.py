"""Are the part frames that a layout gives an annotated data set the category's? If not, which axes would be?

A wrong frame spoils a training without a word: the network learns another convention. The category's joints tell: their
axes, their places on the parts' boxes, their limits, and the parts' proportions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from page_runtime.category import Category, Joint
from page_runtime.geometry import Array
from page_runtime.image_files import SourceError
from page_runtime.joints import joint_residual, joint_state, opposed
from page_runtime.recorded import PartTruth
from page_runtime.similarity import FloatArray, Similarities
from page_training.categories import category_named
from page_training.datasets.annotated import Annotated
from page_training.datasets.findings import Finding, in_places
from page_training.datasets.part_frames import ObjectFrames, PartFrame, signed_orders
from page_training.datasets.posed import of_category, truths_of
from page_training.datasets.truth_checks import Placed, check_truths

# Objects that other axes are tried on.
TRIED = 5
# Of the logarithm of a part's proportions over objects of a category.
_PROPORTION_SIGMA = 0.3
_REFUSED = 100.0
# Cosine between the axes that two parts give their joint.
_SAME_WAY = 0.9


def check_frames(dataset: Annotated) -> Iterator[Finding]:
    """Findings of the true poses that an import would take."""
    shown = {dataset.models[one.model].category for frame in dataset.frames for one in frame.instances}
    for name in sorted(shown - {one.named for one in dataset.layout.objects}):
        what = f"{name}: the layout has no [[objects]] that say how its part frames lie; it cannot be imported"
        yield Finding("warning", "frames", what)
    for frames in dataset.layout.objects:
        if frames.named in shown:
            yield from _of_category(dataset, frames)


def _of_category(dataset: Annotated, frames: ObjectFrames) -> Iterator[Finding]:
    try:
        category = category_named(frames.category)
        own = of_category(dataset, frames)
    except ValueError as error:
        yield Finding("error", "frames", str(error))
        return
    placed: list[Placed] = []
    failed = []
    for frame in own.frames:
        for i in range(len(frame.instances)):
            try:
                placed.append((frame.place(i), truths_of(own, frame, i, category, frames)))
            except SourceError as error:
                failed.append(str(error))
    if failed:
        yield Finding("error", "frames", f"{len(failed)} objects cannot be placed", in_places(failed))
    findings = list(check_truths(category, placed))
    yield from findings
    if any(one.severity == "error" for one in findings):
        axes = fitting_axes([_posed(truths, frames, category) for _, truths in placed[:: _step(placed)]], category)
        told = {part.part: part.axes for part in frames.parts}
        if any(told[part.name] != found for part, found in zip(category.parts, axes, strict=True)):
            named = ", ".join(
                f"{part.name} [{' '.join(found)}]" for part, found in zip(category.parts, axes, strict=True)
            )
            what = f"{frames.named}: joints and sizes agree best with the axes {named} in the layout's [[objects]]"
            yield Finding("warning", "frames", what)


def _step(placed: Sequence[Placed]) -> int:
    return max(1, len(placed) // TRIED)


@dataclass(frozen=True, eq=False, slots=True)
class PosedBoxes:
    """The parts of an object in the data set's own axes: R (K,3,3) to camera, centers (K,3) m, extents_m (K,3)."""

    R: FloatArray
    centers: FloatArray
    extents_m: FloatArray


def _posed(truths: tuple[PartTruth, ...], frames: ObjectFrames, category: Category) -> PosedBoxes:
    """The truths without the axes that the layout gives them."""
    given = {part.part: part.R_rest_part for part in frames.parts}
    turns = np.stack([given[part.name] for part in category.parts])
    poses = np.array([truth.T_camera_part for truth in truths], np.float64)
    extents_m = np.stack([np.abs(turn) @ truth.extents_m for turn, truth in zip(turns, truths, strict=True)])
    return PosedBoxes(poses[:, :3, :3] @ turns.transpose(0, 2, 1), poses[:, :3, 3], extents_m)


def fitting_axes(objects: Sequence[PosedBoxes], category: Category) -> list[tuple[str, ...]]:
    """For each part of the category the axes in the data set's frames that its joints and proportions fit best.

    The root's are those that the joints of its children fit best; each other part's those that fit its own joint.
    """
    signed = [PartFrame("", axes) for axes in signed_orders()]
    every = [one for one in signed if np.linalg.det(one.R_rest_part) > 0]
    turns = [one.R_rest_part for one in every]
    children: dict[int, list[Joint]] = {}
    for joint in category.joints:
        children.setdefault(joint.parent, []).append(joint)
    waiting = sorted(set(range(len(category.parts))) - {joint.child for joint in category.joints})
    chosen: dict[int, int] = {}
    for root in waiting:
        fits = [
            sum(
                min(_cost(objects, category, joint, parent, child) for child in turns)
                for joint in children.get(root, [])
            )
            for parent in turns
        ]
        chosen[root] = int(np.argmin(fits))
    while waiting:
        parent = waiting.pop()
        for joint in children.get(parent, []):
            fits = [_cost(objects, category, joint, turns[chosen[parent]], child) for child in turns]
            chosen[joint.child] = int(np.argmin(fits))
            waiting.append(joint.child)
    return [every[chosen[k]].axes for k in range(len(category.parts))]


def _cost(objects: Sequence[PosedBoxes], category: Category, joint: Joint, parent: Array, child: Array) -> float:
    """How badly the axes (3,3) of the two parts fit: variances, a median over the objects."""
    ends, turns = [joint.parent, joint.child], np.stack([parent, child])
    axes = turns @ np.array(joint.axis)
    if joint.kind != "free" and axes[0] @ axes[1] < _SAME_WAY:
        # In the data set's frame, where all parts rest, the joint has one axis: most frames need no more than this.
        return 3.0 * _REFUSED
    costs = []
    for one in objects:
        extents_m = np.abs(turns.transpose(0, 2, 1) @ one.extents_m[ends][:, :, None])[:, :, 0]
        diagonals = np.linalg.norm(extents_m, axis=1)
        pair = Similarities(one.R[ends] @ turns, one.centers[ends], diagonals)
        extents_unit = extents_m / diagonals[:, None]
        usual = np.stack([category.parts[k].extents_unit for k in ends])
        cost = float(np.minimum((np.log(extents_unit / usual) / _PROPORTION_SIGMA) ** 2, _REFUSED).sum())
        cost += float(np.minimum(joint_residual(joint, pair, extents_unit).value ** 2, _REFUSED).sum())
        state = joint_state(joint, pair, extents_unit)[0]
        slack = 0.1 * (joint.limits[1] - joint.limits[0])
        if opposed(joint, pair) or not joint.limits[0] - slack <= state <= joint.limits[1] + slack:
            cost += _REFUSED
        costs.append(cost)
    return float(np.median(costs))
