"""One-page reports: HTML with its pictures inside, which opens anywhere and needs nothing."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.geometry import Array

_STYLE = """
body { font: 15px/1.45 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #1b1b1b; }
h1 { font-size: 1.5em; } h2 { font-size: 1.1em; margin-top: 1.8em; }
table { border-collapse: collapse; } td, th { padding: .15em .9em .15em 0; text-align: left; }
td + td { font-variant-numeric: tabular-nums; }
.good { border-left: .4em solid #2a9d5c; padding-left: .7em; }
.bad { border-left: .4em solid #c8452f; padding-left: .7em; }
svg, img { max-width: 100%; height: auto; background: #fafafa; } .note { color: #666; font-size: .9em; }
"""


def page(title: str, verdict: str, sections: Sequence[tuple[str, str]], *, is_good: bool) -> str:
    """The document; sections are headings and their HTML."""
    body = "".join(f"<h2>{escape(heading)}</h2>\n{content}\n" for heading, content in sections)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style></head><body>\n<h1>{escape(title)}</h1>\n"
        f'<p class="{"good" if is_good else "bad"}">{escape(verdict)}</p>\n{body}</body></html>\n'
    )


def table(rows: Sequence[Sequence[str]], *, header: Sequence[str] = ()) -> str:
    head = "<tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in header) + "</tr>" if header else ""
    lines = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>\n" for row in rows)
    return f"<table>{head}{lines}</table>"


def note(text: str) -> str:
    return f'<p class="note">{escape(text)}</p>'


def coverage(size: tuple[int, int], pixels: Sequence[Array], residuals_px: Sequence[Array], *, magnified: float) -> str:
    """Every corner found, in the picture's frame, with its residual as a line `magnified` times as long as it is."""
    width, height = size
    scale = 800 / width
    marks = []
    for points, residuals in zip(pixels, residuals_px, strict=True):
        for (x, y), (dx, dy) in zip(points, residuals, strict=True):
            u, v = (x + 0.5) * scale, (y + 0.5) * scale
            ends = f"{u + dx * magnified * scale:.1f} {v + dy * magnified * scale:.1f}"
            marks.append(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="1.6"/><path d="M{u:.1f} {v:.1f}L{ends}"/>')
    grid = "".join(f'<path d="M{i * 200} 0V{height * scale:.0f}" class="g"/>' for i in range(1, 4))
    grid += "".join(f'<path d="M0 {i * height * scale / 3:.0f}H800" class="g"/>' for i in range(1, 3))
    return (
        f'<svg viewBox="0 0 800 {height * scale:.0f}" width="800"><style>circle {{ fill: #3a6ea5; }} '
        "path { stroke: #c8452f; } path.g { stroke: #ddd; }</style>"
        f'<rect width="800" height="{height * scale:.0f}" fill="none" stroke="#999"/>{grid}{"".join(marks)}</svg>'
        + note(f"Corners found; red: found minus projected, {magnified:g} times as long.")
    )


def bars(names: Sequence[str], values: Array, *, unit: str) -> str:
    """A bar for each name."""
    longest = max(float(np.max(values)), 1e-12)
    rows = []
    for i, (name, value) in enumerate(zip(names, values, strict=True)):
        y = i * 18
        rows.append(
            f'<text x="0" y="{y + 13}">{escape(name)}</text><rect x="200" y="{y + 3}" height="12" fill="#3a6ea5" '
            f'width="{480 * value / longest:.1f}"/><text x="{206 + 480 * value / longest:.0f}" y="{y + 13}">'
            f"{value:.3g} {escape(unit)}</text>"
        )
    return f'<svg viewBox="0 0 800 {18 * len(names) + 4}" width="800" font-size="12">{"".join(rows)}</svg>'


def image(rgb: NDArray[np.uint8], *, caption: str) -> str:
    """A picture (H,W,3) uint8 RGB inside the page."""
    _, data = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(data.tobytes()).decode()}">{note(caption)}'
