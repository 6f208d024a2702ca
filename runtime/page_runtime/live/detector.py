"""Regions from a detector: YOLO networks as Ultralytics exports them to ONNX, for detection or segmentation.

The graph takes a picture (1,3,H,W), RGB in [0,1], the frame fitted into it with grey on two sides, and gives
either (1, 4 + classes [+ mask coefficients], anchors): centre, size and a score for each class, many boxes for each
object; or, exported with its own suppression, (1, boxes, 6 [+ coefficients]): two corners, score and class. A
segmentation has the masks' prototypes (1, coefficients, h, w) as its second output. Its metadata says the classes'
names. https://docs.ultralytics.com/modes/export/ has the format.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.bundle_fields import BundleError
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import Region
from page_runtime.sessions import open_session

_GREY = 114
# Boxes of one class that share more than this of their union are of one object.
_SAME_OBJECT = 0.45
_USUAL_SIZE = (640, 640)


@dataclass(frozen=True, slots=True)
class Letterbox:
    """How a frame lies in the network's picture: pixel u of the frame is at scale (u + 0.5) - 0.5 + left."""

    scale: float
    left: int
    top: int


class Detector:
    """Regions of the objects that a detection network finds, the surest first.

    classes: names or numbers of those that count; none: all. least_score: of those that count. most: objects at a time,
    None for any number. BundleError where the file is no such network or does not know a class.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        classes: Sequence[str] = (),
        least_score: float = 0.25,
        most: int | None = None,
        threads: int = 0,
    ) -> None:
        self.path, self.least_score, self.most = Path(path), least_score, most
        self._session = open_session(self.path, threads=threads)
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        metadata = self._session.get_modelmeta().custom_metadata_map
        self.names = _names(metadata.get("names", ""))
        shape = inputs[0].shape
        if len(inputs) != 1 or len(shape) != 4 or len(outputs) not in (1, 2) or inputs[0].type != "tensor(float)":
            raise BundleError(
                f"detector {self.path}: expected one input (1,3,H,W) of float32 and one or two outputs, got "
                f"{[(value.name, value.type, value.shape) for value in inputs]} and {len(outputs)} outputs; export it "
                "with format=onnx"
            )
        self._input = inputs[0].name
        self._size = _size(shape[2:], metadata.get("imgsz", ""))
        self._classes = frozenset(_number(name, self.names, self.path) for name in classes)

    def locate(self, recorded: RecordedFrame) -> Sequence[Region]:
        """Boxes, or the boxes of masks, in the frame."""
        color = recorded.frame.color
        picture, letterbox = letterboxed(color, self._size)
        outputs = [np.asarray(value) for value in self._session.run(None, {self._input: picture})]
        prototypes = outputs[1][0] if len(outputs) == 2 else None
        found = self._found(outputs[0], 0 if prototypes is None else len(prototypes))
        regions = []
        for row in found:
            corners = row[:4]
            if prototypes is not None:
                corners = _mask_corners(prototypes, row[6:], corners, self._size)
            region = _region(corners, letterbox, color.shape[1], color.shape[0])
            if region is not None:
                regions.append(region)
        return tuple(regions)

    def _found(self, output: NDArray[np.floating], num_coefficients: int) -> NDArray[np.floating]:
        """(D, 6 + coefficients): corners in the network's picture, score, class, mask coefficients; surest first."""
        if output.ndim != 3 or len(output) != 1:
            raise BundleError(f"detector {self.path}: expected an output of one picture, (1,..,..), got {output.shape}")
        rows = output[0]
        if rows.shape[1] != 6 + num_coefficients or (self.names and rows.shape[0] == 4 + len(self.names)):
            rows = _unsuppressed(rows.T, num_coefficients)
        wanted = rows[:, 4] >= self.least_score
        if self._classes:
            wanted &= np.isin(rows[:, 5].astype(int), list(self._classes))
        rows = rows[wanted]
        if not len(rows):
            return rows
        boxes = np.concatenate([rows[:, :2], rows[:, 2:4] - rows[:, :2]], axis=1)
        kept = cv2.dnn.NMSBoxesBatched(
            boxes.tolist(), rows[:, 4].tolist(), rows[:, 5].astype(int).tolist(), self.least_score, _SAME_OBJECT
        )
        return rows[np.asarray(kept, np.intp).reshape(-1)]


