"""Category "dishwasher": built in or standing free, for a kitchen or a table, with the door that opens downwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_training.categories import CATEGORIES
from page_training.scenes.articulated import ArticulatedObject, States, articulated_object, seen_from
from page_training.scenes.fittings import finish, gray, related, sample_handle
from page_training.scenes.materials import Material, hsv_color, patterned, plain, printed, random_color
from page_training.scenes.meshes import Mesh, cuboid, repeated, revolved, shifted
from page_training.scenes.shapes import block, rod, upright_to
from page_training.scenes.textures import Generator


def distance_m(model: ArticulatedObject) -> tuple[float, float]:
    return seen_from(model, 1.3, 3.6)


def on_table(model: ArticulatedObject) -> float:
    """Small ones stand on tables."""
    return 0.85 if model.diagonal_m < 0.85 else 0.05


def sample_states(rng: Generator, model: ArticulatedObject) -> States:
    """How far the door is open, rad."""
    most = model.joints[0].limits[1]
    draw = rng.random()
    if draw < 0.2:
        return (float(rng.uniform(0.0, 0.05)),)
    return (float(rng.uniform(0.9, 1.0) if draw < 0.4 else rng.uniform(0.05, 1.0)) * most,)


@dataclass(frozen=True, eq=False, slots=True)
class _Body:
    """Metres, the front of the housing at y = 0. wall: of the housing; kick: height below the door; head: height above
    it; door: its thickness; side: how far the door stays within the housing on either side."""

    width: float
    depth: float
    height: float
    wall: float
    kick: float
    head: float
    door: float
    side: float


def _sizes(rng: Generator) -> _Body:
    draw = rng.random()
    if draw < 0.6:  # full size
        size = (rng.uniform(0.58, 0.64) if rng.random() < 0.7 else rng.uniform(0.42, 0.48), rng.uniform(0.5, 0.68))
        height = float(rng.uniform(0.76, 0.92))
    elif draw < 0.8:  # on a table
        size, height = (rng.uniform(0.4, 0.58), rng.uniform(0.4, 0.54)), float(rng.uniform(0.38, 0.52))
    else:  # odd proportions
        size, height = (rng.uniform(0.35, 0.75), rng.uniform(0.35, 0.7)), float(rng.uniform(0.4, 1.0))
    scale = float(rng.uniform(0.2, 0.7)) if rng.random() < 0.18 else 1.0
    width, depth, height = scale * size[0], scale * size[1], scale * height
    return _Body(
        width=width,
        depth=depth,
        height=height,
        wall=float(rng.uniform(0.012, 0.05)) * width / 0.6,
        kick=height * float(rng.choice([rng.uniform(0.01, 0.04), rng.uniform(0.07, 0.16)])),
        head=height * float(rng.choice([rng.uniform(0.0, 0.03), rng.uniform(0.08, 0.2)], p=[0.6, 0.4])),
        door=float(rng.uniform(0.02, 0.09)) * width / 0.6,
        side=width * float(rng.choice([0.0, rng.uniform(0.0, 0.03)])),
    )


def _rack(rng: Generator, width: float, depth: float, tall: float, skin: Material) -> list[Mesh]:
    """A wire basket about x = 0 from y = 0 to depth, its floor at z = 0."""
    radius = 0.004 * width / 0.5
    x, y = width / 2, depth
    meshes = []
    for z in (0.0, tall):
        corners = [np.array(c) for c in ((-x, 0, z), (x, 0, z), (x, y, z), (-x, y, z))]
        meshes += [rod(corners[k], corners[(k + 1) % 4], radius, skin, 6) for k in range(4)]
    count = int(rng.integers(5, 10))
    wire = rod(np.array([0.0, 0, 0]), np.array([0.0, y, 0]), 0.6 * radius, skin, 5)
    meshes.append(repeated(wire, np.stack([np.linspace(-x, x, count), np.zeros(count), np.zeros(count)], axis=1)))
    post = rod(np.zeros(3), np.array([0.0, 0.0, tall]), 0.6 * radius, skin, 5)
    places = np.stack([np.linspace(-x, x, count), np.zeros(count), np.zeros(count)], axis=1)
    meshes.append(repeated(post, np.concatenate([places, places + np.array([0.0, y, 0.0])])))
    if rng.random() < 0.6:  # tines that hold the plates
        rows = np.stack(np.meshgrid(np.linspace(-0.8 * x, 0.8 * x, 6), np.linspace(0.15 * y, 0.85 * y, 5)), axis=-1)
        tine = rod(np.zeros(3), np.array([0.0, 0.0, 0.7 * tall]), 0.5 * radius, skin, 4)
        meshes.append(repeated(tine, np.concatenate([rows.reshape(-1, 2), np.zeros((30, 1))], axis=1)))
    return meshes


def _dishes(rng: Generator, width: float, depth: float, tall: float) -> list[Mesh]:
    """Plates on edge and glasses, in a rack."""
    things: list[Mesh] = []
    if rng.random() < 0.5:
        skin = plain(rng, gray(rng, 0.75, 1.0) if rng.random() < 0.7 else random_color(rng))
        radius = 0.45 * min(tall * 2, 0.5 * depth)
        plate = upright_to(
            "x", revolved([(0.5 * radius, 0), (radius, 0.08 * radius), (radius, 0.1 * radius)], skin, 16)
        )
        for x in np.linspace(-0.35, 0.35, int(rng.integers(2, 7))):
            things.append(shifted(plate, x * width, depth * float(rng.uniform(0.4, 0.6)), radius))
    for _ in range(int(rng.integers(0, 4))):
        skin = plain(rng, random_color(rng))
        radius = 0.06 * width
        cup = revolved([(0.8 * radius, 0), (radius, tall)], skin, 12)
        things.append(shifted(cup, *(rng.uniform(-0.4, 0.4) * width, rng.uniform(0.1, 0.9) * depth, 0.002)))
    return things


def _controls(rng: Generator, width: float, height: float) -> list[Mesh]:
    """Buttons, a display and a dial on a strip width x height, about x = 0, z = 0, on a surface at y = 0."""
    meshes = []
    dark = plain(rng, gray(rng, 0.01, 0.15))
    if rng.random() < 0.5:
        w, h = 0.12 * width, 0.28 * height
        lit = printed(rng, gray(rng, 0.02, 0.1), (-w, h, 2 * w, -2 * h), "screen")
        x = width * float(rng.uniform(-0.3, 0.3))
        meshes.append(block((x - w, -0.001, -h), (x + w, 1e-4, h), lit))
    count = int(rng.integers(0, 8))
    size = 0.12 * height
    button = upright_to("-y", revolved([(size, 0), (0.9 * size, 0.004)], dark, 10))
    if rng.random() < 0.4:
        button = block((-1.5 * size, -0.003, -size), (1.5 * size, 1e-4, size), dark)
    start = width * float(rng.uniform(-0.4, 0.1))
    meshes += [shifted(button, start + k * 4 * size, 0, 0) for k in range(count) if start + k * 4 * size < 0.45 * width]
    if rng.random() < 0.25:
        dial = upright_to("-y", revolved([(0.35 * height, 0), (0.3 * height, 0.02)], finish(rng), 20))
        meshes.append(shifted(dial, width * float(rng.choice([-0.38, 0.38])), 0, 0))
    return meshes


def _housing(rng: Generator, body: _Body, skin: Material, tub: Material) -> list[Mesh]:
    w, d, h, t = body.width / 2, body.depth, body.height, body.wall
    floor, ceiling = body.kick + 0.5 * t, h - max(body.head, t)
    bevel = 0.1 * t
    side = skin if rng.random() < 0.7 else finish(rng)
    back = max(0.25 * t, 0.003)
    meshes = [
        block((-w, 0, body.kick), (-w + t, d, h), side, bevel),
        block((w - t, 0, body.kick), (w, d, h), side, bevel),
        block((-w + t, 0, ceiling), (w - t, d, h), skin, bevel),
        block((-w + t, 0, body.kick), (w - t, d, floor), tub),
        block((-w + t, d - back, floor), (w - t, d, ceiling), tub),
        # What the tub shows of walls and ceiling.
        block((-w + t, 0.002, floor), (-w + t + 2e-3, d - back, ceiling), tub),
        block((w - t - 2e-3, 0.002, floor), (w - t, d - back, ceiling), tub),
        block((-w + t, 0.002, ceiling - 2e-3), (w - t, d - back, ceiling), tub),
    ]
    recess = float(rng.uniform(0.0, 0.12)) * d
    dark = plain(rng, gray(rng, 0.02, 0.2)) if rng.random() < 0.6 else skin
    meshes.append(block((-w, recess, 0), (w, d, body.kick + 1e-4), dark))
    if body.head > 0.06 * h:  # a fixed panel above the door
        panel = related(rng, skin)
        out = -body.door * float(rng.uniform(0.0, 1.0))
        meshes.append(block((-w, out, h - body.head), (w, 1e-4, h - 1e-4), panel, bevel))
        controls = _controls(rng, body.width, body.head)
        meshes += [shifted(mesh, 0, out, h - body.head / 2) for mesh in controls]
    if rng.random() < 0.45:  # worktop
        over = float(rng.uniform(0.0, 0.03)) * body.width
        slab_skin = finish(rng)
        meshes.append(
            block((-w - over, -over - body.door * 0.5, h), (w + over, d, h + rng.uniform(0.01, 0.05) * h), slab_skin)
        )
    if rng.random() < 0.85:  # racks
        wire = plain(rng, gray(rng, 0.4, 0.95) if rng.random() < 0.75 else random_color(rng))
        inner = body.width - 2 * t
        for z in (0.12, 0.56)[: int(rng.integers(1, 3))]:
            tall = float(rng.uniform(0.12, 0.25)) * (ceiling - floor)
            rack = _rack(rng, 0.86 * inner, 0.8 * d, tall, wire)
            meshes += [shifted(mesh, 0, 0.08 * d, floor + z * (ceiling - floor)) for mesh in rack]
    return meshes


def _door(rng: Generator, body: _Body, skin: Material, tub: Material) -> list[Mesh]:
    w, t = body.width / 2 - body.side, body.door
    low = body.kick + 0.004 * body.height
    high = body.height - max(body.head, 0.004 * body.height) - 0.002 * body.height
    tall = high - low
    rect = (-w, high, 2 * w, -tall)
    outer = printed(rng, random_color(rng), rect) if rng.random() < 0.06 else skin
    meshes = [block((-w, -t, low), (w, -0.3 * t, high), outer, 0.12 * t)]
    inner = w * float(rng.uniform(0.8, 0.95))
    meshes.append(block((-inner, -0.31 * t, low + 0.02 * tall), (inner, 0.0, high - 0.03 * tall), tub, 0.1 * t))
    if rng.random() < 0.7:  # detergent dispenser, rinse aid
        plastic = plain(rng, gray(rng, 0.5, 0.95) if rng.random() < 0.6 else gray(rng, 0.05, 0.3))
        x, z = inner * float(rng.uniform(-0.4, 0.4)), low + tall * float(rng.uniform(0.4, 0.65))
        meshes.append(
            block((x - 0.18 * w, -1e-4, z - 0.07 * tall), (x + 0.18 * w, 0.008, z + 0.07 * tall), plastic, 0.003)
        )
        cap = upright_to("y", revolved([(0.05 * w, 0), (0.05 * w, 0.01)], plastic, 12))
        meshes.append(shifted(cap, x + 0.28 * w, 0.0, z))
    if rng.random() < 0.25:  # pressed ribs
        for z in np.linspace(0.15, 0.35, 3):
            meshes.append(
                block((-0.8 * inner, -1e-4, low + z * tall), (0.8 * inner, 0.004, low + (z + 0.03) * tall), tub)
            )
    strip = float(rng.uniform(0.08, 0.17)) * tall
    if body.head < 0.06 * body.height and rng.random() < 0.75:  # controls in the door
        panel = related(rng, skin) if rng.random() < 0.7 else plain(rng, gray(rng, 0.02, 0.2))
        out = t * float(rng.uniform(0.0, 0.25))
        meshes.append(block((-w, -t - out - 1e-4, high - strip), (w, -t + 1e-3, high - 1e-4), panel, 0.05 * t))
        meshes += [shifted(mesh, 0, -t - out - 1e-4, high - strip / 2) for mesh in _controls(rng, 2 * w, strip)]
    if rng.random() < 0.2:  # a framed panel, as kitchen fronts have
        rail = 0.12 * w
        for box in (
            ((-w, low), (w, low + rail)),
            ((-w, high - strip - rail), (w, high - strip)),
            ((-w, low), (-w + rail, high - strip)),
            ((w - rail, low), (w, high - strip)),
        ):
            meshes.append(block((box[0][0], -t - 0.006, box[0][1]), (box[1][0], -t + 1e-4, box[1][1]), outer))
    handle = sample_handle(rng, 2 * w * 0.9, 0.25 * tall, chance=0.8)
    place = high - strip * float(rng.uniform(0.4, 1.6))
    meshes += handle(0.0, -t, place)
    if rng.random() < 0.3:
        logo = block((-0.06 * w, -t - 0.0015, high - 0.02), (0.06 * w, -t, high - 0.01), plain(rng, random_color(rng)))
        meshes.append(logo)
    return meshes


def _kitchen(rng: Generator, body: _Body, skin: Material) -> list[Mesh]:
    """Cupboards on one side or both and a worktop over all."""
    meshes = []
    w, d, h = body.width / 2, body.depth, body.height
    sides = (-1, 1) if rng.random() < 0.6 else (int(rng.choice([-1, 1])),)
    front = skin if rng.random() < 0.5 else finish(rng)
    reach = [0.0, 0.0]
    for side in sides:
        wide = body.width * float(rng.uniform(0.3, 1.1))
        low, high = sorted((side * (w + 0.002), side * (w + 0.002 + wide)))
        meshes.append(block((low, -body.door * float(rng.uniform(0.2, 1.0)), 0.0), (high, d, h - 1e-3), front))
        reach[side > 0] = wide
        handle = sample_handle(rng, wide, h / 3)
        meshes += handle((low + high) / 2, -body.door, 0.8 * h)
    if rng.random() < 0.8:
        top = patterned(rng, str(rng.choice(["marble", "wood", "speckle", "noise"])), float(rng.uniform(0.2, 1.0)))
        over = -1.2 * body.door - 0.01
        meshes.append(block((-w - reach[0], over, h + 0.05 * h), (w + reach[1], d, h + 0.09 * h), top))
    return meshes


def sample_object(rng: Generator) -> ArticulatedObject:
    """A random dishwasher, closed."""
    body = _sizes(rng)
    draw = rng.random()
    if draw < 0.35:
        skin = plain(rng, gray(rng, 0.75, 1.0), contrast=0.02)
    elif draw < 0.6:
        skin = plain(rng, gray(rng, 0.35, 0.75), contrast=0.03)
    elif draw < 0.72:
        skin = plain(rng, gray(rng, 0.02, 0.15), contrast=0.04)
    else:
        skin = finish(rng)
    door_skin = skin if rng.random() < 0.7 else finish(rng)
    draw = rng.random()
    tub_color = (
        gray(rng, 0.4, 0.85) if draw < 0.7 else hsv_color(rng.random(), rng.uniform(0, 0.3), rng.uniform(0.3, 1.0))
    )
    tub = plain(rng, tub_color, contrast=0.05)
    housing, door = _housing(rng, body, skin, tub), _door(rng, body, door_skin, tub)
    loose: list[tuple[int, Mesh]] = []
    floor = body.kick + body.wall
    inside = _dishes(rng, 0.8 * body.width, 0.7 * body.depth, 0.15 * body.height)
    loose += [(0, shifted(mesh, 0, 0.12 * body.depth, floor + 0.12 * (body.height - floor))) for mesh in inside]
    if rng.random() < 0.3:
        loose += [(0, mesh) for mesh in _kitchen(rng, body, skin)]
    if rng.random() < 0.2:
        thing = cuboid(rng.uniform(0.05, 0.25, 3).tolist(), plain(rng, random_color(rng)), bevel=0.003)
        loose.append((0, shifted(thing, *(rng.uniform(-0.3, 0.3) * body.width, 0.5 * body.depth, body.height * 1.1))))
    hinge = (
        0.0,
        -body.door * float(rng.uniform(0.0, 0.8)),
        body.kick + 0.004 * body.height + body.door * float(rng.uniform(0.0, 0.6)),
    )
    limit = (0.0, float(np.radians(rng.uniform(80, 97))))
    return articulated_object(CATEGORIES["dishwasher"].joints, (housing, door), (hinge,), loose=loose, limits=[limit])
