"""Which part every pixel of a recording truly shows, where its `mask_visib` says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from page_runtime.capture.documents import read_object
from page_runtime.image_files import SourceError, read_mask
from page_runtime.recorded import Source


@dataclass(frozen=True, eq=False, slots=True)
class PartMasks:
    """The masks of a recording. entries: by frame number and instance, the number of each part's entry of scene_gt, ()
    for an instance without truth."""

    folder: Path
    entries: dict[int, tuple[tuple[int, ...], ...]]

    def known(self, frame: int, instance: int) -> bool:
        """Whether every part of this instance has a mask."""
        entries = self.entries.get(frame, ())
        own = entries[instance] if instance < len(entries) else ()
        return bool(own) and all(self._file(frame, entry).is_file() for entry in own)

    def _file(self, frame: int, entry: int) -> Path:
        return self.folder / f"{frame:06d}_{entry:06d}.png"

    def part_map(self, frame: int, instance: int, shape: Sequence[int]) -> NDArray[np.uint8]:
        """(H,W): k + 1 where part k of this instance is seen, else 0. SourceError where a mask is missing or of another
        size than `shape`."""
        found = np.zeros(tuple(shape), np.uint8)
        for k, entry in enumerate(self.entries[frame][instance]):
            file = self._file(frame, entry)
            mask = read_mask(file) if file.is_file() else None
            if mask is None or mask.shape != found.shape:
                size = "none" if mask is None else f"{mask.shape[1]}x{mask.shape[0]}"
                raise SourceError(f"{file}: expected a mask of {shape[1]}x{shape[0]} pixels, got {size}")
            found[mask] = k + 1
        return found


def part_masks(source: Source) -> PartMasks | None:
    """The masks of a page-edge recording; None for other formats and for a recording without any."""
    described, folder = source.path / "recording.json", source.path / "mask_visib"
    if not (described.is_file() and folder.is_dir()):
        return None
    frames = read_object(described)["frames"]
    # Of the frames that could be read alone: others may lack anything.
    return PartMasks(folder, {
        entry.index: tuple(
            tuple(int(part["gt"]) for part in instance.get("parts") or ())
            for instance in frames[str(entry.index)]["instances"]
        )
        for entry in source.entries
    })  # fmt: skip
