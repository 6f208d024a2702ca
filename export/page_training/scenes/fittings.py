"""What things are finished with, whatever they are: surfaces, handles, feet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from page_training.scenes.materials import (
    Color,
    Material,
    hsv_color,
    patterned,
    plain,
    printed,
    random_color,
    vary,
    wood_color,
)
from page_training.scenes.meshes import Mesh, ball, cuboid, repeated, revolved, shifted
from page_training.scenes.shapes import block, ellipse, rod, slab, tube, upright_to
from page_training.scenes.textures import Generator


def gray(rng: Generator, low: float, high: float) -> Color:
    return hsv_color(rng.random(), rng.uniform(0.0, 0.08), rng.uniform(low, high))


def metal(rng: Generator) -> Material:
    """Steel, brass, black or painted metal."""
    draw = rng.random()
    if draw < 0.55:
        color = gray(rng, 0.45, 0.9)
    elif draw < 0.7:
        color = hsv_color(rng.uniform(0.08, 0.14), rng.uniform(0.3, 0.7), rng.uniform(0.4, 0.85))
    elif draw < 0.88:
        color = gray(rng, 0.02, 0.2)
    else:
        color = random_color(rng)
    return plain(rng, color, contrast=0.04)


def finish(rng: Generator, color: Color | None = None) -> Material:
    """The surface of furniture and housings: wood, paint, plastic, veneer, or a pattern all over."""
    draw = rng.random()
    if color is not None:
        return plain(rng, color, contrast=float(rng.uniform(0.01, 0.1)))
    if draw < 0.33:
        return patterned(rng, "wood", float(rng.uniform(0.15, 1.0)))
    if draw < 0.43:
        return plain(rng, wood_color(rng), contrast=float(rng.uniform(0.02, 0.2)), kind="noise")
    if draw < 0.62:
        return plain(rng, gray(rng, 0.7, 1.0), contrast=0.03)
    if draw < 0.72:
        return plain(rng, gray(rng, 0.02, 0.55), contrast=0.04)
    if draw < 0.92:
        return plain(rng, random_color(rng))
    kinds = ["marble", "cloth", "stripes", "speckle", "photo", "tiles", "grain"]
    return patterned(rng, str(rng.choice(kinds)), float(rng.uniform(0.05, 0.5)))


def related(rng: Generator, material: Material) -> Material:
    """The same surface, a shade of another one, or quite another."""
    draw = rng.random()
    if draw < 0.6:
        return material
    return finish(rng) if draw < 0.85 else plain(rng, vary(rng, np.asarray(material.table[128]), 0.15))


def decorated(rng: Generator, base: Material, rect: tuple[float, float, float, float], chance: float) -> Material:
    """`base`, or a print on its colour over rect (metres)."""
    if rng.random() > chance:
        return base
    kind = str(rng.choice(["print", "leaflet", "print"]))
    return printed(rng, np.asarray(base.table[128]), rect, kind)


def _no_handle(*_: float) -> list[Mesh]:
    return []


Handle = Callable[[float, float, float], list[Mesh]]


def sample_handle(rng: Generator, width: float, height: float, *, chance: float = 0.9) -> Handle:
    """A kind of handle for fronts of about width x height metres that look towards -y.

    What it returns is called with a place (x, y, z): the middle of the handle on the front's surface.
    """
    small = min(width, height)
    skin = metal(rng) if rng.random() < 0.6 else plain(rng, random_color(rng))
    out = float(np.clip(rng.uniform(0.1, 0.4) * small, 0.006, 0.05))
    draw = rng.random()
    if draw > chance:
        return _no_handle
    draw /= chance
    if draw < 0.3:
        return _knob(rng, skin, small, out)
    if draw < 0.62:
        return _bar(rng, skin, width, height, out)
    if draw < 0.74:
        return _cup(rng, skin, width, out)
    if draw < 0.86:
        return _strip(rng, skin, width, height)
    return _ring(rng, skin, small)


def _knob(rng: Generator, skin: Material, small: float, out: float) -> Handle:
    radius = float(np.clip(rng.uniform(0.07, 0.22) * small, 0.004, 0.025))
    neck = radius * float(rng.uniform(0.3, 0.9))
    if rng.random() < 0.25:
        size = (2 * radius, 2 * radius * rng.uniform(0.6, 1.6), out)
        made = cuboid(size, skin, bevel=radius * float(rng.uniform(0.02, 0.3)))
    elif rng.random() < 0.4:
        made = shifted(ball(radius, skin, 14), 0, 0, max(out - radius, 0.0))
    else:
        profile = [(neck, 0), (neck, 0.5 * out), (radius, 0.65 * out), (radius, 0.9 * out), (radius * 0.7, out)]
        made = revolved(profile, skin, int(rng.choice([6, 10, 16])))
    made = upright_to("-y", made)
    return lambda x, y, z: [shifted(made, x, y, z)]


def _bar(rng: Generator, skin: Material, width: float, height: float, out: float) -> Handle:
    upright = rng.random() < 0.12
    room = height if upright else width
    half = 0.5 * float(np.clip(rng.uniform(0.15, 0.9) * room, 0.02, room * 0.95))
    thick = float(np.clip(rng.uniform(0.06, 0.25) * out * 2, 0.003, 0.016))
    arched = rng.random() < 0.35

    def bar(x: float, y: float, z: float) -> list[Mesh]:
        along = np.array([0.0, 0.0, 1.0]) if upright else np.array([1.0, 0.0, 0.0])
        middle, outward = np.array([x, y, z]), np.array([0.0, -1.0, 0.0])
        if arched:
            share = np.linspace(-1, 1, 9)
            path = middle + half * share[:, None] * along + out * (1 - share**4)[:, None] * outward
            return [tube(path, np.cross(along, outward), thick, thick * 1.6, skin)]
        posts = [middle + sign * half * 0.8 * along for sign in (-1, 1)]
        meshes = [rod(post, post + out * outward, thick / 2, skin, 8) for post in posts]
        ends = [middle + sign * half * along + out * outward for sign in (-1, 1)]
        return [*meshes, rod(ends[0], ends[1], thick / 2, skin, 8)]

    return bar


def _cup(rng: Generator, skin: Material, width: float, out: float) -> Handle:
    half = 0.5 * float(np.clip(rng.uniform(0.15, 0.5) * width, 0.02, 0.12))
    deep = float(rng.uniform(0.5, 1.0)) * out
    angle = np.linspace(0, np.pi, 9)
    outline = np.stack([half * np.cos(angle), -deep * np.sin(angle)], axis=1)
    made = slab(outline, -0.2 * out, 0.5 * out, 0.1 * out, skin)
    return lambda x, y, z: [shifted(made, x, y, z)]


def _strip(rng: Generator, skin: Material, width: float, height: float) -> Handle:
    """A dark groove or a strip glued on, along the front."""
    size = (
        width * float(rng.uniform(0.2, 0.95)),
        0.0015 + 0.1 * height * rng.random() ** 3,
        height * float(rng.uniform(0.05, 0.2)),
    )
    dark = plain(rng, gray(rng, 0.02, 0.2)) if rng.random() < 0.6 else skin
    made = block((-size[0] / 2, -size[1], -size[2] / 2), (size[0] / 2, 1e-4, size[2] / 2), dark)
    return lambda x, y, z: [shifted(made, x, y, z)]


def _ring(rng: Generator, skin: Material, small: float) -> Handle:
    radius = float(np.clip(rng.uniform(0.12, 0.25) * small, 0.008, 0.035))
    loop = ellipse(2 * radius, 2 * radius, 14)
    path = np.stack([loop[:, 0], np.full(len(loop), -0.004), loop[:, 1] - 0.6 * radius], axis=1)
    ring = tube(path, np.array([0.0, 1.0, 0.0]), 0.18 * radius, 0.18 * radius, skin, steps=6, closed=True)
    plate = upright_to("-y", revolved([(0.4 * radius, 0), (0.4 * radius, 0.003)], skin, 10))
    return lambda x, y, z: [shifted(plate, x, y, z), shifted(ring, x, y, z)]


def feet(
    rng: Generator, low: tuple[float, float], high: tuple[float, float], skin: Material
) -> tuple[list[Mesh], float]:
    """Feet under a body whose floor plan reaches from low to high (x,y), standing on z = 0, and how high they are."""
    width, depth = high[0] - low[0], high[1] - low[1]
    size = min(width, depth)
    draw = rng.random()
    if draw < 0.45:
        return [], 0.0
    if draw < 0.6:  # plinth
        tall = float(rng.uniform(0.01, 0.08)) * size / 0.4
        back = float(rng.uniform(0.0, 0.08)) * size
        return [block((low[0] + back, low[1] + back, 0), (high[0] - back, high[1] - back, tall + 1e-4), skin)], tall
    tall = float(rng.uniform(0.02, 0.6 if rng.random() < 0.35 else 0.12)) * size
    thick = float(rng.uniform(0.03, 0.12)) * size
    if draw < 0.75:
        leg = revolved([(thick * rng.uniform(0.25, 0.5), 0), (thick / 2, tall + 1e-4)], skin, 10)
    elif draw < 0.9:
        leg = cuboid((thick, thick, tall + 1e-4), skin)
    else:
        radius = min(tall / 2, 0.03)
        leg = ball(radius, plain(rng, gray(rng, 0.02, 0.3)), 10)
        tall = 2 * radius
    inside = thick * float(rng.uniform(0.5, 1.0))
    corners = [(x, y, 0.0) for x in (low[0] + inside, high[0] - inside) for y in (low[1] + inside, high[1] - inside)]
    return [repeated(leg, np.array(corners))], tall
