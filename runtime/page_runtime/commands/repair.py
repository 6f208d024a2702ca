"""page-runtime repair: a whole recording from one that was cut short or damaged."""

from __future__ import annotations

import sys
from pathlib import Path

from page_runtime.capture.repair import repair as repaired


def repair(recording: Path, *, out: Path | None) -> None:
    """Write a playable copy of `recording` and say what is lost."""
    result = repaired(recording, out)
    lost = ", ".join(f"{count} {reason}" for reason, count in result.missed.items()) or "nothing"
    sys.stdout.write(f"{result.path}: {result.frames} frames; lost: {lost}\n")
