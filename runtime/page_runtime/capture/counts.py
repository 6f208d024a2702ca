"""What became of every colour and depth reading that a source received."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """Counters of one source; they balance.

    color, depth: readings received. paired: frames made of them. unpaired: readings that no frame was made of, by
    reason. dropped: frames that were made and not delivered, by reason. waiting: readings whose partner may still come.
    missed: readings that never came, by what is known of them: gaps in the camera's numbers, what a file has lost.
    median_skew_s, max_skew_s: of |depth time - colour time| over the frames made.

    color + depth = 2 paired + sum(unpaired) + waiting.
    """

    color: int = 0
    depth: int = 0
    paired: int = 0
    unpaired: Mapping[str, int] = field(default_factory=dict)
    dropped: Mapping[str, int] = field(default_factory=dict)
    waiting: int = 0
    missed: Mapping[str, int] = field(default_factory=dict)
    median_skew_s: float = 0.0
    max_skew_s: float = 0.0

    @property
    def complete(self) -> bool:
        """Whether no reading is known to be missing, every one became a frame and every frame was delivered."""
        return not (self.unpaired or self.dropped or self.waiting or self.missed)

    def __str__(self) -> str:
        reasons = (*self.missed.items(), *self.unpaired.items(), *self.dropped.items())
        losses = [f"{count} {reason}" for reason, count in reasons]
        skew = f", skew {self.median_skew_s * 1e3:.1f} ms in the median, {self.max_skew_s * 1e3:.1f} at most"
        lost = f"; left out: {', '.join(losses)}" if losses else ""
        return f"{self.color} colour and {self.depth} depth readings, {self.paired} frames{skew}{lost}"


def whole(frames: int) -> FrameCounts:
    """The counts of a format that stores frames, not readings: all are there."""
    return FrameCounts(color=frames, depth=frames, paired=frames)


def total(parts: Iterable[FrameCounts]) -> FrameCounts:
    """The counts of several runs of a source as one; the median skew is the last run's."""
    listed = list(parts)

    def added(counters: Iterable[Mapping[str, int]]) -> dict[str, int]:
        sums: Counter[str] = Counter()
        for counter in counters:
            sums.update(counter)
        return dict(sums)

    return FrameCounts(
        color=sum(part.color for part in listed),
        depth=sum(part.depth for part in listed),
        paired=sum(part.paired for part in listed),
        unpaired=added(part.unpaired for part in listed),
        dropped=added(part.dropped for part in listed),
        waiting=sum(part.waiting for part in listed),
        missed=added(part.missed for part in listed),
        median_skew_s=listed[-1].median_skew_s if listed else 0.0,
        max_skew_s=max((part.max_skew_s for part in listed), default=0.0),
    )
