"""Category "box": hinged pencil cases, tins, lunch boxes, gift boxes and small chests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from page_runtime.geometry import rotation_about, transform_from
from page_training.categories import CATEGORIES
from page_training.scenes.articulated import ArticulatedObject, States, articulated_object
from page_training.scenes.box_closing import LidFront, fastening, hinge
from page_training.scenes.materials import Color, Material, plain, printed, random_color, scanned, vary
from page_training.scenes.meshes import (
    Mesh,
    Points,
    cuboid,
    joined,
    moved,
    plate,
    revolved,
    roughened,
    rounded_rectangle,
    shifted,
    tray,
)
from page_training.scenes.textures import Generator


def distance_m(_: ArticulatedObject) -> tuple[float, float]:
    return (0.4, 1.3)


@dataclass(frozen=True, eq=False, slots=True)
class _Body:
    """Sizes in metres of the base: width x, depth y, height z, wall and floor thickness, corner radius."""

    width: float
    depth: float
    height: float
    wall: float
    floor: float
    radius: float


def _opening(rng: Generator) -> float:
    """Opening angle, rad: rarely nearly closed, otherwise anything up to flat on the table."""
    draw = rng.random()
    if draw < 0.10:
        return float(np.radians(rng.uniform(0, 20)))
    if draw < 0.17:
        return float(np.radians(rng.uniform(165, 180)))
    return float(np.radians(rng.uniform(20, 180)))


def sample_states(rng: Generator, _: ArticulatedObject) -> States:
    """The hinge, rad."""
    return (_opening(rng),)


def _sizes(rng: Generator) -> _Body:
    if rng.random() < 0.75:  # pencil cases
        width, depth = rng.uniform(0.185, 0.255), rng.uniform(0.065, 0.105)
        height = rng.uniform(0.014, 0.042)
    else:
        width, depth = rng.uniform(0.13, 0.32), rng.uniform(0.06, 0.20)
        height = rng.uniform(0.015, 0.10)
        depth = min(depth, width)
    wall = rng.uniform(0.001, 0.004)
    floor = height * rng.uniform(0.05, 0.6) if rng.random() < 0.5 else rng.uniform(0.001, 0.004)
    radius = rng.uniform(0.0005, 0.004) if rng.random() < 0.4 else rng.uniform(0.004, 0.3 * depth)
    return _Body(width, depth, height, wall, floor, radius)


def _colors(rng: Generator) -> tuple[Color, Color]:
    base = random_color(rng)
    draw = rng.random()
    if draw < 0.4:
        return base, base
    return base, vary(rng, base, 0.15) if draw < 0.55 else random_color(rng)


def _knob(rng: Generator, skin: Material) -> Mesh:
    """Something small inside: an eraser, a sharpener, a box of staples, a glue stick."""
    size = rng.uniform([0.012, 0.008, 0.006], [0.05, 0.025, 0.018]).tolist()
    if rng.random() < 0.3:
        return revolved([(size[1] / 2, 0), (size[1] / 2, size[2])], skin, 14)
    return cuboid(size, skin, bevel=float(rng.uniform(0.0003, 0.003)))


def _pen(rng: Generator, length: float) -> Mesh:
    """A pen or pencil lying along x, its axis one radius above z = 0."""
    body, tip = plain(rng, random_color(rng)), plain(rng, random_color(rng))
    radius = float(rng.uniform(0.003, 0.006))
    profile = [(radius * 0.2, 0.0), (radius, 0.08 * length), (radius, 0.7 * length), (radius * 0.9, length)]
    mesh = revolved(profile, [tip, tip, body, tip, tip], steps=int(rng.choice([6, 12])))
    lie = transform_from(rotation_about(np.array([0.0, 1.0, 0.0]), np.pi / 2), np.array([-length / 2, 0.0, radius]))
    return moved(mesh, lie)


def _inside(rng: Generator, body: _Body, skin: Material) -> tuple[list[Mesh], list[Mesh]]:
    """Things in the base: (attached to it, loose)."""
    width, depth = body.width - 2 * body.wall, body.depth - 2 * body.wall
    room = body.height - body.floor
    attached: list[Mesh] = []
    loose: list[Mesh] = []
    accent = plain(rng, random_color(rng)) if rng.random() < 0.6 else skin
    for _ in range(int(rng.choice([0, 0, 1, 1, 2, 3]))):
        tall = room * float(rng.uniform(0.3, 0.98))
        if rng.random() < 0.6:
            wall = cuboid((rng.uniform(0.001, 0.003), depth, tall), skin)
            attached.append(shifted(wall, width * rng.uniform(-0.48, 0.48), 0, body.floor))
        else:
            length = width * rng.uniform(0.4, 1.0)
            wall = cuboid((length, rng.uniform(0.001, 0.003), tall), skin)
            side = float(rng.choice([-1, 1]))
            attached.append(shifted(wall, side * (width - length) / 2, depth * rng.uniform(-0.4, 0.4), body.floor))
    if rng.random() < 0.3:  # a comb of pen holders
        count, pitch = int(rng.integers(2, 7)), float(rng.uniform(0.008, 0.013))
        size = (
            rng.uniform(0.008, 0.03),
            pitch * rng.uniform(0.3, 0.7),
            min(room * rng.uniform(0.4, 1.0), 0.015),
        )
        x, y = width * rng.uniform(-0.4, 0.4), -pitch * (count - 1) / 2
        attached += [shifted(cuboid(size, accent, bevel=0.001), x, y + k * pitch, body.floor) for k in range(count)]
    if rng.random() < 0.3:  # an inserted tray
        w, d = width * rng.uniform(0.2, 0.6), depth * rng.uniform(0.5, 0.95)
        top = room * rng.uniform(0.4, 0.98)
        insert = tray(rounded_rectangle(w, d, 0.003), 0, top, 0.0015, 0.0015, 0.0003, accent)
        attached.append(shifted(insert, rng.choice([-1, 1]) * (width - w) / 2 * 0.95, 0, body.floor))
    if rng.random() < 0.15:  # a lever or ramp standing up
        size = (rng.uniform(0.01, 0.03), rng.uniform(0.01, 0.03), 0.0015)
        turn = rotation_about(np.array([0.0, 1.0, 0.0]), float(rng.uniform(-1.2, 1.2)))
        place = np.array([width * rng.uniform(-0.35, 0.35), 0.0, body.floor + min(room, 0.02) * 0.6])
        attached.append(moved(cuboid(size, accent), transform_from(turn, place)))
    for _ in range(int(rng.choice([0, 0, 0, 1, 2]))):
        knob = _knob(rng, plain(rng, random_color(rng)))
        place = rng.uniform(-0.4, 0.4, 2) * np.array([width, depth])
        (attached if rng.random() < 0.5 else loose).append(shifted(knob, place[0], place[1], body.floor))
    for _ in range(int(rng.choice([0, 0, 0, 1, 2, 4]))):
        pen = _pen(rng, min(float(rng.uniform(0.09, 0.18)), 0.95 * width))
        turn = rotation_about(np.array([0.0, 0.0, 1.0]), float(rng.normal(0, 0.06)))
        y = (depth / 2 - 0.012) * rng.uniform(-1, 1)
        loose.append(moved(pen, transform_from(turn, np.array([0.0, y, body.floor]))))
    return attached, loose


def _base(
    rng: Generator, body: _Body, color: Color, rough: Callable[[Points], Points]
) -> tuple[list[Mesh], list[Mesh]]:
    outside = plain(rng, color)
    wall = outside
    if rng.random() < 0.3:
        wall = printed(rng, color, (-body.width / 2, body.height, body.width, -body.height))
    inner = outside if rng.random() < 0.75 else plain(rng, random_color(rng))
    rect = (-body.width / 2, body.depth / 2, body.width, -body.depth)
    floor = printed(rng, random_color(rng), rect, "leaflet") if rng.random() < 0.2 else inner
    loop = rough(rounded_rectangle(body.width, body.depth, body.radius))
    bevel = min(float(rng.uniform(0.0003, 0.006)), 0.3 * body.height)
    skins = [outside, outside, wall, outside, inner, floor]
    meshes = [tray(loop, 0, body.height, body.floor, body.wall, bevel, skins)]
    attached, loose = _inside(rng, body, inner)
    if rng.random() < 0.3:  # a rim around the outside
        rim = rough(rounded_rectangle(body.width + 0.004, body.depth + 0.004, body.radius + 0.002))
        top = body.height * float(rng.uniform(0.3, 1.0))
        band = plain(rng, random_color(rng)) if rng.random() < 0.3 else outside
        meshes.append(tray(rim, top - 0.003, top - 1e-4, top - 0.0028, 0.0019, 0.0003, band))
    return meshes + attached, loose


def _lid_outline(rng: Generator, width: float, depth: float, radius: float) -> Points:
    loop = rounded_rectangle(width, depth, radius)
    if rng.random() < 0.25:  # one or both front corners cut off, or a notch where another piece shows
        across, back = width * float(rng.uniform(0.03, 0.25)), depth * float(rng.uniform(0.1, 0.6))
        slant = across * float(rng.choice([0.05, 0.3, 1.0]))
        w, d = width / 2, depth / 2
        cut = [(-w, d), (-w, -d + back), (-w + slant, -d + back), (-w + across, -d), (w, -d), (w, d)]
        loop = np.array(cut, np.float32)
        if rng.random() < 0.5:
            loop = (loop * np.array([-1, 1], np.float32))[::-1].copy()
    return loop


def _lid(
    rng: Generator, body: _Body, color: Color, rough: Callable[[Points], Points]
) -> tuple[list[Mesh], LidFront, float]:
    """Meshes of the closed lid, its front edge and the height of the hinge."""
    flat = rng.random() < 0.5
    width, depth, x = body.width, body.depth, 0.0
    if flat and rng.random() < 0.25:
        width *= float(rng.uniform(0.72, 0.97))
        x = (body.width - width) / 2 * float(rng.choice([-1, 0, 1]))
    grow = float(rng.uniform(-0.003, 0.004))
    width, depth = width + 2 * grow, depth * (float(rng.uniform(0.88, 1.02)) if flat else 1.0) + grow
    # A tray-like lid stays thinner than the base, or nobody could tell them apart when open flat.
    deepest = min(0.027, 0.65 * body.height)
    thick = float(rng.uniform(0.0015, 0.009) if flat else rng.uniform(0.5 * min(deepest, 0.014), deepest))
    rest = body.height + float(rng.uniform(0.0, 0.001))
    if flat and rng.random() < 0.3:
        rest -= thick * float(rng.uniform(0.3, 1.0))
    rect = (x - width / 2, depth / 2, width, -depth)
    side = plain(rng, color)
    top = printed(rng, color, rect) if rng.random() < 0.55 else side
    draw = rng.random()
    under = side
    if draw < 0.25:
        under = plain(rng, random_color(rng))
    elif draw < 0.5:
        under = printed(
            rng, random_color(rng), (rect[0], -depth / 2, width, depth), str(rng.choice(["print", "leaflet"]))
        )
    bevel = min(float(rng.uniform(0.0002, 0.004)), 0.3 * thick)
    if flat:
        loop = rough(_lid_outline(rng, width, depth, body.radius))
        panel = plate(loop, rest, rest + thick, bevel, [under, side, side, side, top])
    else:
        loop = rough(rounded_rectangle(width, depth, body.radius))
        shell = float(rng.uniform(0.001, 0.003))
        panel = tray(
            loop,
            rest + thick,
            rest,
            rest + thick - shell,
            shell,
            bevel,
            [top, side, side, side, under, under],
        )
    y = (body.depth - depth) / 2 + float(rng.uniform(-0.002, 0.003))
    meshes = [shifted(panel, x, y, 0.0)]
    front = LidFront(x, y - depth / 2, width, rest, thick)
    return meshes, front, rest + thick * float(rng.uniform(0.0, 0.7))


def sample_object(rng: Generator) -> ArticulatedObject:
    """A random box with its parts, inner fittings and colours."""
    body = _sizes(rng)
    base_color, lid_color = _colors(rng)
    looks_scanned = rng.random() < 0.35
    ragged = float(rng.uniform(0.0001, 0.0007))

    def rough(loop: Points) -> Points:
        return roughened(rng, loop, ragged) if looks_scanned else loop

    base, loose = _base(rng, body, base_color, rough)
    lid, front, hinge_z = _lid(rng, body, lid_color, rough)
    hinge_y = body.depth / 2 + float(rng.uniform(-0.0015, 0.003))
    behind = hinge(rng, 0.96 * body.width, body.depth / 2, (hinge_y, hinge_z), base_color)
    before = fastening(rng, lid_color, (-body.depth / 2, body.height), front)
    base, lid = base + behind[0] + before[0], lid + behind[1] + before[1]
    if looks_scanned:
        base, lid = _all_scanned(rng, base), _all_scanned(rng, lid)
    things = [(0, joined(loose))] if loose else []
    return articulated_object(CATEGORIES["box"].joints, (base, lid), [(0.0, hinge_y, hinge_z)], loose=things)


def _all_scanned(rng: Generator, meshes: list[Mesh]) -> list[Mesh]:
    known: dict[int, Material] = {}
    scans = []
    for mesh in meshes:
        for material in mesh.materials:
            if id(material) not in known:
                known[id(material)] = scanned(rng, material)
        scans.append(
            Mesh(
                mesh.vertices,
                mesh.local,
                mesh.triangles,
                mesh.skin,
                tuple(known[id(m)] for m in mesh.materials),
            )
        )
    return scans
