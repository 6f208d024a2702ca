"""Materials: a pattern, a colour table, how metres become texels, and how the surface meets light and depth
sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from page_training.scenes.textures import INDEXED, PATTERN_SIZE, REGIONS, Generator, pattern_bank

Color = NDArray[np.floating]
Rect = tuple[float, float, float, float]


_HUE_OFFSETS = np.array([5.0, 3.0, 1.0], np.float32)
_COLOR_SHARES = np.array([0.35, 0.65, 0.80])
_COLOR_RANGES = np.array([  # lowest saturation and value, highest saturation and value
    [0.5, 0.3, 1.0, 1.0], [0.12, 0.6, 0.5, 1.0], [0.0, 0.75, 0.12, 1.0], [0.0, 0.03, 0.3, 0.7],
])  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class Material:
    """pattern: index into the bank. table: (256,3) float32 reflectance in [0,1], RGB. texel_from_m: (2,3)
    affine map of a surface's (u,v) metres to texels. specular, gloss: strength and exponent of the
    highlight. emission: share of the colour that needs no light. mottle: strength of blotches (0-1).
    opacity_to_depth: 1 = any depth sensor sees it, 0 = glossy, dark or clear, so that readings often fail.
    """

    pattern: int
    table: Color
    texel_from_m: Color
    specular: float = 0.0
    gloss: float = 20.0
    emission: float = 0.0
    mottle: float = 0.0
    opacity_to_depth: float = 1.0


def hsv_color(hue: float | Color, saturation: float | Color, value: float | Color) -> Color:
    """RGB (..., 3) in [0,1] of hue, saturation and value in [0,1], numbers or arrays."""
    h, s, v = (np.asarray(x, np.float32)[..., None] for x in (hue, saturation, value))
    k = (_HUE_OFFSETS + h * 6.0) % 6.0
    return v - v * s * np.clip(np.minimum(k, 4.0 - k), 0.0, 1.0)


def random_colors(rng: Generator, count: int) -> Color:
    """(count,3): saturated plastics, pastels, whites, blacks and greys, as objects on desks are."""
    kind = np.searchsorted(_COLOR_SHARES, rng.random(count))
    low, high = _COLOR_RANGES[kind, :2], _COLOR_RANGES[kind, 2:]
    saturation, value = (low + rng.random((count, 2)) * (high - low)).T
    return hsv_color(rng.random(count), saturation, value)


def random_color(rng: Generator) -> Color:
    """(3,): one of `random_colors`."""
    return random_colors(rng, 1)[0]


def wood_color(rng: Generator) -> Color:
    return hsv_color(rng.uniform(0.03, 0.13), rng.uniform(0.2, 0.75), rng.uniform(0.2, 0.9))


def vary(rng: Generator, color: Color, amount: float) -> Color:
    return np.clip(color * (1 + rng.normal(0, amount)) + rng.normal(0, amount / 2, 3), 0, 1).astype(np.float32)


@lru_cache(maxsize=16)
def _ramp_weights(stops: int) -> Color:
    position = np.linspace(0, stops - 1, 256)[:, None]
    return np.clip(1 - np.abs(position - np.arange(stops)), 0, 1).astype(np.float32)


def ramp(*colors: Color) -> Color:
    """(256,3) table that runs through `colors` evenly."""
    return _ramp_weights(len(colors)) @ np.stack(colors)


def regions(colors: NDArray[np.float32], shading: float = 0.06) -> NDArray[np.float32]:
    """(256,3) table of indexed patterns: 16 shades around each of (16,3) colours."""
    shade = np.linspace(1 - shading, 1 + shading, REGIONS, dtype=np.float32)
    return np.clip(colors[:, None, :] * shade[None, :, None], 0, 1).reshape(256, 3)


def tiled(rng: Generator, tile_m: float, *, turn: bool = True) -> NDArray[np.float32]:
    """Texel map that repeats every `tile_m` metres with a random offset, turned at random unless `turn` is
    False."""
    angle = rng.uniform(0, 2 * np.pi) if turn else float(rng.integers(0, 2)) * np.pi / 2
    scale = PATTERN_SIZE / tile_m
    c, s = np.cos(angle) * scale, np.sin(angle) * scale
    return np.array([[c, -s, rng.uniform(0, PATTERN_SIZE)], [s, c, rng.uniform(0, PATTERN_SIZE)]], np.float32)


def fitted(rect: Rect) -> NDArray[np.float32]:
    """Texel map that spreads a pattern once over rect (u0, v0, width, height) metres; negative sizes
    mirror."""
    u0, v0, width, height = rect
    su, sv = PATTERN_SIZE / width, PATTERN_SIZE / height
    return np.array([[su, 0, -u0 * su], [0, sv, -v0 * sv]], np.float32)


def pick(rng: Generator, kind: str) -> int:
    return int(rng.choice(pattern_bank().kinds[kind]))


def plain(rng: Generator, color: Color, *, contrast: float = 0.05, kind: str | None = None) -> Material:
    """One colour with slight variation; glossy now and then."""
    kind = kind or str(rng.choice(["noise", "grain", "noise", "speckle"]))
    low, high = np.clip(color * (1 - contrast), 0, 1), np.clip(color * (1 + contrast), 0, 1)
    glossy = rng.random() < 0.5
    return Material(
        pattern=pick(rng, kind),
        table=ramp(low, high),
        texel_from_m=tiled(rng, rng.uniform(0.08, 0.6)),
        specular=float(rng.uniform(0.1, 0.7)) if glossy else 0.0,
        gloss=float(rng.uniform(8, 90)),
        mottle=float(rng.uniform(0, 0.15)),
        opacity_to_depth=float(rng.uniform(0.5, 1.0)) if glossy else 1.0,
    )


def patterned(rng: Generator, kind: str, tile_m: float) -> Material:
    """Any kind of the bank in random colours, repeated every `tile_m` metres."""
    base = wood_color(rng) if kind == "wood" else random_color(rng)
    if kind in INDEXED:
        table = region_table(rng, base)
    else:
        other = vary(rng, base, 0.25) if rng.random() < 0.7 else random_color(rng)
        table = ramp(base * np.float32(rng.uniform(0.4, 0.95)), base, other)
    shiny = rng.random() < 0.3
    return Material(
        pattern=pick(rng, kind),
        table=table,
        texel_from_m=tiled(rng, tile_m, turn=kind not in INDEXED),
        specular=float(rng.uniform(0.05, 0.5)) if shiny else 0.0,
        gloss=float(rng.uniform(5, 60)),
        mottle=float(rng.uniform(0, 0.2)),
    )


def region_table(rng: Generator, base: Color, *, spread: float | None = None) -> NDArray[np.float32]:
    """Table of indexed patterns whose region 0 is `base`; the others differ a little (`spread`) or at
    random."""
    if spread is None:
        colors = random_colors(rng, REGIONS)
    else:
        colors = np.clip(base + rng.normal(0, spread, (REGIONS, 3)), 0, 1).astype(np.float32)
    colors[0] = base
    return regions(colors, float(rng.uniform(0.02, 0.2)))


def printed(rng: Generator, base: Color, rect: Rect, kind: str = "print") -> Material:
    """A print on `base` spread once over rect (metres); a photo-like picture now and then."""
    if kind == "print" and rng.random() < 0.2:
        kind, table = "photo", ramp(*random_colors(rng, int(rng.integers(3, 7))))
    else:
        table = region_table(rng, base, spread=None if rng.random() < 0.7 else 0.2)
    return Material(
        pattern=pick(rng, kind),
        table=table,
        texel_from_m=fitted(rect),
        specular=float(rng.choice([0.0, 0.2, 0.5])),
        gloss=float(rng.uniform(10, 80)),
        mottle=float(rng.uniform(0, 0.25)),
        opacity_to_depth=float(rng.uniform(0.7, 1.0)),
    )


def scanned(rng: Generator, material: Material) -> Material:
    """The harsh look of a scanned mesh: strong blotches, no highlight."""
    return replace(material, mottle=float(rng.choice([rng.uniform(0.05, 0.25), rng.uniform(0.2, 0.5)])), specular=0.0)
