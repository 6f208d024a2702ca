"""How long to wait for a child process that should give frames, and what its silence means."""

from __future__ import annotations

import time
from dataclasses import dataclass

from page_runtime.capture.child_process import ChildProcess
from page_runtime.capture.frame_ring import RingReader


@dataclass(frozen=True, slots=True)
class Patience:
    """How long to wait for what, seconds.

    stalled_s: without a frame until the source is reported stalled. restart_s: until its process is replaced.
    start_s: from the start of a process to its first frame. first_pause_s, longest_pause_s: before a new start.
    give_up_s: without a frame until the source is lost; max_first_starts: the same by starts, before the first frame.
    """

    stalled_s: float = 0.5
    restart_s: float = 3.0
    start_s: float = 20.0
    first_pause_s: float = 0.1
    longest_pause_s: float = 5.0
    give_up_s: float = 60.0
    max_first_starts: int = 3


class Watch:
    """When a child last gave a frame, and what follows from it."""

    def __init__(self, child: ChildProcess, patience: Patience) -> None:
        self.child, self.patience = child, patience
        self.ring = RingReader(child.memory)
        self.last_frame_s: float | None = None
        self.told_stalled = False

    @property
    def age_s(self) -> float:
        """Since the last frame, or since the start."""
        return time.monotonic() - (self.last_frame_s or self.child.started_s)

    def seen(self, now_s: float) -> None:
        """A frame came."""
        self.last_frame_s, self.told_stalled = now_s, False

    def just_stalled(self) -> bool:
        """Whether it is time to report a stall, once for each."""
        if self.last_frame_s is None or self.told_stalled or self.age_s <= self.patience.stalled_s:
            return False
        self.told_stalled = True
        return True

    def overdue(self) -> str | None:
        """Why the child is to be replaced, None while it is not."""
        if self.last_frame_s is None:
            limit_s = self.patience.start_s
            return f"no frame within {limit_s:g} s of its start" if self.age_s > limit_s else None
        return f"stalled for {self.age_s:.1f} s" if self.age_s > self.patience.restart_s else None
