"""What the live loop gives for every frame it takes; nothing here knows of threads, sources or sinks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from page_runtime.frame import RgbdFrame
from page_runtime.pose import ArticulatedPose
from page_runtime.sampling import Region

# searching: none is followed; tracking: every object is; reacquiring: at least one was lost and is looked for.
LiveState = Literal["searching", "tracking", "reacquiring"]


@dataclass(frozen=True, slots=True)
class LoopCounts:
    """Counters of one loop since its start; received = processed + dropped + waiting at any time.

    received: frames the source gave. processed: those a result was made of. dropped: those passed over for newer ones.
    waiting: taken and not yet answered. late: results after the frame's deadline. searched, tracked: objects found by a
    full search and from their last pose. lost: times an object that was followed was not found any more. failed: frames
    in which something unforeseen was raised (`faults`), processed like the others.
    """

    received: int = 0
    processed: int = 0
    dropped: int = 0
    waiting: int = 0
    late: int = 0
    searched: int = 0
    tracked: int = 0
    lost: int = 0
    failed: int = 0


@dataclass(frozen=True, eq=False, slots=True)
class LiveObject:
    """One object in one frame. number: the same as long as it is followed. region: (x,y,w,h) px it was cut out with.
    pose: the answer, filtered where the loop filters. tracked: found from its last pose, not by a full search.
    joint_rates: how fast each joint moves, rad/s or m/s, in the category's order; None for one without a state, empty
    where nothing is followed."""

    number: int
    region: Region
    pose: ArticulatedPose
    tracked: bool
    joint_rates: tuple[float | None, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class LiveResult:
    """Everything about one processed frame.

    objects: in the order of their numbers; empty with a `reason` where none was found. latency_ms: from the moment the
    source gave the frame to the moment this result was there. stage_ms: wall time by stage, of all objects together.
    late: whether it came after its deadline.
    """

    frame: RgbdFrame
    objects: tuple[LiveObject, ...]
    state: LiveState
    counts: LoopCounts
    latency_ms: float
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    late: bool = False
    reason: str = ""
