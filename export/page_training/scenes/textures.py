"""A fixed bank of grey patterns that every scene colours anew through look-up tables.

A pattern holds one byte per texel; a material's table (256,3) turns bytes into colours. So one scene needs
no image of its own, a texture costs one gather per pixel, and the same few patterns give endless variety.
Two families: smooth patterns (wood, noise, ...) take a ramp of colours; indexed patterns (prints, keyboards,
screens) hold 16 regions of 16 shades each and take one colour per region.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

PATTERN_SIZE = 256
REGIONS = 16
BANK_SEED = 20240607

Image = NDArray[np.uint8]
Generator = np.random.Generator


@dataclass(frozen=True, eq=False, slots=True)
class PatternBank:
    """texels: (P,256,256) uint8. kinds: name -> indices of its patterns."""

    texels: Image
    kinds: dict[str, NDArray[np.intp]]


def smooth_noise(rng: Generator, rows: int, columns: int, size: int = PATTERN_SIZE) -> NDArray[np.float32]:
    """(size,size) noise in [0,1] with `rows` x `columns` cells; it tiles, so tables show no seams."""
    cells = np.pad(rng.random((rows, columns), dtype=np.float32), 2, mode="wrap")
    row = (np.arange(size, dtype=np.float32) + 0.5) * (rows / size) + 1.5
    column = (np.arange(size, dtype=np.float32) + 0.5) * (columns / size) + 1.5
    map_x, map_y = np.meshgrid(column, row)
    return np.clip(np.asarray(cv2.remap(cells, map_x, map_y, cv2.INTER_CUBIC), np.float32), 0.0, 1.0)


def _to_bytes(values: NDArray[np.floating]) -> Image:
    low, high = np.percentile(values, [0.5, 99.5])
    return np.clip((values - low) / max(high - low, 1e-6) * 255.0, 0, 255).astype(np.uint8)


def _octaves(rng: Generator, first: int, count: int, stretch: int = 1) -> NDArray[np.float32]:
    total = np.zeros((PATTERN_SIZE, PATTERN_SIZE), np.float32)
    for octave in range(count):
        cells = min(first * 2**octave, PATTERN_SIZE)
        total += smooth_noise(rng, cells, max(1, cells // stretch)) * 0.6**octave
    return total


def _noise(rng: Generator) -> Image:
    return _to_bytes(_octaves(rng, int(rng.integers(2, 24)), int(rng.integers(1, 5))))


def _grain(rng: Generator) -> Image:
    return _to_bytes(smooth_noise(rng, 256, 256) + 0.3 * smooth_noise(rng, 32, 32))


def _wood(rng: Generator) -> Image:
    v = np.linspace(0.0, 1.0, PATTERN_SIZE, endpoint=False, dtype=np.float32)[:, None]
    bend = _octaves(rng, 2, 2, 2) * rng.uniform(0.2, 1.5)
    rings = np.sin(2 * np.pi * (v * int(rng.integers(3, 24)) + bend))
    fibres = smooth_noise(rng, int(rng.choice([64, 128, 256])), int(rng.integers(2, 8))) + 0.6 * smooth_noise(
        rng, 64, 3
    )
    return _to_bytes(rings * rng.uniform(0.1, 0.8) + fibres * rng.uniform(0.6, 2.0))


def _marble(rng: Generator) -> Image:
    veins = np.abs(_octaves(rng, int(rng.integers(2, 6)), 4) - 1.1)
    return _to_bytes(np.sqrt(veins))


def _cloth(rng: Generator) -> Image:
    v, u = np.mgrid[0:PATTERN_SIZE, 0:PATTERN_SIZE].astype(np.float32) * (2 * np.pi / PATTERN_SIZE)
    threads = int(rng.integers(16, 64))
    return _to_bytes(np.sin(u * threads) * np.sin(v * threads) + 1.2 * _octaves(rng, 8, 3))


def _stripes(rng: Generator) -> Image:
    u = np.arange(PATTERN_SIZE, dtype=np.float32) / PATTERN_SIZE
    wave = np.sin(2 * np.pi * u * int(rng.integers(2, 20)))
    if rng.random() < 0.6:
        wave = np.sign(wave)
    field = np.broadcast_to(wave, (PATTERN_SIZE, PATTERN_SIZE)).copy()
    if rng.random() < 0.5:
        field = np.maximum(field, field.T)
    return _to_bytes(field + 0.15 * smooth_noise(rng, 32, 32))


def _tiles(rng: Generator) -> Image:
    rows, columns = int(rng.integers(2, 10)), int(rng.integers(1, 8))
    v, u = np.mgrid[0:PATTERN_SIZE, 0:PATTERN_SIZE] / PATTERN_SIZE
    row = (v * rows).astype(int)
    shifted = (u + (row % 2) * rng.choice([0.0, 0.5]) / columns) % 1.0
    shade = rng.random((rows, columns))[row, (shifted * columns).astype(int)]
    joint = ((v * rows) % 1.0 < 0.04 * rows / 4) | ((shifted * columns) % 1.0 < 0.02)
    return _to_bytes(np.where(joint, -0.5, shade) + 0.4 * smooth_noise(rng, 256, 16))


def _speckle(rng: Generator) -> Image:
    return _to_bytes((_octaves(rng, 64, 2) ** 3) + 0.7 * _octaves(rng, 4, 3))


def _photo(rng: Generator) -> Image:
    v, u = np.mgrid[0:PATTERN_SIZE, 0:PATTERN_SIZE].astype(np.float32) / PATTERN_SIZE
    slope = rng.normal(size=2)
    return _to_bytes(slope[0] * u + slope[1] * v + _octaves(rng, int(rng.integers(2, 6)), 4) * rng.uniform(0.5, 2.0))


def _shade(regions: Image, rng: Generator) -> Image:
    """Indexed regions (0-15) to bytes: a region's 16 shades carry a soft noise, so no area is perfectly
    flat."""
    noise = 0.6 * smooth_noise(rng, 12, 12) + 0.4 * smooth_noise(rng, 256, 256)
    return (regions * REGIONS + np.clip(noise * REGIONS, 0, REGIONS - 1)).astype(np.uint8)


def _words(rng: Generator, image: Image, box: tuple[int, int, int, int], line_px: int, region: int) -> None:
    """Draw lines of word-like bars into `box` (x,y,w,h): letters are smaller than a texel at these
    distances."""
    x, y, width, height = box
    for top in range(y, y + height - line_px // 2, line_px):
        column = x
        end = x + int(width * rng.uniform(0.5, 1.0))
        while column < end - 2:
            length = int(rng.integers(3, 5 * max(line_px // 3, 2)))
            right = min(column + length, end)
            cv2.rectangle(image, (column, top), (right, top + max(line_px // 2 - 1, 1)), int(region), -1)
            column += length + int(rng.integers(2, 5))


def _draw_shape(rng: Generator, image: Image) -> None:
    region = int(rng.integers(1, REGIONS))
    center = tuple(int(c) for c in rng.integers(0, PATTERN_SIZE, 2))
    radius = int(PATTERN_SIZE * rng.uniform(0.02, 0.22))
    match int(rng.integers(6)):
        case 0:
            cv2.circle(image, center, radius, region, -1 if rng.random() < 0.7 else 2)
        case 1:
            axes = (radius, max(1, int(radius * rng.uniform(0.3, 1.0))))
            cv2.ellipse(image, center, axes, float(rng.uniform(0, 180)), 0, 360, region, -1)
        case 2:
            spokes = int(rng.integers(3, 11))
            angle = np.arange(spokes) * 2 * np.pi / spokes + rng.uniform(0, 7)
            reach = radius * np.where(np.arange(spokes) % 2, rng.uniform(0.3, 1.0), 1.0)
            corners = np.stack([np.cos(angle), np.sin(angle)], 1) * reach[:, None] + np.array(center)
            cv2.fillPoly(image, [corners.astype(np.int32)], region)
        case 3:
            far = (
                center[0] + int(radius * rng.uniform(0.5, 2.5)),
                center[1] + int(radius * rng.uniform(0.3, 1.5)),
            )
            cv2.rectangle(image, center, far, region, -1 if rng.random() < 0.7 else 2)
        case 4:
            word = "".join(chr(int(c)) for c in rng.integers(65, 91, int(rng.integers(2, 10))))
            scale = float(rng.uniform(0.4, 2.2))
            cv2.putText(image, word, center, cv2.FONT_HERSHEY_DUPLEX, scale, region, int(rng.integers(1, 4)))
        case _:  # a face: the commonest print on children's boxes
            cv2.circle(image, center, radius, region, -1)
            for side in (-1, 1):
                eye = (center[0] + side * radius // 3, center[1] - radius // 4)
                cv2.circle(image, eye, max(radius // 7, 1), (region + 5) % REGIONS, -1)
                cv2.circle(image, (center[0] + side * radius, center[1] - radius), radius // 2, region, -1)
            cv2.ellipse(image, center, (radius // 2, radius // 2), 0, 20, 160, (region + 7) % REGIONS, 2)


def _print(rng: Generator) -> Image:
    image = np.zeros((PATTERN_SIZE, PATTERN_SIZE), np.uint8)
    for _ in range(int(rng.integers(2, 40))):
        _draw_shape(rng, image)
    if rng.random() < 0.4:
        x, y = (int(c) for c in rng.integers(0, 160, 2))
        _words(
            rng,
            image,
            (x, y, 90, int(rng.integers(20, 90))),
            int(rng.integers(4, 12)),
            int(rng.integers(1, REGIONS)),
        )
    return _shade(image, rng)


def _leaflet(rng: Generator) -> Image:
    """A printed card: border, table or text, a small picture."""
    image = np.zeros((PATTERN_SIZE, PATTERN_SIZE), np.uint8)
    cv2.rectangle(image, (8, 8), (247, 247), 1, -1)
    left = int(rng.integers(12, 90))
    _words(rng, image, (left, 24, 240 - left, 210), int(rng.integers(7, 20)), 2)
    for _ in range(int(rng.integers(0, 5))):
        _draw_shape(rng, image)
    return _shade(image, rng)


def _keyboard(rng: Generator) -> Image:
    """Region 0 gaps, 1 keys, 2 legends, 3 the longer keys."""
    image = np.zeros((PATTERN_SIZE, PATTERN_SIZE), np.uint8)
    rows, gap = int(rng.integers(5, 7)), float(rng.uniform(0.06, 0.2))
    for row in range(rows):
        widths = np.ones(int(rng.integers(12, 17)))
        if row == rows - 1:
            widths = np.array([1.2, 1, 1, 1.2, rng.uniform(4, 6.5), 1.2, 1, 1, 1, 1])
        else:
            widths[[0, -1]] = rng.uniform(1.0, 2.2, 2)
        right = np.cumsum(widths) / widths.sum() * PATTERN_SIZE
        height = PATTERN_SIZE / rows
        for end, width in zip(right, widths * PATTERN_SIZE / widths.sum(), strict=True):
            half = gap * height / 4
            corner = (int(end - width + half), int(row * height + 2 * half))
            far = (int(end - half) - 1, int((row + 1) * height - 2 * half) - 1)
            cv2.rectangle(image, corner, far, 1 if width < 25 else 3, -1)
            middle = ((corner[0] + far[0]) // 2, (corner[1] + far[1]) // 2)
            cv2.circle(image, middle, int(rng.integers(1, 4)), 2, -1)
    return _shade(image, rng)


def _screen(rng: Generator) -> Image:
    """Desktop, windows with title bars and text, icons, task bar."""
    image = np.zeros((PATTERN_SIZE, PATTERN_SIZE), np.uint8)
    for _ in range(int(rng.integers(0, 8))):
        _draw_shape(rng, image)
    for _ in range(int(rng.integers(0, 5))):
        x, y = (int(c) for c in rng.integers(0, 150, 2))
        width, height = (int(c) for c in rng.integers(60, 220, 2))
        body = int(rng.integers(1, REGIONS))
        cv2.rectangle(image, (x, y), (x + width, y + height), body, -1)
        cv2.rectangle(image, (x, y), (x + width, y + 9), (body + 3) % REGIONS, -1)
        for column in range(int(rng.integers(1, 3))):
            box = (x + 6 + column * width // 2, y + 16, width // 2 - 12, height - 24)
            _words(rng, image, box, int(rng.integers(4, 10)), (body + 1 + column) % REGIONS)
    if rng.random() < 0.6:
        cv2.rectangle(image, (0, 242), (255, 255), int(rng.integers(1, REGIONS)), -1)
    return _shade(image, rng)


SMOOTH: dict[str, tuple[Callable[[Generator], Image], int]] = {
    "noise": (_noise, 16), "grain": (_grain, 4), "wood": (_wood, 16), "marble": (_marble, 8), "cloth":
    (_cloth, 8), "stripes": (_stripes, 10), "tiles": (_tiles, 8), "speckle": (_speckle, 8), "photo": (_photo,
    16),
}  # fmt: skip
INDEXED: dict[str, tuple[Callable[[Generator], Image], int]] = {
    "print": (_print, 48), "leaflet": (_leaflet, 16), "keyboard": (_keyboard, 12), "screen": (_screen, 24),
}  # fmt: skip


@lru_cache(maxsize=1)
def pattern_bank() -> PatternBank:
    """The bank, made once a process from its own fixed seed so that scenes depend on their Generator
    alone."""
    rng = np.random.default_rng(BANK_SEED)
    images: list[Image] = []
    kinds: dict[str, NDArray[np.intp]] = {}
    for name, (make, count) in (SMOOTH | INDEXED).items():
        kinds[name] = np.arange(len(images), len(images) + count)
        images.extend(make(rng) for _ in range(count))
    return PatternBank(np.stack(images), kinds)
