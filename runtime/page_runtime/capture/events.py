"""What happens to a live source besides frames."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SourceStarted:
    """A child process was started. pid: its process. attempt: 1 for the first."""

    pid: int
    attempt: int

    def __str__(self) -> str:
        return f"started (process {self.pid}, attempt {self.attempt})"


@dataclass(frozen=True, slots=True)
class SourceRunning:
    """The first frame of a child process. outage_s: how long there was none, None for the first start."""

    outage_s: float | None

    def __str__(self) -> str:
        return "frames arrive" if self.outage_s is None else f"frames arrive again after {self.outage_s:.1f} s"


@dataclass(frozen=True, slots=True)
class SourceStalled:
    """The child runs, but no frame has come for age_s."""

    age_s: float

    def __str__(self) -> str:
        return f"stalled: no frame for {self.age_s:.1f} s"


@dataclass(frozen=True, slots=True)
class SourceDied:
    """The child process ended, or was ended because it stalled. reason: in words. uptime_s: how long it had run."""

    reason: str
    uptime_s: float

    def __str__(self) -> str:
        return f"lost after {self.uptime_s:.1f} s: {self.reason}"


@dataclass(frozen=True, slots=True)
class SourceEnded:
    """The source has no more frames."""

    def __str__(self) -> str:
        return "ended"


SourceEvent = SourceStarted | SourceRunning | SourceStalled | SourceDied | SourceEnded
