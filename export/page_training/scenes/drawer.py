"""Category "drawer": three drawers above each other in one body, from desk organisers to chests of drawers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_runtime.geometry import rotation_about, transform_from
from page_training.categories import CATEGORIES
from page_training.scenes.articulated import ArticulatedObject, States, articulated_object, seen_from
from page_training.scenes.fittings import Handle, decorated, feet, finish, metal, related, sample_handle
from page_training.scenes.materials import Material, plain, random_color
from page_training.scenes.meshes import Mesh, cuboid, moved, revolved, rounded_rectangle, shifted, tray
from page_training.scenes.shapes import block
from page_training.scenes.textures import Generator

NUM_DRAWERS = 3


@dataclass(frozen=True, eq=False, slots=True)
class _Body:
    """Metres. width, depth, height: of the body without feet, front at y = 0, back at y = depth, floor at z = 0; wall:
    of its panels. cells: (low x, high x, low z, high z) between the panels for each drawer, from the top. overlay: how
    far fronts reach over the panels, negative where they lie between them."""

    width: float
    depth: float
    height: float
    wall: float
    cells: tuple[tuple[float, float, float, float], ...]
    overlay: float


def distance_m(model: ArticulatedObject) -> tuple[float, float]:
    return seen_from(model, 1.3, 4.2)


def on_table(model: ArticulatedObject) -> float:
    """Organisers stand on tables, chests on the floor."""
    return 0.9 if model.diagonal_m < 0.45 else 0.1


def sample_states(rng: Generator, model: ArticulatedObject) -> States:
    """Of each drawer how far it is pulled out, m: a third are closed, and often all but one."""
    alone = int(rng.integers(NUM_DRAWERS)) if rng.random() < 0.35 else None
    states = []
    for k, joint in enumerate(model.joints):
        most = joint.limits[1]
        draw = rng.random()
        closed = (alone is not None and k != alone) or (alone is None and draw < 0.3)
        if closed:
            states.append(0.0)
        else:
            states.append(float(rng.uniform(0.0, 0.12) if draw < 0.42 else rng.uniform(0.05, 1.0)) * most)
    return tuple(states)


def _sizes(rng: Generator) -> _Body:
    if rng.random() < 0.5:  # on a desk
        width = float(np.exp(rng.uniform(np.log(0.09), np.log(0.36))))
        depth = float(np.clip(width * rng.uniform(0.6, 1.6), 0.09, 0.38))
        height = float(np.clip(rng.uniform(0.12, 0.32), 0.55 * width, 2.6 * width))
    else:
        width = float(rng.uniform(0.3, 0.6) if rng.random() < 0.7 else rng.uniform(0.55, 0.95))
        depth = float(rng.uniform(0.28, 0.6))
        height = float(rng.uniform(0.36, 1.0))
    size = min(width, depth, height)
    wall = float(np.clip(size * rng.uniform(0.012, 0.09), 0.0012, 0.035))
    between = wall * float(rng.uniform(0.3, 1.2))
    low_x, high_x = -width / 2 + wall, width / 2 - wall
    if rng.random() < 0.1:  # a compartment beside the drawers
        cut = (high_x - low_x) * float(rng.uniform(0.25, 0.5))
        low_x, high_x = (low_x + cut, high_x) if rng.random() < 0.5 else (low_x, high_x - cut)
    low_z, high_z = wall, height - wall
    if rng.random() < 0.2:  # an open shelf, or a panel, above or below
        cut = (high_z - low_z) * float(rng.uniform(0.08, 0.35))
        low_z, high_z = (low_z + cut, high_z) if rng.random() < 0.5 else (low_z, high_z - cut)
    draw = rng.random()
    shares = np.ones(NUM_DRAWERS)
    if draw > 0.6:
        shares = np.sort(rng.uniform(0.6, 1.6, NUM_DRAWERS)) if draw < 0.85 else rng.uniform(0.6, 1.6, NUM_DRAWERS)
    heights = shares / shares.sum() * (high_z - low_z - (NUM_DRAWERS - 1) * between)
    cells, top = [], high_z
    for tall in heights:
        cells.append((low_x, high_x, top - float(tall), top))
        top -= float(tall) + between
    overlay = float(rng.uniform(0.2, 0.48)) * min(between, wall) if rng.random() < 0.45 else -wall * 0.05 - 5e-4
    return _Body(width, depth, height, wall, tuple(cells), overlay)


def _body(rng: Generator, body: _Body, skin: Material) -> list[Mesh]:
    """Panels about the cells, standing on z = 0."""
    w, d, h, t = body.width / 2, body.depth, body.height, body.wall
    bevel = t * float(rng.uniform(0.0, 0.3))
    inside = skin if rng.random() < 0.6 else finish(rng)
    side_skin = decorated(rng, skin, (0.0, h, d, -h), 0.12)
    over = t * float(rng.uniform(0.3, 2.0)) if rng.random() < 0.3 else 0.0
    top_skin = related(rng, skin)
    meshes = [
        block((-w, 0, 0), (-w + t, d, h), side_skin, bevel),
        block((w - t, 0, 0), (w, d, h), side_skin, bevel),
        block((-w + t, 0, 0), (w - t, d, t), skin),
        block((-w - over, -over, h - t), (w + over, d, h), top_skin, bevel),
        block((-w + t, d - min(t, 0.006), t), (w - t, d, h - t), inside),
    ]
    low_x, high_x = body.cells[0][:2]
    for x in (low_x, high_x):
        if abs(abs(x) - (w - t)) > 1e-6:
            meshes.append(block((x - t / 2, 0.002, t), (x + t / 2, d - t, h - t), inside))
    levels = [(body.cells[k + 1][3], body.cells[k][2]) for k in range(NUM_DRAWERS - 1)]
    if rng.random() < 0.8:  # what separates the drawers, over the whole depth or at the front only
        deep = d - t if rng.random() < 0.6 else 0.12 * d
        meshes += [block((low_x, 0.002, low), (high_x, deep, high), inside) for low, high in levels]
    if body.cells[-1][2] > t + 1e-6:
        meshes.append(block((low_x, 0.002, body.cells[-1][2] - t), (high_x, d - t, body.cells[-1][2]), inside))
    if body.cells[0][3] < h - t - 1e-6:
        meshes.append(block((low_x, 0.002, body.cells[0][3]), (high_x, d - t, body.cells[0][3] + t), inside))
    if rng.random() < 0.5 and (low_x > -w + t + 1e-6 or high_x < w - t - 1e-6):  # a door before the compartment
        other = (-w + t, low_x) if low_x > -w + t + 1e-6 else (high_x, w - t)
        meshes.append(block((other[0], 0, t), (other[1], t, h - t), related(rng, skin)))
    return meshes


def _front(
    rng: Generator, width: float, height: float, thick: float, skin: Material, accent: Material, style: float
) -> list[Mesh]:
    """A front about x = 0, z = 0, its outer face at y = 0 but for what is put on it."""
    bevel = thick * (0.3 if style < 0.5 else 0.05)
    meshes = [block((-width / 2, 0, -height / 2), (width / 2, thick, height / 2), skin, bevel)]
    if style < 0.15:  # a raised frame
        rail, deep = 0.12 * min(width, height) + 0.002, 0.3 * thick
        w, h = width / 2, height / 2
        for low, high in (
            ((-w, -h), (w, -h + rail)),
            ((-w, h - rail), (w, h)),
            ((-w, -h), (-w + rail, h)),
            ((w - rail, -h), (w, h)),
        ):
            meshes.append(block((low[0], -deep, low[1]), (high[0], 1e-4, high[1]), accent))
    elif style < 0.25:  # a panel in the middle
        w, h = 0.42 * width, 0.36 * height
        meshes.append(block((-w, -0.3 * thick, -h), (w, 1e-4, h), accent, 0.1 * thick))
    elif style < 0.32:  # grooves
        dark = plain(rng, random_color(rng) * 0.3)
        for z in np.linspace(-0.35, 0.35, 4):
            meshes.append(block((-width / 2, -2e-4, z * height), (width / 2, 1e-4, (z + 0.02) * height), dark))
    return meshes


def _drawer(
    rng: Generator, body: _Body, cell: tuple[float, float, float, float], style: _Style
) -> tuple[list[Mesh], list[Mesh]]:
    """Meshes of one drawer, closed, and of what lies in it."""
    low_x, high_x, low_z, high_z = cell
    middle = ((low_x + high_x) / 2, (low_z + high_z) / 2)
    width, height = high_x - low_x + 2 * body.overlay, high_z - low_z + 2 * body.overlay
    front_y = -style.thick if body.overlay > 0 else style.recess
    rect = (-width / 2, height / 2, width, -height)
    skin = decorated(rng, style.front, rect, style.print_chance)
    meshes = [
        shifted(mesh, middle[0], front_y, middle[1])
        for mesh in _front(rng, width, height, style.thick, skin, style.accent, style.look)
    ]
    x, y, z = middle[0], front_y, middle[1] + style.handle_z * height
    places = [x] if not style.pair else [x - 0.27 * width, x + 0.27 * width]
    for place in places:
        meshes += style.handle(place, y, z)
    if style.label:
        card = block((-0.1 * width, -6e-4, -0.1 * height), (0.1 * width, 1e-4, 0.1 * height), style.paper)
        meshes.append(shifted(card, x, y, middle[1] - np.sign(style.handle_z) * 0.28 * height))
    start = front_y + style.thick
    deep = (body.depth - 2 * body.wall - start) * style.depth_share
    box = (high_x - low_x - 2 * style.gap, deep, (high_z - low_z) * style.height_share)
    wall = min(style.side, 0.2 * min(box))
    floor = low_z + style.gap
    loop = rounded_rectangle(box[0], box[1], 0.002 if style.square else 0.06 * box[0])
    bottom = min(wall, 0.3 * box[2])
    made = tray(loop, floor, floor + box[2], floor + bottom, wall, 0.1 * wall, style.inner)
    meshes.append(shifted(made, middle[0], start + box[1] / 2 - 1e-4, 0.0))
    inside = [
        shifted(mesh, middle[0], start + box[1] / 2, floor + bottom) for mesh in _contents(rng, box, style.filled)
    ]
    return meshes, inside


def _contents(rng: Generator, box: tuple[float, float, float], filled: float) -> list[Mesh]:
    """Things in a drawer whose floor is at z = 0 about the origin."""
    things: list[Mesh] = []
    if rng.random() > filled:
        return things
    for _ in range(int(rng.integers(1, 6))):
        skin = plain(rng, random_color(rng))
        room = np.array([box[0] * 0.45, box[1] * 0.45, box[2] * 0.8])
        if rng.random() < 0.7:
            size = rng.uniform(0.15, 0.9, 3) * room
            thing = cuboid(size.tolist(), skin, bevel=0.05 * float(size.min()))
        else:
            radius = float(rng.uniform(0.1, 0.5) * min(room[0], room[1]))
            thing = revolved([(radius, 0), (radius * rng.uniform(0.5, 1), room[2] * rng.uniform(0.3, 1))], skin, 14)
        turn = rotation_about(np.array([0.0, 0.0, 1.0]), float(rng.normal(0, 0.2)))
        place = rng.uniform(-0.25, 0.25, 2) * np.array(box[:2])
        things.append(moved(thing, transform_from(turn, np.array([place[0], place[1], 0.0]))))
    return things


@dataclass(frozen=True, eq=False, slots=True)
class _Style:
    """What the drawers of one body share. Lengths in metres, shares of their cell."""

    front: Material
    accent: Material
    inner: Material
    paper: Material
    handle: Handle
    handle_z: float
    pair: bool
    label: bool
    look: float
    print_chance: float
    thick: float
    recess: float
    gap: float
    side: float
    depth_share: float
    height_share: float
    square: bool
    filled: float


def _style(rng: Generator, body: _Body, skin: Material) -> _Style:
    width = body.cells[0][1] - body.cells[0][0]
    height = min(high - low for _, _, low, high in body.cells)
    thick = float(np.clip(body.wall * rng.uniform(0.7, 1.5), 0.001, 0.03))
    front = related(rng, skin)
    return _Style(
        front=front,
        accent=related(rng, front),
        inner=finish(rng) if rng.random() < 0.7 else metal(rng),
        paper=plain(rng, np.ones(3) * rng.uniform(0.6, 1.0)),
        handle=sample_handle(rng, width, height),
        handle_z=float(rng.choice([0.0, 0.0, rng.uniform(0.1, 0.35), -0.2])),
        pair=bool(rng.random() < (0.45 if width > 0.5 else 0.05)),
        label=bool(rng.random() < 0.15),
        look=float(rng.random()),
        print_chance=0.8 if rng.random() < 0.12 else 0.0,
        thick=thick,
        recess=float(rng.choice([0.0, rng.uniform(0.0, 0.4) * body.wall])),
        gap=float(np.clip(0.02 * width * rng.uniform(0.3, 1.5), 0.001, 0.015)),
        side=float(np.clip(body.wall * rng.uniform(0.4, 1.0), 0.001, 0.015)),
        depth_share=float(rng.uniform(0.75, 0.99)),
        height_share=float(rng.uniform(0.45, 0.93)),
        square=bool(rng.random() < 0.7),
        filled=float(rng.choice([0.0, 0.5, 0.9])),
    )


def sample_object(rng: Generator) -> ArticulatedObject:
    """A random body with its three drawers."""
    body = _sizes(rng)
    skin = finish(rng)
    style = _style(rng, body, skin)
    cabinet = _body(rng, body, skin)
    under, tall = feet(rng, (-body.width / 2, 0.0), (body.width / 2, body.depth), related(rng, skin))
    cabinet = under + [shifted(mesh, 0, 0, tall) for mesh in cabinet]
    parts, loose = [cabinet], []
    points, limits = [], []
    for k, cell in enumerate(body.cells, 1):
        meshes, inside = _drawer(rng, body, cell, style)
        parts.append([shifted(mesh, 0, 0, tall) for mesh in meshes])
        loose += [(k, shifted(mesh, 0, 0, tall)) for mesh in inside]
        points.append(((cell[0] + cell[1]) / 2, 0.0, (cell[2] + cell[3]) / 2 + tall))
        limits.append((0.0, (body.depth - 2 * body.wall) * style.depth_share * float(rng.uniform(0.6, 0.95))))
    return articulated_object(CATEGORIES["drawer"].joints, parts, points, loose=loose, limits=limits)
