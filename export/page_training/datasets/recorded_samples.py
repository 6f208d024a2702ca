"""The instances of the project's own recordings, BOP scenes with parts and joints, as training samples have them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from page_runtime.capture.playback import open_source
from page_runtime.part_masks import part_masks
from page_runtime.recorded import Source
from page_training.datasets.samples import LabelledInstance


def open_recording(path: Path) -> Source:
    """A recording to learn from: ValueError where it has no true poses or nobody marked the parts' visible pixels."""
    source = open_source(path)
    if not source.has_truth or not (path / "recording.json").is_file() or not (path / "mask_visib").is_dir():
        raise ValueError(
            f"{path}: expected a recording of this project with true poses and mask_visib/, got {source.format}; name "
            "the --layout of a data set of another kind"
        )
    return source


def recorded_instances(source: Source) -> Iterator[LabelledInstance]:
    """Every instance that has a region and true poses, frame by frame; all are of one identity, 0."""
    masks = part_masks(source)
    assert masks is not None, "open_recording has looked"
    for entry in source.entries:
        recorded = entry.read()
        for i, instance in enumerate(recorded.instances):
            if instance.region is None or instance.truths is None:
                continue
            part_mask = masks.part_map(entry.index, i, recorded.frame.depth_m.shape)
            yield LabelledInstance(0, recorded.frame, instance.region, part_mask, instance.truths)
