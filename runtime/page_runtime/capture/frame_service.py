"""What runs in the child process of a live source: frames into the ring, a message for each, then how it ended."""

from __future__ import annotations

import contextlib
import pickle
import threading
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.capture.child_process import ChildEnd
from page_runtime.capture.counts import FrameCounts, whole
from page_runtime.capture.frame_ring import Depth, RingWriter, SlotContent
from page_runtime.image_files import SourceError


class DeviceUnavailable(SourceError):
    """No camera can be opened: none is attached, or another program has it."""


@dataclass(frozen=True, eq=False, slots=True)
class LiveFrame:
    """One frame in the child. color: (H,W,3) uint8 RGB. depth: (H,W) registered to colour, uint16 in units of
    metres_per_unit, or float32 metres where that is None. timestamp_s: the source's clock. skew_s: depth time minus
    colour time. counts: of the source so far, where it pairs readings; else every frame counts as one of each.
    calibration: the camera's own, as JSON text, with the first frame."""

    color: NDArray[np.uint8]
    depth: Depth
    metres_per_unit: float | None
    camera: Camera
    timestamp_s: float
    skew_s: float = 0.0
    counts: FrameCounts | None = None
    calibration: str | None = None


@dataclass(frozen=True, eq=False, slots=True)
class FrameReady:
    """A frame lies in the ring."""

    content: SlotContent
    camera: Camera
    timestamp_s: float
    skew_s: float
    counts: FrameCounts
    calibration: str | None


@dataclass(frozen=True, eq=False, slots=True)
class ServiceFailed:
    """The source raised. error: pickled, where it is a SourceError. reason: in words."""

    error: bytes | None
    reason: str


@dataclass(frozen=True, slots=True)
class ServiceEnded:
    """The source has no more frames."""


Factory = Callable[[threading.Event], Iterator[LiveFrame]]


def serve_frames(factory: Factory, end: ChildEnd) -> None:
    """The child's task. `factory` is called with the event that asks it to stop, and closed before the child leaves."""
    try:
        ring = RingWriter(end.memory)
        with contextlib.closing(_closable(factory(end.stopping))) as frames:
            for number, frame in enumerate(frames, start=1):
                content = ring.write(frame.color, frame.depth, metres_per_unit=frame.metres_per_unit)
                counts = frame.counts or whole(number)
                end.send(FrameReady(content, frame.camera, frame.timestamp_s, frame.skew_s, counts, frame.calibration))
                if end.stopping.is_set():
                    return
    except SourceError as error:
        end.send(ServiceFailed(pickle.dumps(error), str(error)))
    except Exception as error:
        end.send(ServiceFailed(None, f"{type(error).__name__}: {error}"))
    else:
        end.send(ServiceEnded())


def _closable(frames: Iterator[LiveFrame]) -> Generator[LiveFrame, None, None]:
    yield from frames
