"""The instances of the project's own recordings, BOP scenes with parts and joints, as training samples have them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.capture.documents import read_object
from page_runtime.capture.playback import open_source
from page_runtime.image_files import SourceError
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
    described = read_object(source.path / "recording.json")["frames"]
    for entry in source.entries:
        recorded = entry.read()
        parts_of = described[str(entry.index)]["instances"]
        for i, instance in enumerate(recorded.instances):
            if instance.region is None or instance.truths is None:
                continue
            part_mask = np.zeros(recorded.frame.depth_m.shape, np.uint8)
            for k, part in enumerate(parts_of[i]["parts"]):
                part_mask[_mask(source.path, entry.index, part["gt"], part_mask.shape)] = k + 1
            yield LabelledInstance(0, recorded.frame, instance.region, part_mask, instance.truths)


def _mask(path: Path, frame: int, entry: int, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    file = path / "mask_visib" / f"{frame:06d}_{entry:06d}.png"
    mask = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    if mask is None or mask.shape != shape:
        found = "none" if mask is None else f"{mask.shape[1]}x{mask.shape[0]}"
        raise SourceError(f"{file}: expected a mask of {shape[1]}x{shape[0]} pixels, got {found}")
    return mask > 0
