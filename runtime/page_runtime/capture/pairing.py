"""Colour and depth readings to frames, by their timestamps; the same code live and in playback.

Both streams are queues in order of time. While both have a reading, the two earliest are a frame if they lie within the
window of each other; otherwise the earlier of them can have no partner any more and is left out. This makes as many
frames as any matching could (a reading's possible partners are an interval of the other stream, and both ends of the
intervals grow with time: the greedy choice is optimal, Glover 1967), needs nothing of the future, and depends on the
timestamps alone, not on which stream's message arrived first.
"""

from __future__ import annotations

import math
from bisect import insort
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median
from typing import Generic, Literal, TypeVar

from page_runtime.capture.counts import FrameCounts
from page_runtime.capture.layouts import WINDOW_S
from page_runtime.image_files import SourceError

Stream = Literal["color", "depth"]
T = TypeVar("T")

CAPACITY = 64
PATIENCE = 60
CLOCK_JUMP_S = 1.0
SKEWS_KEPT = 1000

NO_PARTNER = "readings without a partner in the window"
SILENT = "readings given up because the other stream is silent"
TOO_LATE = "readings that came after later ones of their stream"
CLOCK_BACK = "readings from before the clock was set back"
NO_TIME = "readings without a valid time"
AT_END = "readings without a partner at the end"


class NeverInSync(SourceError):
    """Colour and depth were received, and no two of them lie within the window."""


@dataclass(frozen=True, eq=False, slots=True)
class Pair(Generic[T]):
    """A colour and a depth reading. timestamp_s: the colour's. skew_s: depth time minus colour time."""

    color: T
    depth: T
    timestamp_s: float
    skew_s: float


class Pairing(Generic[T]):
    """The synchroniser: readings are pushed in, pairs come out, and every reading is accounted for.

    window_s: the most that two readings of a frame may lie apart. Below half the frame period a reading has at most
    one possible partner. capacity: the most readings that wait in one stream; the oldest are given up. patience: so
    many readings of both streams without a single pair are an error, not a wait.
    """

    def __init__(self, *, window_s: float = WINDOW_S, capacity: int = CAPACITY, patience: int = PATIENCE) -> None:
        if not (math.isfinite(window_s) and window_s >= 0):
            raise ValueError(f"Pairing.window_s: expected seconds from 0 on, got {window_s}")
        if capacity < 1 or patience < 1:
            raise ValueError(f"Pairing: expected a capacity and patience of at least 1, got {capacity} and {patience}")
        self.window_s, self.capacity, self.patience = window_s, capacity, patience
        self._waiting: dict[Stream, deque[tuple[float, int, T]]] = {"color": deque(), "depth": deque()}
        self._received: Counter[Stream] = Counter()
        self._newest: dict[Stream, float] = {"color": -math.inf, "depth": -math.inf}
        self._decided: dict[Stream, float] = {"color": -math.inf, "depth": -math.inf}
        self._unpaired: Counter[str] = Counter()
        self._paired = 0
        self._skews: deque[float] = deque(maxlen=SKEWS_KEPT)
        self._max_skew = 0.0
        self._gaps: deque[float] = deque(maxlen=SKEWS_KEPT)

    def push(self, stream: Stream, timestamp_s: float, reading: T) -> list[Pair[T]]:
        """Take one reading; returns the pairs it completes, in order of time.

        Raises NeverInSync when `patience` readings of both streams have not made a single pair.
        """
        self._received[stream] += 1
        if not math.isfinite(timestamp_s):
            self._unpaired[NO_TIME] += 1
            return []
        self._enqueue(stream, timestamp_s, reading)
        pairs = self._match()
        if not self._paired and min(self._received["color"], self._received["depth"]) >= self.patience:
            raise NeverInSync(self._explanation())
        return pairs

    def finish(self) -> FrameCounts:
        """No more will come: what still waits is counted as unpaired. Raises NeverInSync when no pair was ever made."""
        for stream in self._waiting:
            self._give_up(stream, len(self._waiting[stream]), AT_END)
        if not self._paired and self._received["color"] and self._received["depth"]:
            raise NeverInSync(self._explanation())
        return self.counts

    @property
    def counts(self) -> FrameCounts:
        """What became of the readings so far."""
        return FrameCounts(
            color=self._received["color"],
            depth=self._received["depth"],
            paired=self._paired,
            unpaired=dict(self._unpaired),
            waiting=sum(len(queue) for queue in self._waiting.values()),
            median_skew_s=median(self._skews) if self._skews else 0.0,
            max_skew_s=self._max_skew,
        )

    def _enqueue(self, stream: Stream, timestamp_s: float, reading: T) -> None:
        queue = self._waiting[stream]
        if timestamp_s < self._newest[stream] - CLOCK_JUMP_S:
            self._give_up(stream, len(queue), CLOCK_BACK)
            self._newest[stream] = self._decided[stream] = -math.inf
        if timestamp_s <= self._decided[stream] or timestamp_s == self._newest[stream]:
            self._unpaired[TOO_LATE] += 1
            return
        entry = (timestamp_s, self._received[stream], reading)
        if timestamp_s > self._newest[stream]:
            queue.append(entry)
            self._newest[stream] = timestamp_s
        else:
            insort(queue, entry, key=lambda waiting: waiting[:2])
        if len(queue) > self.capacity:
            self._give_up(stream, 1, SILENT)

    def _match(self) -> list[Pair[T]]:
        color, depth = self._waiting["color"], self._waiting["depth"]
        pairs: list[Pair[T]] = []
        while color and depth:
            skew_s = depth[0][0] - color[0][0]
            if abs(skew_s) <= self.window_s:
                (color_s, _, color_reading), (depth_s, _, depth_reading) = color.popleft(), depth.popleft()
                self._decided["color"], self._decided["depth"] = color_s, depth_s
                pairs.append(Pair(color_reading, depth_reading, color_s, skew_s))
                self._paired += 1
                self._skews.append(abs(skew_s))
                self._max_skew = max(self._max_skew, abs(skew_s))
            else:
                self._gaps.append(skew_s)
                self._give_up("color" if skew_s > 0 else "depth", 1, NO_PARTNER)
        return pairs

    def _give_up(self, stream: Stream, count: int, reason: str) -> None:
        for _ in range(count):
            self._decided[stream] = self._waiting[stream].popleft()[0]
            self._unpaired[reason] += 1

    def _explanation(self) -> str:
        nearest = min(self._gaps, key=abs, default=math.nan)
        return (
            f"colour and depth are never in sync: {self._received['color']} colour and {self._received['depth']} depth "
            f"readings, no two within {self.window_s * 1e3:g} ms; the nearest seen lie {abs(nearest) * 1e3:.1f} ms "
            "apart; record both by one clock, or give a wider window if that much skew is tolerable"
        )


def pair_recorded(
    readings: Iterable[tuple[float, Stream, T]], *, window_s: float = WINDOW_S
) -> tuple[list[Pair[T]], FrameCounts]:
    """All pairs of recorded (timestamp_s, stream, reading), in the order they were stored, and what became of the rest.

    Raises NeverInSync when both streams have readings and none can be paired.
    """
    stored = list(readings)
    # Everything is there already, so nothing needs to be given up for want of room or patience.
    pairing: Pairing[T] = Pairing(window_s=window_s, capacity=len(stored) + 1, patience=len(stored) + 1)
    pairs = [pair for timestamp_s, stream, reading in stored for pair in pairing.push(stream, timestamp_s, reading)]
    return pairs, pairing.finish()