def letterboxed(color: NDArray[np.uint8], size: tuple[int, int]) -> tuple[NDArray[np.float32], Letterbox]:
    """The picture (1,3,H,W) float32 in [0,1] that a frame (h,w,3) uint8 RGB makes; size: (H, W)."""
    height, width = color.shape[:2]
    scale = min(size[0] / height, size[1] / width)
    small = max(1, round(width * scale)), max(1, round(height * scale))
    left, top = (size[1] - small[0]) // 2, (size[0] - small[1]) // 2
    canvas = np.full((*size, 3), _GREY, np.uint8)
    canvas[top : top + small[1], left : left + small[0]] = cv2.resize(color, small, interpolation=cv2.INTER_LINEAR)
    picture = np.ascontiguousarray(canvas.transpose(2, 0, 1)[None], dtype=np.float32)
    return picture / np.float32(255), Letterbox(scale, left, top)


def _unsuppressed(anchors: NDArray[np.floating], num_coefficients: int) -> NDArray[np.floating]:
    """(A, 6 + coefficients) of anchors (A, 4 + classes + coefficients): corners, best score, its class, the rest."""
    num_classes = anchors.shape[1] - 4 - num_coefficients
    scores = anchors[:, 4 : 4 + num_classes]
    half = 0.5 * anchors[:, 2:4]
    corners = np.concatenate([anchors[:, :2] - half, anchors[:, :2] + half], axis=1)
    best = scores.argmax(axis=1)
    return np.concatenate([corners, scores.max(axis=1)[:, None], best[:, None], anchors[:, 4 + num_classes :]], axis=1)


def _mask_corners(
    prototypes: NDArray[np.floating],
    coefficients: NDArray[np.floating],
    corners: NDArray[np.floating],
    size: tuple[int, int],
) -> NDArray[np.floating]:
    """The box's corners drawn in to its mask, which is where the coefficients' sum of prototypes is positive."""
    mask = np.tensordot(coefficients, prototypes, axes=1) > 0.0
    scale = np.array([mask.shape[1] / size[1], mask.shape[0] / size[0]])
    first = np.maximum(np.floor(corners[:2] * scale), 0).astype(int)
    last = np.minimum(np.ceil(corners[2:] * scale), mask.shape[::-1]).astype(int)
    inside = mask[first[1] : last[1], first[0] : last[0]]
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        return corners
    low = (first + np.array([columns[0], rows[0]])) / scale
    high = (first + np.array([columns[-1], rows[-1]]) + 1) / scale
    return np.concatenate([np.maximum(low, corners[:2]), np.minimum(high, corners[2:])])


def _region(corners: NDArray[np.floating], letterbox: Letterbox, width: int, height: int) -> Region | None:
    """In the frame, as far as it is inside; None where nothing is."""
    shift = np.array([letterbox.left, letterbox.top] * 2)
    low_x, low_y, high_x, high_y = ((corners - shift) / letterbox.scale).tolist()
    x, y = max(0, round(low_x)), max(0, round(low_y))
    w, h = min(width, round(high_x)) - x, min(height, round(high_y)) - y
    return (x, y, w, h) if w > 0 and h > 0 else None


def _names(text: str) -> Mapping[int, str]:
    """The classes' names as the export writes them, a dictionary in Python's notation; none where it is none."""
    try:
        names = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return {}
    return {int(key): str(value) for key, value in names.items()} if isinstance(names, dict) else {}


def _size(shape: Sequence[object], text: str) -> tuple[int, int]:
    """(H, W) of the graph's input; where it takes any, what the export's metadata says."""
    height, width = shape
    if isinstance(height, int) and isinstance(width, int):
        return height, width
    try:
        first, second = ast.literal_eval(text)
        return int(first), int(second)
    except (ValueError, SyntaxError, TypeError):
        return _USUAL_SIZE


def _number(name: str, names: Mapping[int, str], path: Path) -> int:
    known = {value: key for key, value in names.items()}
    if name in known:
        return known[name]
    if name.isascii() and name.isdigit() and (not names or int(name) in names):
        return int(name)
    listed = ", ".join(list(known)[:20]) or "numbers only, as its metadata names none"
    raise BundleError(f"detector {path}: it knows no class {name!r}; expected of {listed}")
