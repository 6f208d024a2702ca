"""What tells a box's front from its back: the hinge behind, the fastening in front.

Every real hinged box has both; of a closed one with neither nobody could say which way round it stands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_training.scenes.fittings import metal
from page_training.scenes.materials import Color, Material, plain, random_color
from page_training.scenes.meshes import Mesh, cuboid, shifted
from page_training.scenes.shapes import rod
from page_training.scenes.textures import Generator


@dataclass(frozen=True, slots=True)
class LidFront:
    """The closed lid's front edge, m: x and y of its middle, width, z of its underside, thickness."""

    x: float
    y: float
    width: float
    underside: float
    thickness: float


def _accent(rng: Generator, color: Color) -> Material:
    """Metal, any colour, or now and then the box's own."""
    draw = rng.random()
    if draw < 0.35:
        return metal(rng)
    return plain(rng, random_color(rng) if draw < 0.8 else color)


def hinge(
    rng: Generator, width: float, wall_y: float, pivot: tuple[float, float], color: Color
) -> tuple[list[Mesh], list[Mesh]]:
    """(of the base, of the lid): barrels on the axis through pivot (y, z), m, that stand out behind the wall at wall_y:
    a few short ones, one as long as the box, or some between leaves screwed to the wall."""
    y, z = pivot
    skin = _accent(rng, color)
    radius = float(rng.uniform(0.0022, 0.004)) + max(0.0, 0.6 * (wall_y - y))
    draw = rng.random()
    if draw < 0.35:
        count, share = 1, float(rng.uniform(0.55, 1.0))
    else:
        count, share = int(rng.integers(2, 5)), float(rng.uniform(0.15, 0.6))
    length = share * width / count
    places = (np.arange(count) + 0.5) / count - 0.5
    gap = width / count - length
    base: list[Mesh] = []
    lid: list[Mesh] = []
    for place in places * width:
        x = float(place + rng.uniform(-0.45, 0.45) * gap)
        barrel = rod(np.array([x - length / 2, y, z]), np.array([x + length / 2, y, z]), radius, skin, steps=10)
        (base if rng.random() < 0.6 else lid).append(barrel)
        if draw > 0.75:
            leaf = min(float(rng.uniform(0.006, 0.02)), 0.8 * z)
            size = (length * float(rng.uniform(0.7, 1.0)), 0.0012, leaf)
            base.append(shifted(cuboid(size, skin, bevel=0.0003), x, max(wall_y, y) + 0.0004, z - leaf))
    return base, lid


def fastening(
    rng: Generator, color: Color, base_front: tuple[float, float], lid_front: LidFront
) -> tuple[list[Mesh], list[Mesh]]:
    """(of the base, of the lid): a latch on the base, a clasp, magnet or tab on the lid's edge, or both.

    base_front: (y, height) of the base's front wall, m.
    """
    draw = rng.random()
    base = [_latch(rng, color, *base_front)] if draw < 0.55 else []
    return base, _clasp(rng, color, lid_front, base_front[1]) if draw > 0.25 else []


def _latch(rng: Generator, color: Color, y: float, height: float) -> Mesh:
    size = (rng.uniform(0.01, 0.05), rng.uniform(0.002, 0.006), height * rng.uniform(0.3, 0.95))
    z = (height - size[2]) * float(rng.uniform(0.3, 1.0))
    return shifted(cuboid(size, _accent(rng, color), bevel=0.0004), 0.0, y - size[1] / 2, z)


def _clasp(rng: Generator, color: Color, edge: LidFront, height: float) -> list[Mesh]:
    skin = _accent(rng, color)
    size = (rng.uniform(0.012, 0.05), rng.uniform(0.003, 0.012), edge.thickness + rng.uniform(0.0005, 0.003))
    x = edge.x + edge.width * float(rng.choice([0.0, 0.0, 0.25, -0.25]))
    y = edge.y + size[1] * float(rng.uniform(-0.45, 0.3))
    meshes = [shifted(cuboid(size, skin, bevel=0.0004), x, y, edge.underside - 0.0006)]
    if rng.random() < 0.4:
        tongue = cuboid((size[0] * 0.8, 0.0015, 0.5 * height), skin)
        meshes.append(shifted(tongue, x, edge.y - 0.001, edge.underside - 0.4 * height))
    return meshes
