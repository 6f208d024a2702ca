"""Progress and tables, as plain text."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TextIO

LINES_WITHOUT_TERMINAL = 10
FRAMES_PER_LINE = 100


class Progress:
    """Counts frames on a stream: one line that changes on a terminal, about ten lines elsewhere. total: 0 where nobody
    knows it, as with a camera."""

    def __init__(self, label: str, total: int, *, quiet: bool, stream: TextIO | None = None) -> None:
        self.label, self.total, self.quiet = label, total, quiet
        self.stream = stream or sys.stderr
        self.done = 0
        self.live = self.stream.isatty()

    def advance(self, total: int | None = None) -> None:
        """One more frame; total: of how many, when that has only now become known."""
        self.done += 1
        self.total = total or self.total
        step = max(1, self.total // LINES_WITHOUT_TERMINAL) if self.total else FRAMES_PER_LINE
        if self.quiet or not (self.live or self.done % step == 0 or self.done == self.total):
            return
        text = f"{self.label}: frame {self.done}" + (f" of {self.total}" if self.total else "")
        self.stream.write(f"\r{text}" if self.live else f"{text}\n")
        self.stream.flush()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self.live and self.done and not self.quiet:
            self.stream.write("\n")


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns, the first to the left and the others to the right."""
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    lines = [
        "  ".join((row[0].ljust(widths[0]), *(row[i].rjust(widths[i]) for i in range(1, len(widths)))))
        for row in (header, *rows)
    ]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def number(value: float | None, digits: int) -> str:
    """The value with so many decimals, a dash for None."""
    return "-" if value is None else f"{value:.{digits}f}"
