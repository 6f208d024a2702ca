"""Plots as SVG text: lines over two axes, and bars. Colours are the page's own, so they follow its light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

WIDTH, HEIGHT = 460, 280
_LEFT, _RIGHT, _TOP, _BOTTOM = 50, 12, 26, 44
_COLOURS = 7
# Values closer together than this are drawn as one: nothing measured here is smaller.
_LEAST_RANGE = 1e-12


@dataclass(frozen=True, slots=True)
class Series:
    """x, y (n,). low, high: of each point's interval, () for none. marked: with dots. dashed: a reference, in grey."""

    name: str
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] = ()
    high: Sequence[float] = ()
    marked: bool = False
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Axis:
    """label: with its unit. limits: None for those of the data, 0 among them."""

    label: str
    limits: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class _Scale:
    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        inside = float(np.clip(value, self.low, self.high))
        return self.start + (inside - self.low) / (self.high - self.low) * (self.end - self.start)


def colour(index: int) -> str:
    return f"var(--c{index % _COLOURS})"


def line_chart(series: Sequence[Series], x: Axis, y: Axis) -> str:
    """The series over two axes, with their names above; an SVG element."""
    across = _scale(x, [value for one in series for value in one.x], _LEFT, WIDTH - _RIGHT)
    values = [value for one in series for value in (*one.y, *one.low, *one.high)]
    up = _scale(y, values, HEIGHT - _BOTTOM, _TOP)
    drawn = [_axes(across, up, x, y)]
    coloured = iter(range(len(series)))
    names: list[tuple[str, str]] = []
    for one in series:
        stroke = "var(--soft)" if one.dashed else colour(next(coloured))
        names.append((one.name, stroke))
        points = [(across(a), up(b)) for a, b in zip(one.x, one.y, strict=True)]
        path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points)
        dash = ' stroke-dasharray="4 4"' if one.dashed else ""
        if points:
            width = 1 if one.dashed else 1.8
            drawn.append(f'<path d="{path}" fill="none" stroke="{stroke}" stroke-width="{width}"{dash}/>')
        for a, low, high in zip(one.x, one.low, one.high, strict=False):
            drawn.append(
                f'<path d="M{across(a):.1f} {up(low):.1f}V{up(high):.1f}" stroke="{stroke}" stroke-width="1.2" '
                'opacity=".55"/>'
            )
        if one.marked:
            drawn += [f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3" fill="{stroke}"/>' for a, b in points]
    return _svg("".join(drawn) + _legend(names), HEIGHT)


def cumulative(name: str, values: Sequence[float], count: int, limit: float) -> Series:
    """The share of `count` whose value is at most x, up to `limit`; those without a value never are."""
    ordered = np.sort(np.asarray(values, float))
    steps = np.searchsorted(ordered, np.linspace(0.0, limit, 161), side="right") / max(1, count)
    return Series(name, np.linspace(0.0, limit, 161).tolist(), steps.tolist())


def bar_chart(rows: Sequence[tuple[str, float, float]], unit: str, *, label_px: int = 96, digits: int = 1) -> str:
    """A bar for each (name, value, whisker), the whisker at least the value. label_px: room for the names. digits: of
    the values, behind the point."""
    longest = max(*(high for _, _, high in rows), 1e-9) * 1.04
    left, step = label_px, 26
    height = step * len(rows) + 10
    scale = (WIDTH - left - 60) / longest
    drawn = []
    for i, (name, value, high) in enumerate(rows):
        y = 8 + i * step
        drawn.append(
            f'<text x="{left - 8}" y="{y + 13}" text-anchor="end">{escape(name)}</text>'
            f'<rect x="{left}" y="{y + 2}" width="{value * scale:.1f}" height="15" rx="2" fill="var(--c0)"/>'
            f'<path d="M{left + value * scale:.1f} {y + 9.5}H{left + high * scale:.1f}" stroke="var(--soft)"/>'
            f'<path d="M{left + high * scale:.1f} {y + 5}v9" stroke="var(--soft)"/>'
            f'<text x="{left + high * scale + 6:.1f}" y="{y + 13}">{value:.{digits}f} {escape(unit)}</text>'
        )
    return _svg("".join(drawn), height)


def _scale(axis: Axis, values: Sequence[float], start: float, end: float) -> _Scale:
    if axis.limits is not None:
        low, high = axis.limits
    else:
        low, high = min(0.0, *values), 1.06 * max(0.0, *values)
    return _Scale(low, high if high - low > _LEAST_RANGE else low + 1.0, start, end)


def _axes(across: _Scale, up: _Scale, x: Axis, y: Axis) -> str:
    bottom, drawn = HEIGHT - _BOTTOM, []
    for value in ticks(up):
        at = up(value)
        drawn.append(f'<path class="grid" d="M{_LEFT} {at:.1f}H{WIDTH - _RIGHT}"/>')
        drawn.append(f'<text x="{_LEFT - 7}" y="{at + 4:.1f}" text-anchor="end">{value:g}</text>')
    for value in ticks(across):
        at = across(value)
        drawn.append(f'<path class="grid" d="M{at:.1f} {_TOP}V{bottom}"/>')
        drawn.append(f'<text x="{at:.1f}" y="{bottom + 16}" text-anchor="middle">{value:g}</text>')
    drawn.append(f'<path class="axis" d="M{_LEFT} {bottom}H{WIDTH - _RIGHT}"/>')
    middle = (_LEFT + WIDTH - _RIGHT) / 2
    drawn.append(f'<text x="{middle}" y="{HEIGHT - 8}" text-anchor="middle">{escape(x.label)}</text>')
    high = (_TOP + bottom) / 2
    drawn.append(f'<text transform="translate(12 {high}) rotate(-90)" text-anchor="middle">{escape(y.label)}</text>')
    return "".join(drawn)


def ticks(scale: _Scale) -> list[float]:
    """Round values within a scale, four to eight of them."""
    rough = (scale.high - scale.low) / 5
    power = 10.0 ** np.floor(np.log10(rough))
    step = float(min((m * power for m in (1, 2, 5, 10)), key=lambda one: abs(one - rough)))
    first, last = int(np.ceil(scale.low / step - 1e-9)), int(np.floor(scale.high / step + 1e-9))
    return [round(step * i, 12) for i in range(first, last + 1)]


def _legend(names: Sequence[tuple[str, str]]) -> str:
    """In a row above the plot, where it hides nothing."""
    drawn, x = [], float(_LEFT)
    for name, stroke in names:
        if name:
            drawn.append(
                f'<path d="M{x:.0f} 9h14" stroke="{stroke}" stroke-width="2.4"/>'
                f'<text x="{x + 19:.0f}" y="13">{escape(name)}</text>'
            )
            x += 34 + 6.0 * len(name)
    return "".join(drawn)


def _svg(content: str, height: float) -> str:
    return f'<svg viewBox="0 0 {WIDTH} {height:.0f}" role="img">{content}</svg>'
