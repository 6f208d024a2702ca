"""The frame of a page: headings, tables that sort when their heads are clicked, pictures inside the file."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import cv2
import numpy as np
from numpy.typing import NDArray

_STYLE = """
:root { --ink:#20262d; --soft:#66717d; --rule:#e3e7eb; --paper:#ffffff; --panel:#f6f8f9; --accent:#2f6f9f;
  --good:#2b8a5a; --bad:#b8442f; --c0:#2f6f9f; --c1:#d07c2e; --c2:#3f9368; --c3:#8a5fa8; --c4:#b8442f; --c5:#5d6b78;
  --c6:#a08a2c; }
@media (prefers-color-scheme: dark) { :root { --ink:#dfe4e8; --soft:#98a3ad; --rule:#333b43; --paper:#15191d;
  --panel:#1c2126; --accent:#76b0dc; --good:#63bf90; --bad:#e2836f; --c0:#76b0dc; --c1:#e6a25e; --c2:#73c49b;
  --c3:#bd98d6; --c4:#e2836f; --c5:#9aa8b5; --c6:#cdb95c; } }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, -apple-system, "Segoe UI", "Noto Sans", sans-serif; color: var(--ink);
  background: var(--paper); max-width: 80rem; margin: 0 auto; padding: 2.5rem 1.5rem 5rem; }
h1 { font-size: 1.55rem; font-weight: 600; margin: 0 0 .2rem; letter-spacing: -.01em; }
h2 { font-size: 1.08rem; font-weight: 600; margin: 2.6rem 0 .6rem; }
p { margin: .4rem 0; max-width: 48rem; } .note { color: var(--soft); font-size: .88rem; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(9.5rem, 1fr)); gap: .8rem; margin: 1.4rem 0; }
.card { background: var(--panel); border-radius: .5rem; padding: .8rem 1rem; display: flex; flex-direction: column; }
.card b { display: block; font-size: 1.5rem; font-weight: 600; line-height: 1.25; font-variant-numeric: tabular-nums; }
b + span { margin-bottom: auto; } .card span { color: var(--soft); font-size: .82rem; display: block; }
.scroll { overflow-x: auto; } .tall { max-height: 32rem; overflow: auto; }
table { border-collapse: collapse; width: 100%; font-size: .88rem; font-variant-numeric: tabular-nums; }
th, td { padding: .36rem 0 .36rem .8rem; text-align: right; border-bottom: 1px solid var(--rule); white-space: nowrap; }
th { color: var(--soft); font-weight: 500; cursor: pointer; user-select: none; position: sticky; top: 0;
  background: var(--paper); vertical-align: bottom; }
th:hover { color: var(--ink); } th[aria-sort=ascending]::after { content: " \\2191"; }
th[aria-sort=descending]::after { content: " \\2193"; }
td.words, th.words { text-align: left; }
td:first-child, th:first-child { text-align: left; padding-left: 0; }
td small { color: var(--soft); }
td.wide { white-space: normal; min-width: 16rem; }
.plots { display: grid; grid-template-columns: repeat(auto-fill, minmax(27rem, 1fr)); gap: 1.2rem; margin: .8rem 0; }
figure { margin: 0; } figcaption { color: var(--soft); font-size: .84rem; margin-top: .35rem; line-height: 1.4; }
svg { width: 100%; height: auto; display: block; } svg text { fill: var(--soft); font-size: 11px; }
svg .axis { stroke: var(--soft); stroke-width: 1; } svg .grid { stroke: var(--rule); stroke-width: 1; }
.pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(19rem, 1fr)); gap: 1.2rem; }
.pictures img { width: 100%; border-radius: .4rem; display: block; background: var(--panel); }
.verdict { border-left: .35rem solid; padding-left: .7rem; }
.good { color: var(--good); } .bad { color: var(--bad); } code { font-size: .85em; }
.key { display: inline-block; width: .7em; height: .7em; border-radius: .15em; margin-right: .4em; }
"""

# Cells carry what they sort by, so that "-" and intervals do not matter; a cell without it sorts as text.
_SCRIPT = """
document.querySelectorAll("th").forEach(head => head.addEventListener("click", () => {
  const table = head.closest("table"), body = table.tBodies[0], column = head.cellIndex;
  const up = head.getAttribute("aria-sort") !== "ascending";
  table.querySelectorAll("th").forEach(other => other.removeAttribute("aria-sort"));
  head.setAttribute("aria-sort", up ? "ascending" : "descending");
  const value = row => row.cells[column].dataset.sort;
  const compare = (one, other) => {
    const a = value(one), b = value(other);
    if (a === undefined || b === undefined)
      return one.cells[column].textContent.localeCompare(other.cells[column].textContent);
    if (a === "" || b === "") return a === b ? 0 : (a === "" ? 1 : -1) * (up ? 1 : -1);
    return Number(a) - Number(b);
  };
  [...body.rows].sort((one, other) => (up ? 1 : -1) * compare(one, other)).forEach(row => body.append(row));
}));
"""

# Stands for a figure that does not exist, and between the ends of an interval.
NONE = "\u2013"


@dataclass(frozen=True, slots=True)
class Cell:
    """text: what is read. value: what it sorts by, None for "no figure". small: in a lighter hand behind it."""

    text: str
    value: float | None
    small: str = ""


def page(title: str, subtitle: str, sections: Sequence[tuple[str, str]]) -> str:
    """The document; sections are headings ("" for none) and their HTML."""
    body = "".join(
        f"<section>{f'<h2>{escape(heading)}</h2>' if heading else ''}\n{content}\n</section>\n"
        for heading, content in sections
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>\n<h1>{escape(title)}</h1>\n"
        f'<p class="note">{escape(subtitle)}</p>\n{body}<script>{_SCRIPT}</script></body></html>\n'
    )


def table(header: Sequence[str], rows: Sequence[Sequence[str | Cell]], *, tall: bool = False) -> str:
    """A table that sorts; text cells to the left, figures to the right. header: () for a list of facts, which has
    none. tall: of many rows, scrolls by itself."""
    words = [all(isinstance(row[i], str) for row in rows) for i in range(len(header) or len(rows[0]))]
    named = zip(header, words if header else (), strict=True)
    head = "".join(f"<th{_class(is_words)}>{escape(name)}</th>" for name, is_words in named)
    thead = f"<thead><tr>{head}</tr></thead>" if header else ""
    lines = "".join(
        f"<tr>{''.join(_cell(cell, is_words) for cell, is_words in zip(row, words, strict=True))}</tr>\n"
        for row in rows
    )
    return f'<div class="{"tall" if tall else "scroll"}"><table>{thead}<tbody>\n{lines}</tbody></table></div>'


def _class(is_words: bool) -> str:
    return ' class="words"' if is_words else ""


def _cell(cell: str | Cell, is_words: bool) -> str:
    if isinstance(cell, str):
        wide = " wide" if len(cell) > 60 else ""
        return f'<td class="words{wide}">{escape(cell)}</td>' if is_words else f"<td>{escape(cell)}</td>"
    small = f" <small>{escape(cell.small)}</small>" if cell.small else ""
    sort = "" if cell.value is None else f"{cell.value:.9g}"
    return f'<td data-sort="{sort}">{escape(cell.text)}{small}</td>'


def figure_cell(value: float | None, digits: int, times: float = 1.0, small: str = "") -> Cell:
    """A number with so many decimals, a dash for None."""
    return Cell(NONE, None) if value is None else Cell(f"{value * times:.{digits}f}", value * times, small)


def cards(items: Sequence[tuple[str, str, str]]) -> str:
    """The few figures to see first: what it is, the figure, what it rests on."""
    return '<div class="cards">{}</div>'.format(
        "".join(
            f'<div class="card"><span>{escape(name)}</span><b>{escape(value)}</b><span>{escape(more)}</span></div>'
            for name, value, more in items
        )
    )


def verdict(text: str, *, is_good: bool) -> str:
    """The sentence that a page is about."""
    return f'<p class="verdict {"good" if is_good else "bad"}">{escape(text)}</p>'


def note(text: str) -> str:
    return f'<p class="note">{escape(text)}</p>'


def plots(figures: Sequence[tuple[str, str]]) -> str:
    """SVG drawings with their captions, side by side."""
    return '<div class="plots">{}</div>'.format(
        "".join(f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>" for svg, caption in figures)
    )


def pictures(items: Sequence[tuple[NDArray[np.uint8], str]]) -> str:
    """Pictures (H,W,3) uint8 RGB inside the file, with their captions."""
    return '<div class="pictures">{}</div>'.format(
        "".join(
            f'<figure><img alt="{escape(caption)}" src="data:image/jpeg;base64,{_jpeg(rgb)}">'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
            for rgb, caption in items
        )
    )


def _jpeg(rgb: NDArray[np.uint8]) -> str:
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 82])
    return base64.b64encode(data.tobytes()).decode()
