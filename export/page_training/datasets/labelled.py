"""The instances of a data set with what a training sample needs: picture, region, part masks and true poses.

One form for annotated data sets, BOP scenes and the project's own recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from page_runtime.capture.playback import open_source
from page_runtime.category import Category
from page_runtime.frame import RgbdFrame
from page_runtime.part_masks import PartMasks, part_masks
from page_runtime.recorded import PartTruth, Source
from page_runtime.sampling import Region
from page_training.datasets.annotated import Annotated, read_annotated
from page_training.datasets.bop_parts import in_order_of, read_bop_parts
from page_training.datasets.layout import BopLayout, Layout, read_layout, require_dataset_folder, unverified
from page_training.datasets.posed import frames_of, of_category, posed_source
from page_training.datasets.truth_checks import faults_of


@dataclass(frozen=True, eq=False, slots=True)
class LabelledInstance:
    """One object in one picture. part_mask: (H,W) uint8, 0 background, k + 1 part k. truths: of all parts, in the
    category's order and frames."""

    frame: RgbdFrame
    region: Region
    part_mask: NDArray[np.uint8]
    truths: tuple[PartTruth, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Labelled:
    """A data set to learn from, or to compare poses with. source: with true poses. instances: begins to read those with
    masks; a ValueError where nobody marked the parts. notes: what the user should know of it, sentences."""

    source: Source
    instances: Callable[[], Iterator[LabelledInstance]]
    notes: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Of the instances there are."""
        return sum(len(entry.instances) for entry in self.source.entries)


def open_labelled(
    path: Path,
    layout_name: str | None,
    category: Category,
    *,
    objects: Sequence[int] = (),
    without: Sequence[int] = (),
) -> Labelled:
    """The data set at `path`; without a layout one that `page-runtime` plays with true poses.

    objects: only these of its objects, by their number, if any; without: all but these. ValueError for another
    category, an unknown object or layout, where there is nothing with true poses, and where most of these cannot be of
    the category.
    """
    layout = None if layout_name is None else read_layout(layout_name)
    if layout is not None:
        require_dataset_folder(path)
    if not isinstance(layout, Layout) and (objects or without):
        raise ValueError("--objects, --without: expected a --layout that tells objects apart, got none")
    if layout is None:
        labelled = _played(path)
    elif isinstance(layout, BopLayout):
        labelled = _recorded(*read_bop_parts(path, in_order_of(layout, category)))
    else:
        labelled = _annotated(read_annotated(path, layout), category, objects, without)
    if labelled.source.category != category.name:
        raise ValueError(
            f"{path}: expected objects of the category {category.name!r}, got {labelled.source.category!r}"
        )
    _require_plausible(labelled.source, category)
    if layout is None or layout.verified:
        return labelled
    return replace(labelled, notes=(unverified(layout), *labelled.notes))


def _require_plausible(source: Source, category: Category) -> None:
    """ValueError where the true poses of most objects contradict the category: part frames of another convention would
    spoil a training, and make every comparison wrong, without a word."""
    truths = [one.truths for entry in source.entries for one in entry.instances if one.truths]
    wrong = [faults.errors[0] for one in truths if (faults := faults_of(category, one)).errors]
    if len(wrong) > 0.5 * len(truths):
        raise ValueError(
            f"{source.path}: {len(wrong)} of {len(truths)} objects cannot be of the category {category.name!r} "
            f"({wrong[0]}); page-train doctor says more, and which axes would fit"
        )


def _played(path: Path) -> Labelled:
    source = open_source(path)
    if not source.has_truth:
        raise ValueError(
            f"{path}: expected a recording of this project with true poses, got {source.format}; name the --layout of "
            "a data set of another kind"
        )
    return _recorded(source, part_masks(source))


def _recorded(source: Source, masks: PartMasks | None) -> Labelled:
    def instances() -> Iterator[LabelledInstance]:
        if masks is None:
            raise ValueError(
                f"{source.path}: expected a recording of this project with mask_visib/, the parts' visible pixels, got "
                f"{source.format} without; name the --layout of a data set of another kind"
            )
        return _recorded_instances(source, masks)

    if not source.has_truth:
        raise ValueError(f"{source.path}: expected true poses, got {source.format} that has none of these parts")
    return Labelled(source, instances)


def _recorded_instances(source: Source, masks: PartMasks) -> Iterator[LabelledInstance]:
    for entry in source.entries:
        recorded = entry.read()
        for i, instance in enumerate(recorded.instances):
            if instance.region is None or instance.truths is None:
                continue
            part_mask = masks.part_map(entry.index, i, recorded.frame.depth_m.shape)
            yield LabelledInstance(recorded.frame, instance.region, part_mask, instance.truths)


def _annotated(annotated: Annotated, category: Category, objects: Sequence[int], without: Sequence[int]) -> Labelled:
    frames = frames_of(annotated, category.name)
    shown = of_category(annotated, frames)
    chosen = only_objects(shown, chosen_objects(objects_of(shown), objects, without))
    source = posed_source(chosen, category, frames)
    notes = ()
    if annotated.problems:
        left_out = f"{len(annotated.problems)} pictures cannot be read and are left out"
        notes = (f"{left_out}, the first: {annotated.problems[0]}; page-train doctor names all of them",)
    order = [[part.part for part in frames.parts].index(part.name) for part in category.parts]
    return Labelled(source, lambda: _annotated_instances(chosen, source, order), notes)


def _annotated_instances(annotated: Annotated, source: Source, order: Sequence[int]) -> Iterator[LabelledInstance]:
    """order: of each part of the category, its place among the links."""
    first_link = annotated.layout.first_link
    for annotation, entry in zip(annotated.frames, source.entries, strict=True):
        recorded = entry.read()
        for i, (instance, truth) in enumerate(zip(annotation.instances, recorded.instances, strict=True)):
            assert truth.region is not None
            assert truth.truths is not None
            part_mask = np.zeros(recorded.frame.depth_m.shape, np.uint8)
            for n, link in enumerate(instance.links):
                if link.identity - first_link in order:
                    marked = annotation.mask(i, n, first_link)
                    if annotation.label_path is not None:
                        # Pictures of part indices say nothing where there is no depth.
                        marked &= recorded.frame.depth_m > 0
                    part_mask[marked] = order.index(link.identity - first_link) + 1
            yield LabelledInstance(recorded.frame, truth.region, part_mask, truth.truths)


def objects_of(annotated: Annotated) -> dict[int, int]:
    """How many instances of each object are in the pictures, by the object's number."""
    counts: dict[int, int] = {}
    for frame in annotated.frames:
        for instance in frame.instances:
            counts[instance.model] = counts.get(instance.model, 0) + 1
    return counts


def chosen_objects(known: Collection[int], objects: Sequence[int], without: Sequence[int]) -> set[int]:
    """The objects asked for; ValueError for one that is not known, and if none is left."""
    unknown = sorted({*objects, *without} - set(known))
    if unknown:
        raise ValueError(f"--objects, --without: expected objects among {sorted(known)}, got {unknown}")
    chosen = (set(objects) or set(known)) - set(without)
    if not chosen:
        raise ValueError(f"--without: expected to leave some of {sorted(known)}, got none")
    return chosen


def only_objects(annotated: Annotated, objects: Collection[int]) -> Annotated:
    """The data set with the instances of these objects alone, without the pictures that show none."""
    frames = tuple(
        replace(frame, instances=tuple(one for one in frame.instances if one.model in objects))
        for frame in annotated.frames
    )
    return replace(annotated, frames=tuple(frame for frame in frames if frame.instances))
