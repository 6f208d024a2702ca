"""page-calibrate inspect: what a calibration file says, in this project's terms."""

from __future__ import annotations

import sys
from pathlib import Path

from page_calibration.commands.words import readable
from page_calibration.formats.registry import read_calibration


def inspect(path: Path, *, size: tuple[int, int] | None) -> None:
    """Write the calibration to standard output."""
    sys.stdout.write(readable(read_calibration(path, size=size)))
