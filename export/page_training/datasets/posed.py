"""Annotated data sets as sources with true poses: of the parts of one category, in its canonical frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from page_runtime.capture.documents import frame_numbers
from page_runtime.capture.reartmix import part_from_rest
from page_runtime.category import Category, Joint
from page_runtime.geometry import Array
from page_runtime.image_files import SourceError
from page_runtime.joints import joint_state
from page_runtime.recorded import FrameEntry, Instance, PartTruth, Source, require_playable
from page_training.datasets.annotated import Annotated, AnnotatedFrame, AnnotatedInstance
from page_training.datasets.part_frames import ObjectFrames
from page_training.datasets.truth_checks import pair_of


def frames_of(annotated: Annotated, category: str) -> ObjectFrames:
    """How the category's part frames lie in the data set's; SourceError where its layout does not say."""
    layout = annotated.layout
    for one in layout.objects:
        if one.category == category:
            return one
    known = ", ".join(one.category for one in layout.objects) or "none"
    raise SourceError(
        f"layout {layout.name}: says nothing of the part frames of {category!r}, only of {known}; add [[objects]] to a "
        "copy of the layout and name that"
    )


def of_category(annotated: Annotated, frames: ObjectFrames) -> Annotated:
    """The data set with the instances of this category alone; SourceError where it shows none."""

    def wanted(instance: AnnotatedInstance) -> bool:
        return annotated.models[instance.model].category == frames.named

    kept = tuple(
        replace(frame, instances=tuple(filter(wanted, frame.instances)))
        for frame in annotated.frames
        if any(map(wanted, frame.instances))
    )
    if not kept:
        found = sorted({model.category for model in annotated.models.values()})
        raise SourceError(
            f"{annotated.path}: expected objects of the category {frames.category!r}, named {frames.named!r} there, "
            f"got {', '.join(found)}"
        )
    return replace(annotated, frames=kept)


def posed_source(annotated: Annotated, category: Category, frames: ObjectFrames) -> Source:
    """Every picture with the true poses of its objects, which are all of the category (`of_category`)."""
    numbers = frame_numbers([frame.name for frame in annotated.frames])
    entries = tuple(
        FrameEntry(
            color_path=frame.color_path,
            depth_path=frame.depth_path,
            metres_per_unit=annotated.layout.metres_per_unit,
            camera=frame.camera,
            instances=tuple(
                Instance(one.region, truths_of(annotated, frame, i, category, frames))
                for i, one in enumerate(frame.instances)
            ),
            index=number,
        )
        for number, frame in zip(numbers, annotated.frames, strict=True)
    )
    names = tuple(part.name for part in category.parts)
    return require_playable(Source(annotated.path, f"{annotated.layout.name} folder", entries, category.name, names))


def truths_of(
    annotated: Annotated, frame: AnnotatedFrame, index: int, category: Category, frames: ObjectFrames
) -> tuple[PartTruth, ...]:
    """The parts of instance `index` of a picture, in the category's order and frames; SourceError where one is
    missing."""
    instance, where = frame.instances[index], frame.place(index)
    model = annotated.models[instance.model]
    links = {link.identity: link.matrix for link in instance.links}
    names = [part.part for part in frames.parts]
    truths, matrices = [], []
    for part in category.parts:
        if part.name not in names:
            raise SourceError(
                f"layout {annotated.layout.name}: expected axes of the part {part.name!r} of {category.name!r}, got "
                f"those of {', '.join(names)}"
            )
        k = names.index(part.name)
        matrix = links.get(k + annotated.layout.first_link)
        if matrix is None or k >= len(model.corners):
            raise SourceError(f"{where}: no link with link_category_id {k + annotated.layout.first_link} ({part.name})")
        pose, extents_m = part_from_rest(
            matrix, model.corners[k], frames.parts[k].R_rest_part, where=f"{where}, {part.name}"
        )
        try:
            truths.append(PartTruth(part.name, pose, extents_m))
        except ValueError as error:
            raise SourceError(f"{where}: {error}") from error
        matrices.append(matrix)
    return _with_states(category, truths, matrices)


def _with_states(category: Category, truths: list[PartTruth], matrices: list[Array]) -> tuple[PartTruth, ...]:
    """The truths with the states of their joints, by the poses."""
    found = list(truths)
    for joint in category.joints:
        if joint.kind == "revolute":
            state = joint_state(joint, *pair_of(joint, truths))[0]
        elif joint.kind == "prismatic":
            state = _slid_m(joint, truths, matrices)
        else:
            continue
        found[joint.child] = replace(found[joint.child], joint_state=state)
    return tuple(found)


def _slid_m(joint: Joint, truths: list[PartTruth], matrices: list[Array]) -> float:
    """How far the child has moved along the axis since the rest pose, in which both links' matrices are one."""
    parent, child = truths[joint.parent], truths[joint.child]
    T_child_rest = matrices[joint.child]
    center_rest = np.linalg.solve(T_child_rest[:3, :3], child.T_camera_part[:3, 3] - T_child_rest[:3, 3])
    at_rest = matrices[joint.parent][:3, :3] @ center_rest + matrices[joint.parent][:3, 3]
    axis_camera = parent.T_camera_part[:3, :3] @ np.array(joint.axis)
    return float(axis_camera @ (child.T_camera_part[:3, 3] - at_rest))
