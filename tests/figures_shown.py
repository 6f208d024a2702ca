"""Figures that tests measure, shown by `pytest -s`."""

from __future__ import annotations

import sys


def report(text: str) -> None:
    """A line, or a table of lines."""
    sys.stdout.write("\n" + text.strip("\n") + "\n")
