"""When the result of a frame has to be there."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Deadline:
    """at_s: seconds of `time.monotonic`; None where there is no hurry. stopping: whether the loop was told to end,
    which leaves no time for anything more."""

    at_s: float | None = None
    stopping: Callable[[], bool] = lambda: False

    @property
    def left_s(self) -> float:
        """Seconds until then, negative afterwards; infinite without a deadline."""
        return float("inf") if self.at_s is None else self.at_s - time.monotonic()

    @property
    def passed(self) -> bool:
        return self.left_s < 0.0

    def allows(self, cost_s: float) -> bool:
        """Whether something that takes so long would be done in time."""
        return not self.stopping() and cost_s <= self.left_s
