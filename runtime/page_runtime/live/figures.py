"""How a running loop is doing: what it gave so far, how late, how often, and how much poses tremble."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import asdict
from typing import Any

import numpy as np

from page_runtime.geometry import Array
from page_runtime.live.result import LiveResult, LoopCounts
from page_runtime.pose import PartPose
from page_runtime.similarity import so3_log

# Results that the figures are of.
WINDOW = 300
_LEAST = 8


class RunningFigures:
    """Figures of the last WINDOW results."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()
        self._results: deque[tuple[float, float]] = deque(maxlen=WINDOW)
        self._poses: dict[tuple[int, str], deque[tuple[int, Array]]] = {}
        self._number = 0
        self._last: LiveResult | None = None

    def add(self, result: LiveResult) -> None:
        """Count one more result."""
        self._results.append((time.monotonic(), result.latency_ms))
        self._number, self._last = self._number + 1, result
        seen = {
            (one.number, part.name): part.T_camera_part
            for one in result.objects
            for part in one.pose.parts
            if isinstance(part, PartPose)
        }
        for key, T_camera_part in seen.items():
            self._poses.setdefault(key, deque(maxlen=WINDOW)).append((self._number, T_camera_part))
        followed = {one.number for one in result.objects}
        self._poses = {
            key: poses
            for key, poses in self._poses.items()
            if key[0] in followed or poses[-1][0] > self._number - WINDOW
        }

    def document(self, counts: LoopCounts) -> dict[str, Any]:
        """In JSON's types. latency_ms, frames_per_s: null before there are enough results. jitter: of every part of
        every object seen in the window: root mean square of what two steps from frame to frame differ by, over sqrt(6),
        which is the standard deviation of errors independent from frame to frame under even motion. silent_s: since
        the last result, or the start without one."""
        last, now_s = self._last, time.monotonic()
        latencies = [latency for _, latency in self._results]
        p50, p95 = np.percentile(latencies, [50, 95]).tolist() if latencies else (None, None)
        return {
            "state": "searching" if last is None else last.state,
            "uptime_s": round(now_s - self._began_s, 3),
            "silent_s": round(now_s - (self._results[-1][0] if self._results else self._began_s), 3),
            "frame": None if last is None else last.frame.index,
            "objects": [] if last is None else [one.number for one in last.objects],
            "reason": None if last is None else last.reason or None,
            "counts": asdict(counts),
            "latency_ms": {"p50": _rounded(p50), "p95": _rounded(p95)},
            "frames_per_s": _rounded(self._rate()),
            "jitter": [
                {"object": number, "part": name, **figures}
                for (number, name), poses in sorted(self._poses.items())
                if (figures := jitter(list(poses))) is not None
            ],
        }

    def _rate(self) -> float | None:
        if len(self._results) < _LEAST:
            return None
        span_s = self._results[-1][0] - self._results[0][0]
        return (len(self._results) - 1) / span_s if span_s > 0.0 else None


def jitter(poses: list[tuple[int, Array]]) -> dict[str, float] | None:
    """rotation_deg and translation_mm of numbered poses (4,4); None for too few that follow each other by one."""
    turns, moves = [], []
    for (a, first), (b, second), (c, third) in zip(poses, poses[1:], poses[2:], strict=False):
        if (b, c) != (a + 1, a + 2):
            continue
        steps = np.stack([second[:3, :3] @ first[:3, :3].T, third[:3, :3] @ second[:3, :3].T])
        turns.append(np.diff(so3_log(steps), axis=0)[0])
        moves.append(third[:3, 3] - 2.0 * second[:3, 3] + first[:3, 3])
    if len(turns) < _LEAST:
        return None
    rotation, translation = (
        float(np.sqrt(np.mean(np.sum(np.square(values), axis=1)) / 6.0)) for values in (turns, moves)
    )
    return {"rotation_deg": round(float(np.degrees(rotation)), 4), "translation_mm": round(1e3 * translation, 4)}


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
