"""Frames at an even pace, as a camera gives them, and a follower that takes its time."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from page_runtime.camera import Camera
from page_runtime.frame import RgbdFrame
from page_runtime.live.deadline import Deadline
from page_runtime.live.loop import Followed
from page_runtime.recorded import FrameEntry, RecordedFrame, Source

Size = tuple[int, int]
SMALL: Size = (64, 48)


def numbered_frame(number: int, period_s: float = 1 / 30, *, size: Size = SMALL) -> RecordedFrame:
    """A frame of `size` (width, height) px whose colour is its number modulo 251."""
    width, height = size
    K = np.array([[float(width), 0, (width - 1) / 2], [0, float(width), (height - 1) / 2], [0, 0, 1]])
    color = np.full((height, width, 3), number % 251, np.uint8)
    depth_m = np.full((height, width), 1.0, np.float32)
    return RecordedFrame(RgbdFrame(color, depth_m, Camera(K, width, height), number * period_s, number))


def numbered_recording(count: int) -> Source:
    """So many numbered frames as a recording, which waits for whoever takes them."""

    def entry(number: int) -> FrameEntry:
        frame, path = numbered_frame(number).frame, Path("frames")
        return FrameEntry(path, path, 1e-3, frame.camera, index=number, decode=lambda: (frame.color, frame.depth_m))

    return Source(path=Path("frames"), format="numbered frames", entries=tuple(entry(k) for k in range(count)))


class PacedSource:
    """So many frames, `period_s` apart on a clock that does not wait. sent_s: when each was given; stored_s: when
    whoever iterates had put it away and asked for the next; of `time.monotonic`, NaN for one that was not."""

    def __init__(self, frames: int, period_s: float, *, size: Size = SMALL, error: Exception | None = None) -> None:
        self.frames, self.period_s, self.size, self.error = frames, period_s, size, error
        # Filled from the start, that a soak measures the loop's memory and not this.
        self.sent_s, self.stored_s = np.full(frames, np.nan), np.full(frames, np.nan)
        self.sent = 0
        self.stopped = threading.Event()

    def stop(self) -> None:
        self.stopped.set()

    def __iter__(self) -> Iterator[RecordedFrame]:
        began_s = time.monotonic()
        for number in range(self.frames):
            self.stopped.wait(max(0.0, began_s + number * self.period_s - time.monotonic()))
            if self.stopped.is_set():
                return
            self.sent_s[number], self.sent = time.monotonic(), number + 1
            yield numbered_frame(number, self.period_s, size=self.size)
            self.stored_s[number] = time.monotonic()
        if self.error is not None:
            raise self.error


class Idle:
    """A follower that finds nothing and takes `busy_s` for it. taken_s, done_s: when it began and ended with each
    frame, NaN for one that it was not given."""

    def __init__(self, busy_s: float = 0.0, *, frames: int = 10_000) -> None:
        self.busy_s = busy_s
        self.taken_s, self.done_s = np.full(frames, np.nan), np.full(frames, np.nan)

    def follow(self, recorded: RecordedFrame, deadline: Deadline) -> Followed:
        del deadline
        self.taken_s[recorded.frame.index] = time.monotonic()
        time.sleep(self.busy_s)
        self.done_s[recorded.frame.index] = time.monotonic()
        return Followed((), "searching")


class IdleAhead(Idle):
    """The same in two halves (`loop.LooksAhead`): `look_s` for the first, `busy_s` for the second. looked_s, asked_s:
    when the first ended and the second began."""

    def __init__(self, look_s: float = 0.0, busy_s: float = 0.0, *, frames: int = 10_000) -> None:
        super().__init__(busy_s, frames=frames)
        self.look_s = look_s
        self.looked_s, self.asked_s = np.full(frames, np.nan), np.full(frames, np.nan)

    def look(self, recorded: RecordedFrame, deadline: Deadline) -> int:
        del deadline
        number = recorded.frame.index
        self.taken_s[number] = time.monotonic()
        time.sleep(self.look_s)
        self.looked_s[number] = time.monotonic()
        return number

    def answer(self, recorded: RecordedFrame, looked: int, deadline: Deadline) -> Followed:
        del deadline
        number = recorded.frame.index
        if looked != number:
            raise ValueError(f"looked: expected what was seen in frame {number}, got that of {looked}")
        self.asked_s[number] = time.monotonic()
        time.sleep(self.busy_s)
        self.done_s[number] = time.monotonic()
        return Followed((), "searching")
