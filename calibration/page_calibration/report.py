"""What only the reports of calibrations show; the rest of a page is the runtime's (`page_runtime.report`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from page_runtime.geometry import Array
from page_runtime.report.charts import bar_chart
from page_runtime.report.page import note, page, plots, verdict

_LABEL_PX = 150


def judged_page(title: str, words: str, sections: Sequence[tuple[str, str]], *, is_good: bool) -> str:
    """The document: a verdict in words, then headings and their HTML."""
    return page(title, "page-calibrate", [("", verdict(words, is_good=is_good)), *sections])


def bars(names: Sequence[str], values: Array, *, unit: str) -> str:
    """A bar for each name, values (n,)."""
    rows = [(name, float(value), float(value)) for name, value in zip(names, np.asarray(values), strict=True)]
    return plots([(bar_chart(rows, unit, label_px=_LABEL_PX, digits=3), "")])


def coverage(size: tuple[int, int], pixels: Sequence[Array], residuals_px: Sequence[Array], *, magnified: float) -> str:
    """Every corner found, in the picture's frame, with its residual as a line `magnified` times as long as it is."""
    width, height = size
    scale = 800 / width
    marks = []
    for points, residuals in zip(pixels, residuals_px, strict=True):
        for (x, y), (dx, dy) in zip(points, residuals, strict=True):
            u, v = (x + 0.5) * scale, (y + 0.5) * scale
            ends = f"{u + dx * magnified * scale:.1f} {v + dy * magnified * scale:.1f}"
            marks.append(
                f'<circle cx="{u:.1f}" cy="{v:.1f}" r="1.6" fill="var(--c0)"/>'
                f'<path d="M{u:.1f} {v:.1f}L{ends}" stroke="var(--c4)"/>'
            )
    grid = "".join(f'<path d="M{i * 200} 0V{height * scale:.0f}" class="grid"/>' for i in range(1, 4))
    grid += "".join(f'<path d="M0 {i * height * scale / 3:.0f}H800" class="grid"/>' for i in range(1, 3))
    frame = f'<rect width="800" height="{height * scale:.0f}" fill="none" stroke="var(--soft)"/>'
    return f'<svg viewBox="0 0 800 {height * scale:.0f}" role="img">{frame}{grid}{"".join(marks)}</svg>' + note(
        f"Corners found; red: found minus projected, {magnified:g} times as long."
    )
