"""Category "scissors": office, kitchen, tailor's, children's and nail scissors, pruning shears and snips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_runtime.geometry import Array, rotation_about, transform_from
from page_training.categories import CATEGORIES
from page_training.scenes.articulated import ArticulatedObject, States, articulated_object, seen_from
from page_training.scenes.fittings import gray, metal
from page_training.scenes.materials import Material, patterned, plain, random_color
from page_training.scenes.meshes import Mesh, moved, revolved, shifted
from page_training.scenes.resting import Rest, held_rest, turned_rest, upright_rest
from page_training.scenes.shapes import ellipse, slab, tube
from page_training.scenes.textures import Generator

Z = np.array([0.0, 0.0, 1.0])


def distance_m(model: ArticulatedObject) -> tuple[float, float]:
    return seen_from(model, 1.5, 5.0)


def rest(rng: Generator) -> Rest:
    """Lying on either face, now and then held."""
    draw = rng.random()
    if draw < 0.4:
        return upright_rest(rng)
    return turned_rest((0.0, 1.0, 0.0), np.pi, rng) if draw < 0.8 else held_rest(rng)


def sample_states(rng: Generator, model: ArticulatedObject) -> States:
    """Opening, rad: some are closed, most open by less than a right angle."""
    draw = rng.random()
    most = model.joints[0].limits[1]
    if draw < 0.2:
        return (float(np.radians(rng.uniform(0, 6))),)
    return (float(rng.uniform(0.1, 0.75 if draw < 0.85 else 1.0)) * most,)


@dataclass(frozen=True, eq=False, slots=True)
class _Blade:
    """Metres. length: from pivot to tip; width: at the pivot, of which `over` lies beyond the middle line; thick: of
    the plate; bow, blunt: shape of spine and tip in 0..1."""

    length: float
    width: float
    over: float
    thick: float
    bow: float
    blunt: float


def _outline(blade: _Blade) -> Array:
    """(N,2) of the blade that opens to +x: its edge along the middle line, its spine towards +x."""
    share = np.linspace(0.0, 1.0, 12)
    tip = 0.35 * blade.width * blade.blunt
    spine = tip + (blade.width - blade.over - tip) * (1.0 - share ** (1.0 + 3.0 * blade.bow))
    edge = -blade.over * (1.0 - share)
    up = np.stack([edge, share * blade.length], axis=1)
    down = np.stack([spine, share * blade.length * (1 - 0.04 * blade.blunt)], axis=1)[::-1]
    tail = np.array([[0.5 * blade.width, -0.5 * blade.width], [-0.5 * blade.width, -0.5 * blade.width]])
    # Counter-clockwise: up along the spine, back along the edge.
    return np.concatenate([down[::-1], up[::-1], tail[::-1]])


@dataclass(frozen=True, eq=False, slots=True)
class _Handle:
    """Metres. length: from the pivot to the far end; loop: its outer size across and along; wire: width and height of
    its section; shape: 1 round, less squarer; open_loop: a bow instead of a ring; lean_rad: of the ring outwards."""

    length: float
    loop: tuple[float, float]
    wire: tuple[float, float]
    corner: float
    shape: float
    open_loop: bool
    lean_rad: float


def _handle(handle: _Handle, blade: _Blade, skin: Material, shank_skin: Material) -> list[Mesh]:
    """Shank and ring or bow of the blade that opens to +x: they lie at -x."""
    width, height = handle.wire
    gap = 0.5 * width + 0.001
    if handle.open_loop:
        share = np.linspace(0.0, 1.0, 12)
        x = -gap - handle.loop[0] * np.sin(np.pi * share**0.8) * 0.5 - 0.15 * handle.loop[0] * share
        path = np.stack([x, -0.2 * blade.width - share * handle.length, np.zeros(12)], axis=1)
        widths = width * (0.8 + 0.6 * np.sin(np.pi * share))
        return [tube(path, Z, widths, height, skin, corner=handle.corner, steps=10)]
    across, along = handle.loop
    middle = np.array([-gap - across / 2, -handle.length + along / 2])
    ring = ellipse(max(across - width, 0.4 * across), max(along - width, 0.4 * along), 24, handle.shape)
    c, s = np.cos(handle.lean_rad), np.sin(handle.lean_rad)
    ring = ring @ np.array([[c, s], [-s, c]]) + middle
    # The ring leaned outwards may not cross to the other handle's side.
    ring[:, 0] -= max(0.0, float(ring[:, 0].max()) + gap)
    path = np.concatenate([ring, np.zeros((len(ring), 1))], axis=1)
    meshes = [tube(path, Z, width, height, skin, corner=handle.corner, steps=10, closed=True)]
    top = path[int(path[:, 1].argmax())]
    start = np.array([-0.05 * blade.width, -0.15 * blade.width, 0.0])
    bend = np.array([0.6 * top[0] + 0.4 * start[0], 0.75 * top[1] + 0.25 * start[1], 0.0])
    along_shank = np.array([start, 0.5 * (start + bend), bend, 0.6 * bend + 0.4 * top, top])
    wide = np.linspace(0.85 * blade.width, 1.05 * width, 5)
    tall = np.linspace(min(height, 2.2 * blade.thick), height, 5)
    meshes.append(tube(along_shank, Z, wide, tall, shank_skin, corner=min(handle.corner, 0.6), steps=10))
    return meshes


def _sizes(rng: Generator) -> tuple[_Blade, _Handle]:
    total = float(np.exp(rng.uniform(np.log(0.09), np.log(0.29))))
    length = total * float(rng.uniform(0.3, 0.6))
    width = float(np.clip(length * rng.uniform(0.1, 0.28), 0.005, 0.03))
    blade = _Blade(
        length=length,
        width=width,
        over=width * float(rng.uniform(0.25, 0.5)),
        thick=float(rng.uniform(0.001, 0.0035)),
        bow=float(rng.random()),
        blunt=float(rng.random() ** 2) * 2.0,
    )
    back = total - length
    all_metal = rng.random() < 0.25
    across = float(np.clip(back * rng.uniform(0.28, 0.6), 0.014, 0.055))
    wire = across * float(rng.uniform(0.1, 0.2) if all_metal else rng.uniform(0.14, 0.34))
    handle = _Handle(
        length=back,
        loop=(across, float(np.clip(across * rng.uniform(1.0, 2.2), across, 0.9 * back))),
        wire=(wire, wire * float(rng.uniform(0.6, 1.1)) if all_metal else float(rng.uniform(0.004, 0.014))),
        corner=float(rng.uniform(0.3, 1.0)),
        shape=float(rng.uniform(0.6, 1.1)),
        open_loop=bool(rng.random() < 0.13),
        lean_rad=float(rng.uniform(-0.15, 0.35)),
    )
    return blade, handle


def _other(rng: Generator, handle: _Handle) -> _Handle:
    """The second handle: the same, or larger for several fingers."""
    if rng.random() < 0.45:
        return handle
    across, along = handle.loop
    grown = (across * float(rng.uniform(0.9, 1.3)), min(along * float(rng.uniform(1.0, 1.7)), 0.92 * handle.length))
    return _Handle(
        handle.length * float(rng.uniform(0.95, 1.08)), grown, handle.wire, handle.corner, handle.shape,
        handle.open_loop, handle.lean_rad,
    )  # fmt: skip


def sample_object(rng: Generator) -> ArticulatedObject:
    """Random scissors, lying closed: the first blade opens to +x, on top of the second or, if left-handed, below."""
    blade, handle = _sizes(rng)
    steel = metal(rng) if rng.random() < 0.25 else plain(rng, gray(rng, 0.5, 0.95), contrast=0.03)
    grip = plain(rng, random_color(rng)) if rng.random() < 0.85 else patterned(rng, "wood", 0.1)
    if rng.random() < 0.18:
        grip = steel
    elif rng.random() < 0.2:
        grip = plain(rng, gray(rng, 0.02, 0.15))
    second_grip = grip if rng.random() < 0.9 else plain(rng, random_color(rng))
    shank_is_grip = rng.random() < 0.7
    handles = (handle, _other(rng, handle))
    level = 0.5 * blade.thick * (1.0 if rng.random() < 0.85 else -1.0)
    parts: list[list[Mesh]] = []
    swap = rng.random() < 0.5
    for sign, own, skin in ((1.0, handles[swap], grip), (-1.0, handles[not swap], second_grip)):
        outline = _outline(blade) * np.array([sign, 1.0])
        outline = outline if sign > 0 else outline[::-1]
        half = 0.5 * blade.thick
        meshes = [shifted(slab(outline, -half, half, 0.3 * half, steel), 0.0, 0.0, sign * level)]
        made = _handle(own, blade, skin, skin if shank_is_grip else steel)
        if sign < 0:  # a half turn about y brings the first handle to the other side
            made = [moved(mesh, transform_from(rotation_about(np.array([0.0, 1.0, 0.0]), np.pi), np.zeros(3)))
                    for mesh in made]  # fmt: skip
        parts.append(meshes + made)
    screw = metal(rng)
    radius = blade.width * float(rng.uniform(0.15, 0.42))
    tall = blade.thick + float(rng.uniform(0.0005, 0.003))
    head = revolved([(radius, 0.0), (radius, 0.6 * tall), (0.7 * radius, tall)], screw, 14)
    parts[0].append(head)
    if rng.random() < 0.7:
        parts[int(rng.integers(2))].append(
            moved(head, transform_from(rotation_about(np.array([1.0, 0.0, 0.0]), np.pi), np.zeros(3)))
        )
    limit = float(np.radians(rng.uniform(60, 110)))
    return articulated_object(CATEGORIES["scissors"].joints, parts, [(0.0, 0.0, 0.0)], limits=[(0.0, limit)])
