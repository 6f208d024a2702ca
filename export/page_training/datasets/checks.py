"""Does an annotated data set say what its own depth shows? The traps that silently spoil a training, each by name.

Nothing is taken from a table of conventions: a hinge is one point of two parts, so the right order of axes is the one
under which both parts put it in the same place; and a part's depth lies in the part's box, so units and intrinsics that
are wrong by a factor are the ones under which it does not.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import numpy as np

from page_runtime.geometry import Array
from page_training.datasets.annotated import Annotated, AnnotatedFrame, AnnotatedInstance, ObjectModel
from page_training.datasets.annotated_checks import check_pictures
from page_training.datasets.depth_checks import MAX_FRAMES
from page_training.datasets.findings import Finding
from page_training.datasets.frame_checks import check_frames
from page_training.datasets.layout import unverified
from page_training.datasets.part_frames import signed_orders, signed_permutation

SAME_PIVOT_M = 0.003
SAME_AXIS_DEG = 1.0
# Largest over smallest singular value of a similarity, less one.
UNIFORM = 1e-3


def check_annotated(
    dataset: Annotated, on_frame: Callable[[], None] = lambda: None, most_frames: int = MAX_FRAMES
) -> list[Finding]:
    """Every finding, the checks in a fixed order; `on_frame` hears of each frame whose pictures were read, of which
    there are at most `most_frames`."""
    findings = [Finding("error", "files", problem) for problem in dataset.problems]
    if not findings:
        findings.append(Finding("fine", "files", f"{len(dataset.frames)} annotated pictures, all of them readable"))
    if not dataset.layout.verified:
        findings.append(Finding("warning", "layout", f"{unverified(dataset.layout)}; read on"))
    if not any(instance.links for _, _, instance in _every_instance(dataset)):
        return [*findings, Finding("error", "links", "not one link in any annotation: nothing more can be checked")]
    findings += [
        *_links(dataset),
        *_matrices(dataset),
        *_joints(dataset),
        *check_frames(dataset),
        *check_pictures(dataset, on_frame, most_frames),
        *_splits(dataset),
    ]
    return findings


def _every_instance(dataset: Annotated) -> Iterator[tuple[AnnotatedFrame, int, AnnotatedInstance]]:
    for frame in dataset.frames:
        for i, instance in enumerate(frame.instances):
            yield frame, i, instance


def _links(dataset: Annotated) -> Iterator[Finding]:
    """Do the links' numbers run from the layout's first over all parts of their object?"""
    first = dataset.layout.first_link
    wrong: list[str] = []
    lowest = min(link.identity for _, _, one in _every_instance(dataset) for link in one.links)
    for frame, i, instance in _every_instance(dataset):
        parts = len(dataset.models[instance.model].corners)
        if sorted(link.identity for link in instance.links) != list(range(first, first + parts)):
            wrong.append(frame.place(i))
    if not wrong:
        yield Finding("fine", "links", f"numbered from {first}, one for each part")
        return
    advice = f"; the lowest number in the data is {lowest}: first_link in the layout" if lowest != first else ""
    yield Finding(
        "error",
        "links",
        f"{len(wrong)} instances whose link_category_id do not run from {first} over all parts{advice}",
        wrong[0],
    )


def _matrices(dataset: Annotated) -> Iterator[Finding]:
    """Are the matrices similarities, and what scale do they carry?"""
    scales: list[float] = []
    uneven: list[str] = []
    for frame, i, instance in _every_instance(dataset):
        own: list[float] = []
        for link in instance.links:
            values = np.linalg.svd(link.matrix[:3, :3], compute_uv=False)
            determinant = float(np.linalg.det(link.matrix[:3, :3]))
            if np.abs(link.matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
                yield Finding("error", "matrices", "the last row is not 0 0 0 1: stored transposed?", frame.place(i))
                return
            if determinant <= 0 or values[0] / values[2] > 1 + UNIFORM:
                yield Finding(
                    "error",
                    "matrices",
                    f"not a rotation times one scale: singular values {np.round(values, 4).tolist()}, "
                    f"determinant {determinant:.4g}",
                    frame.place(i),
                )
                return
            own.append(float(np.cbrt(determinant)))
        if own and max(own) / min(own) > 1 + UNIFORM:
            uneven.append(frame.place(i))
        scales += own
    if uneven:
        yield Finding("warning", "matrices", f"{len(uneven)} objects whose parts have different scales", uneven[0])
    low, high = min(scales), max(scales)
    if high > 1 + UNIFORM or low < 1 - UNIFORM:
        yield Finding(
            "warning",
            "matrices",
            f"carry a scale of {low:.3f} to {high:.3f}: divide by cbrt(det) before taking them for rotations, and "
            "multiply the part's box by it",
        )
    else:
        yield Finding("fine", "matrices", "rigid transforms")


def _joints(dataset: Annotated) -> Iterator[Finding]:
    """Under which order of components do two parts agree on the joint between them?

    The sign of what runs along a hinge cannot be told: a hinge has no end.
    """
    orders = signed_orders()
    maps = np.array([signed_permutation(order) for order in orders])
    pivots, axes = [], []
    for _, _, instance in _every_instance(dataset):
        for distance_m, angle_deg in _joint_gaps(dataset, dataset.models[instance.model], instance, maps):
            if distance_m is not None:
                pivots.append(distance_m)
            axes.append(angle_deg)
    if not axes:
        yield Finding("warning", "joints", "no joint between two annotated parts: the order of axes stays unchecked")
        return
    stated = tuple(dataset.layout.joint_order)
    named = " ".join(stated)
    for what, gaps, limit, unit in (
        ("origin", pivots, SAME_PIVOT_M, "m"),
        ("axis", axes, SAME_AXIS_DEG, "deg"),
    ):
        if not gaps:
            continue
        medians = np.median(gaps, axis=0)
        ours, best = float(medians[orders.index(stated)]), int(np.argmin(medians))
        if ours <= limit:
            yield Finding(
                "fine", "joints", f"{what}: both parts agree to {ours:.2g} {unit} (median) in the order {named}"
            )
        elif medians[best] <= limit:
            yield Finding(
                "error",
                "joints",
                f"{what}: both parts differ by {ours:.3g} {unit} in the layout's order {named}, by {medians[best]:.2g} "
                f"in {' '.join(orders[best])}: joint_order in the layout",
            )
        else:
            yield Finding(
                "error",
                "joints",
                f"{what}: both parts differ by {ours:.3g} {unit}, by {medians[best]:.2g} in the best of all orders; "
                "the matrices do not start from the frame the joints are in",
            )


def _joint_gaps(
    dataset: Annotated, model: ObjectModel, instance: AnnotatedInstance, maps: Array
) -> Iterator[tuple[Array | None, Array]]:
    """For each joint, under every map (48,3,3): metres between its origins as the two parts place them, None for a
    prismatic joint, and degrees between its axes."""
    placed = {link.identity - dataset.layout.first_link: link.matrix for link in instance.links}
    for joint in model.joints:
        if joint.parent not in placed or joint.child not in placed or joint.kind not in ("revolute", "prismatic"):
            continue
        parent, child = placed[joint.parent], placed[joint.child]
        origins, directions = maps @ joint.origin, maps @ joint.axis
        gaps = origins @ (parent - child)[:3, :3].T + (parent - child)[:3, 3]
        one, other = (directions @ matrix[:3, :3].T for matrix in (parent, child))
        cosine = (one * other).sum(1) / np.maximum(np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1), 1e-12)
        angles = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        yield (np.linalg.norm(gaps, axis=1) if joint.kind == "revolute" else None), angles


def _splits(dataset: Annotated) -> Iterator[Finding]:
    """Do the split files name pictures that exist, no picture twice, and no object on both sides?"""
    by_name = {frame.name: frame for frame in dataset.frames}
    members: dict[str, set[str]] = {}
    for split, lines in dataset.splits.items():
        names = [line.removesuffix(".json") for line in lines]
        known = {name if name in by_name else name.rsplit("_", 1)[0] for name in names}
        missing = sorted(known - set(by_name))
        if missing:
            yield Finding(
                "error", "splits", f"{split}: {len(missing)} of {len(known)} pictures are not there", missing[0]
            )
        members[split] = known & set(by_name)
    for one, other in itertools.combinations(members, 2):
        shared = sorted(members[one] & members[other])
        if shared:
            yield Finding("error", "splits", f"{len(shared)} pictures are both in {one} and in {other}", shared[0])
        objects = [{i.model for name in members[side] for i in by_name[name].instances} for side in (one, other)]
        if objects[0] & objects[1]:
            both = sorted(objects[0] & objects[1])
            yield Finding("warning", "splits", f"objects {both} are in {one} and in {other}: split by object instead")
    if not members:
        yield Finding("warning", "splits", "no split file: split by object")
    elif all(members.values()) and len(members) == 1:
        yield Finding("fine", "splits", f"{len(next(iter(members.values())))} pictures in {next(iter(members))}")
