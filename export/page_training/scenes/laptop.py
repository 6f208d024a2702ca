"""Category "laptop": a base with keyboard and touch pad, a thin lid with a screen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from page_runtime.geometry import rotation_about, transform_from
from page_training.categories import CATEGORIES
from page_training.scenes.articulated import ArticulatedObject, States, articulated_object
from page_training.scenes.materials import (
    Color,
    Material,
    fitted,
    hsv_color,
    patterned,
    pick,
    plain,
    printed,
    random_color,
    region_table,
    regions,
    vary,
)
from page_training.scenes.meshes import (
    Mesh,
    cuboid,
    moved,
    plate,
    repeated,
    revolved,
    rounded_rectangle,
    shifted,
)
from page_training.scenes.textures import REGIONS, Generator


def distance_m(_: ArticulatedObject) -> tuple[float, float]:
    return (0.5, 1.8)


@dataclass(frozen=True, eq=False, slots=True)
class _Body:
    """Sizes in metres: width x, depth y, base and lid thickness, corner radius, bevel of the rims."""

    width: float
    depth: float
    base: float
    lid: float
    radius: float
    bevel: float


def _opening(rng: Generator) -> float:
    """Opening angle, rad: most laptops stand open at 60-130 degrees."""
    draw = rng.random()
    if draw < 0.72:
        return float(np.radians(np.clip(rng.normal(103, 20), 60, 140)))
    if draw < 0.80:
        return float(np.radians(rng.uniform(0, 20)))
    return float(np.radians(rng.uniform(15, 175)))


def sample_states(rng: Generator, _: ArticulatedObject) -> States:
    """The hinge, rad."""
    return (_opening(rng),)


def _sizes(rng: Generator) -> _Body:
    width = float(rng.uniform(0.26, 0.42))
    depth = float(np.clip(width * rng.uniform(0.6, 0.78), 0.18, 0.30))
    base = float(rng.uniform(0.008, 0.018) if rng.random() < 0.6 else rng.uniform(0.015, 0.035))
    lid = float(rng.uniform(0.004, 0.008) if rng.random() < 0.7 else rng.uniform(0.006, 0.013))
    return _Body(width, depth, base, lid, float(rng.uniform(0.001, 0.018)), float(rng.uniform(0.0003, 0.003)))


def _shell_color(rng: Generator) -> Color:
    draw = rng.random()
    if draw < 0.4:  # silver, space grey
        return hsv_color(rng.uniform(0.55, 0.7), rng.uniform(0, 0.08), rng.uniform(0.4, 0.9))
    if draw < 0.75:  # black
        return hsv_color(rng.random(), rng.uniform(0, 0.2), rng.uniform(0.02, 0.2))
    if draw < 0.87:  # white
        return hsv_color(rng.random(), rng.uniform(0, 0.06), rng.uniform(0.85, 1.0))
    return random_color(rng)


def _panel(width: float, depth: float, z: float, height: float, radius: float, skin: Material) -> Mesh:
    """A thin raised panel, its top at z + height."""
    return plate(rounded_rectangle(width, depth, radius, 2), z, z + height, 1e-5, skin)


def _keyboard(rng: Generator, body: _Body, shell: Color, deck: Material) -> list[Mesh]:
    width, depth = body.width * float(rng.uniform(0.72, 0.97)), body.depth * float(rng.uniform(0.36, 0.5))
    y = body.depth * float(rng.uniform(0.13, 0.24))
    keys = hsv_color(rng.random(), 0.05, rng.uniform(0.02, 0.15)) if rng.random() < 0.7 else vary(rng, shell, 0.1)
    legend = hsv_color(rng.random(), 0.05, rng.uniform(0.6, 1.0)) if keys.mean() < 0.4 else np.zeros(3, np.float32)
    gap = vary(rng, shell, 0.1) * (1.0 if rng.random() < 0.5 else 0.3)
    colors = np.stack([gap, keys, legend, vary(rng, keys, 0.1)] + [keys] * (REGIONS - 4)).astype(np.float32)
    field = replace(
        printed(rng, keys, (-width / 2, depth / 2, width, -depth)),
        pattern=pick(rng, "keyboard"),
        table=regions(np.clip(colors, 0, 1)),
        mottle=0.05,
    )
    meshes = [shifted(_panel(width, depth, body.base - 1e-4, 5e-4, 0.002, field), 0, y, 0)]
    if rng.random() < 0.25:  # relief: real keys instead of a picture
        cap = plain(rng, keys)
        rows = 6
        pitch_y = depth / rows
        for row in range(rows):
            count = 15 if row < 5 else 9
            pitch = width / count
            height = float(rng.uniform(0.0012, 0.002))
            key = _panel(pitch * 0.86, pitch_y * 0.86, body.base, height, 0.001, cap)
            places = np.zeros((count, 3))
            places[:, 0] = (np.arange(count) + 0.5) * pitch - width / 2
            places[:, 1] = y - depth / 2 + (row + 0.5) * pitch_y
            meshes.append(repeated(key, places))
    if rng.random() < 0.93:
        pad = deck if rng.random() < 0.3 else plain(rng, vary(rng, shell, 0.12), contrast=0.02)
        size = (body.width * float(rng.uniform(0.2, 0.45)), body.depth * float(rng.uniform(0.2, 0.33)))
        x = body.width * float(rng.choice([0.0, 0.0, -0.06]))
        room = y - depth / 2 + body.depth / 2
        meshes.append(
            shifted(
                _panel(size[0], min(size[1], 0.85 * room), body.base, 4e-4, 0.003, pad),
                x,
                room / 2 - body.depth / 2,
                0,
            )
        )
    for _ in range(int(rng.choice([0, 0, 1, 2, 3]))):  # stickers on the palm rest
        size = rng.uniform(0.01, 0.03, 2)
        sticker = printed(rng, random_color(rng), (-size[0] / 2, size[1] / 2, size[0], -size[1]))
        place = (
            float(rng.choice([-1, 1])) * body.width * rng.uniform(0.3, 0.43),
            -body.depth * rng.uniform(0.3, 0.42),
        )
        meshes.append(shifted(_panel(size[0], size[1], body.base, 3e-4, 0.001, sticker), place[0], place[1], 0))
    return meshes


def _base(rng: Generator, body: _Body, shell: Color) -> list[Mesh]:
    outside, deck = plain(rng, shell, contrast=0.03), plain(rng, vary(rng, shell, 0.08), contrast=0.03)
    loop = rounded_rectangle(body.width, body.depth, body.radius)
    foot = min(0.002, body.base / 4)
    meshes = [plate(loop, foot, body.base, body.bevel, [outside, outside, outside, outside, deck])]
    meshes += _keyboard(rng, body, shell, deck)
    dark = plain(rng, hsv_color(0, 0, rng.uniform(0.02, 0.2)))
    for x in (-0.4, 0.4):
        for y in (-0.4, 0.4):
            meshes.append(shifted(cuboid((0.02, 0.008, foot + 1e-3), dark), x * body.width, y * body.depth, 0))
    for _ in range(int(rng.integers(0, 6))):  # ports in the sides
        size = (0.0008, rng.uniform(0.006, 0.016), body.base * rng.uniform(0.2, 0.4))
        side = float(rng.choice([-1, 1]))
        place = (side * body.width / 2, body.depth * rng.uniform(-0.2, 0.42), foot + body.base * 0.3)
        meshes.append(shifted(cuboid(size, dark), *place))
    wedge = float(rng.uniform(0.2, 0.6)) if rng.random() < 0.35 else 0.0
    return [_tapered(mesh, wedge, body) for mesh in meshes]


def _tapered(mesh: Mesh, wedge: float, body: _Body) -> Mesh:
    """The mesh thinned towards the front: heights shrink by up to `wedge` of themselves."""
    vertices = mesh.vertices.copy()
    vertices[:, 2] *= 1 - wedge * np.clip(0.5 - vertices[:, 1] / body.depth, 0, 1)
    return replace(mesh, vertices=vertices)


def _display(rng: Generator, rect: tuple[float, float, float, float]) -> Material:
    """Off (dark glass), or lit with random windows or a picture."""
    lit, draw = float(rng.uniform(0.3, 1.0)), rng.random()
    if draw < 0.35:
        look = plain(rng, hsv_color(rng.random(), 0.2, rng.uniform(0.01, 0.12)), kind="noise")
    elif draw < 0.5:
        look = replace(patterned(rng, "photo", 0.3), emission=lit)
    else:
        table = region_table(rng, random_color(rng), spread=0.25 if rng.random() < 0.3 else None)
        look = Material(pick(rng, "screen"), table, fitted(rect), emission=lit)
    glass = rng.random() < 0.6
    return replace(
        look,
        texel_from_m=fitted(rect),
        specular=float(rng.uniform(0.2, 0.9)) if glass else 0.05,
        gloss=float(rng.uniform(20, 150)),
        opacity_to_depth=float(rng.uniform(0.05, 0.6)) if glass else float(rng.uniform(0.5, 1.0)),
    )


def _lid(rng: Generator, body: _Body, shell: Color) -> list[Mesh]:
    rest = body.base + float(rng.uniform(0.001, 0.0025))
    width, depth = body.width * float(rng.uniform(0.985, 1.0)), body.depth * float(rng.uniform(0.93, 1.0))
    y = (body.depth - depth) / 2 * float(rng.uniform(-1, 1))
    back_color = shell if rng.random() < 0.7 else _shell_color(rng)
    rect = (-width / 2, -depth / 2, width, depth)
    back, rim = plain(rng, back_color, contrast=0.03), plain(rng, shell, contrast=0.03)
    if rng.random() < 0.12:
        back = printed(rng, back_color, rect)
    frame = plain(rng, hsv_color(0, 0, rng.uniform(0.01, 0.1))) if rng.random() < 0.75 else rim
    loop = rounded_rectangle(width, depth, body.radius)
    meshes = [plate(loop, rest, rest + body.lid, min(body.bevel, body.lid / 3), [frame, rim, rim, rim, back])]
    sides, top, chin = (
        width * rng.uniform(0.012, 0.06),
        depth * rng.uniform(0.02, 0.1),
        depth * rng.uniform(0.04, 0.16),
    )
    screen = (width - 2 * sides, depth - top - chin)
    glass = _display(rng, (-screen[0] / 2, -screen[1] / 2, screen[0], screen[1]))
    middle = (top - chin) / 2
    meshes.append(shifted(_panel(screen[0], screen[1], rest - 3e-4, 5e-4, 0.001, glass), 0, middle, 0))
    if rng.random() < 0.6:  # logo on the back, upright for whoever faces it
        logo = plain(rng, random_color(rng))
        size = float(rng.uniform(0.01, 0.03))
        mark = revolved([(size, 0), (size, 3e-4)], logo, int(rng.choice([4, 6, 20])))
        meshes.append(shifted(mark, 0, depth * float(rng.choice([0.0, 0.0, 0.3])), rest + body.lid))
    for _ in range(int(rng.choice([0, 0, 0, 0, 2, 6]))):  # stickers on the back
        size = rng.uniform(0.02, 0.09, 2)
        sticker = printed(rng, random_color(rng), (-size[0] / 2, -size[1] / 2, size[0], size[1]))
        place = rng.uniform(-0.3, 0.3, 2) * np.array([width, depth])
        mesh = _panel(size[0], size[1], rest + body.lid - 1e-4, 4e-4, float(rng.uniform(0.001, 0.02)), sticker)
        meshes.append(shifted(mesh, place[0], place[1], 0))
    if rng.random() < 0.7:  # camera above the screen
        eye = revolved([(0.002, 0), (0.002, 6e-4)], plain(rng, hsv_color(0, 0, 0.05)), 8)
        meshes.append(shifted(eye, 0, -depth / 2 + top / 2, rest - 5e-4))
    return [shifted(mesh, 0, y, 0) for mesh in meshes]


def sample_object(rng: Generator) -> ArticulatedObject:
    """A random laptop."""
    body = _sizes(rng)
    shell = _shell_color(rng)
    base, lid = _base(rng, body, shell), _lid(rng, body, shell)
    hinge_y = body.depth / 2 - float(rng.uniform(0.0, 0.012))
    hinge_z = body.base + float(rng.uniform(0.0, body.lid))
    barrel = plain(rng, shell if rng.random() < 0.5 else hsv_color(0, 0, 0.05))
    turn = rotation_about(np.array([0.0, 1.0, 0.0]), np.pi / 2)
    radius = float(rng.uniform(0.003, 0.006))
    owner = base if rng.random() < 0.5 else lid
    spans = [(0.0, 0.8)] if rng.random() < 0.5 else [(-0.36, 0.1), (0.36, 0.1)]
    for x, length in spans:
        half = body.width * length / 2
        cylinder = revolved([(radius, -half), (radius, half)], barrel, 12)
        owner.append(moved(cylinder, transform_from(turn, np.array([x * body.width, hinge_y, hinge_z - radius * 0.3]))))
    return articulated_object(CATEGORIES["laptop"].joints, (base, lid), [(0.0, hinge_y, hinge_z)])
