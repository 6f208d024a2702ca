"""Regions from a folder of masks: a picture for each frame, in which every object is a value of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from page_runtime.image_files import SourceError
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import Region

SUFFIXES = (".png", ".bmp", ".tif", ".tiff")
# As few pixels are a speck of a segmentation, not an object.
_LEAST_PIXELS = 16


@dataclass(frozen=True, slots=True)
class MaskFolder:
    """Where the pictures of a folder are not 0: NNNNNN.png for frame N, however many zeros; the size of the frames.

    Single-channel, 8 or 16 bits; each value is an object, in the values' order. A frame without a mask has no object.
    Only an object's box counts: what of it is background is for the network to say, as everywhere.
    `opened` makes one. most: objects at a time, None for any number.
    """

    folder: Path
    files: dict[int, Path]
    most: int | None = None

    @staticmethod
    def opened(folder: Path, *, most: int | None = None) -> MaskFolder:
        """SourceError unless the folder holds pictures named by numbers, each number once."""
        if not folder.is_dir():
            raise SourceError(f"{folder}: expected a folder of masks, there is none; pass the folder, not a file in it")
        files: dict[int, Path] = {}
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() not in SUFFIXES or not (path.stem.isascii() and path.stem.isdigit()):
                continue
            index = int(path.stem)
            if index in files:
                raise SourceError(f"{folder}: {files[index].name} and {path.name} are both the mask of frame {index}")
            files[index] = path
        if not files:
            raise SourceError(
                f"{folder}: no mask found; expected pictures like 000012{SUFFIXES[0]}, one for each frame"
            )
        return MaskFolder(folder, files, most)

    def locate(self, recorded: RecordedFrame) -> Sequence[Region]:
        """The boxes of the frame's objects; SourceError for a mask that is unreadable or of another size."""
        frame = recorded.frame
        path = self.files.get(frame.index)
        if path is None:
            return ()
        mask = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if mask is None:
            raise SourceError(f"{path}: this mask cannot be read; expected a single-channel picture")
        if mask.ndim != 2 or mask.shape != frame.depth_m.shape:
            raise SourceError(
                f"{path}: expected one channel of {frame.camera.width}x{frame.camera.height}, as the frame has, got "
                f"{mask.shape[1]}x{mask.shape[0]} with {1 if mask.ndim == 2 else mask.shape[2]} channels"
            )
        regions = []
        for value in np.unique(mask[mask > 0]):
            own = mask == value
            if np.count_nonzero(own) < _LEAST_PIXELS:
                continue
            rows, columns = np.flatnonzero(own.any(axis=1)), np.flatnonzero(own.any(axis=0))
            regions.append((int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1))
        return tuple(regions)
