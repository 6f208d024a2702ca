"""Category "cutter": snap-off and utility knives, whose blade slides out of the handle with its slider."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_runtime.geometry import Array
from page_training.categories import CATEGORIES
from page_training.scenes.articulated import ArticulatedObject, States, articulated_object, seen_from
from page_training.scenes.fittings import gray, metal
from page_training.scenes.materials import Material, plain, printed, random_color
from page_training.scenes.meshes import Mesh, repeated, revolved, shifted
from page_training.scenes.resting import Rest, held_rest, turned_rest, upright_rest
from page_training.scenes.shapes import block, rod, slab
from page_training.scenes.textures import Generator


def distance_m(model: ArticulatedObject) -> tuple[float, float]:
    return seen_from(model, 1.5, 5.0)


def rest(rng: Generator) -> Rest:
    """Lying on any of its four sides, mostly with the slider up; now and then held."""
    draw = rng.random()
    if draw < 0.55:
        return upright_rest(rng)
    if draw < 0.85:
        return turned_rest((0.0, 1.0, 0.0), float(rng.choice([0.5, 1.0, 1.5])) * np.pi, rng)
    return held_rest(rng)


def sample_states(rng: Generator, model: ArticulatedObject) -> States:
    """How far the blade is out, m."""
    most = model.joints[0].limits[1]
    draw = rng.random()
    if draw < 0.12:
        return (0.0,)
    return (float(rng.uniform(0.05, 0.5) if draw < 0.55 else rng.uniform(0.2, 1.0)) * most,)


@dataclass(frozen=True, eq=False, slots=True)
class _Body:
    """Metres; the blade comes out at y = length / 2. flat: across the blade's plane, broad: along it. slot: where the
    slider runs, from its lowest y at rest, over `travel`. blade: its breadth and length. on_edge: the slider is on the
    blade's back, not on its flat side."""

    length: float
    broad: float
    flat: float
    slot_y: float
    travel: float
    blade: tuple[float, float]
    on_edge: bool


def _sizes(rng: Generator) -> _Body:
    if rng.random() < 0.65:  # snap-off
        length = float(rng.uniform(0.1, 0.185))
        broad = length * float(rng.uniform(0.13, 0.24))
        blade_length = length * float(rng.uniform(0.6, 0.85))
        blade_width = broad * float(rng.uniform(0.4, 0.7))
        on_edge = rng.random() < 0.25
    else:  # utility knife with a short blade
        length = float(rng.uniform(0.09, 0.17))
        broad = length * float(rng.uniform(0.17, 0.3))
        blade_length = length * float(rng.uniform(0.3, 0.45))
        blade_width = broad * float(rng.uniform(0.45, 0.7))
        on_edge = rng.random() < 0.55
    travel = min(0.85 * blade_length, 0.5 * length)
    return _Body(
        length=length,
        broad=broad,
        flat=float(np.clip(broad * rng.uniform(0.35, 0.85), 0.006, 0.03)),
        slot_y=-length * float(rng.uniform(0.05, 0.25)),
        travel=travel * float(rng.uniform(0.75, 1.0)),
        blade=(blade_width, blade_length),
        on_edge=bool(on_edge),
    )


def _outline(rng: Generator, body: _Body) -> Array:
    """(N,2) of the handle in the blade's plane (across, y): straight, bulging, bent or tapered, with rounded ends."""
    share = np.linspace(-1.0, 1.0, 16)
    half = body.broad / 2
    bulge, taper, bend = float(rng.uniform(-0.18, 0.25)), float(rng.uniform(0.0, 0.3)), float(rng.uniform(-0.4, 0.4))
    wave = float(rng.uniform(0.0, 0.07)) * np.sin(share * float(rng.uniform(4, 9)))
    size = half * (1 + bulge * (1 - share**2) - taper * np.clip(share, 0, 1) ** 2 + wave)
    size[0] *= float(rng.uniform(0.4, 1.0))
    size[-1] *= float(rng.uniform(0.5, 1.0))
    middle = bend * half * (share**2 - 0.3) * (rng.random() < 0.5)
    y = share * body.length / 2
    right = np.stack([middle + size, y], axis=1)
    left = np.stack([middle - half * (1 + bulge * 0.4 * (1 - share**2) - taper * np.clip(share, 0, 1) ** 2), y], axis=1)
    left[0, 0], left[-1, 0] = middle[0] - size[0], middle[-1] - size[-1]
    return np.concatenate([right, left[::-1]])


def _handle(rng: Generator, body: _Body, skin: Material, accent: Material, steel: Material) -> list[Mesh]:
    """The handle lying flat, the blade's plane at z = 0."""
    half = body.flat / 2
    outline = _outline(rng, body)
    meshes = [slab(outline, -half, half, half * float(rng.uniform(0.05, 0.6)), skin)]
    slot = body.blade[0] * float(rng.uniform(0.25, 0.6))
    low, high = body.slot_y - 0.01, min(body.slot_y + body.travel + 0.015, 0.49 * body.length)
    dark = plain(rng, gray(rng, 0.02, 0.25)) if rng.random() < 0.7 else steel
    if not body.on_edge:
        meshes.append(block((-slot / 2, low, half - 2e-4), (slot / 2, high, half + 6e-4), dark))
    if rng.random() < 0.65:  # the metal sheath the blade runs in
        wide, tall = 1.15 * body.blade[0], min(0.6 * body.flat, 0.006)
        reach = body.length / 2 + float(rng.uniform(0.0, 0.012))
        start = body.length * float(rng.uniform(-0.2, 0.42))
        meshes.append(block((-wide / 2, start, -tall / 2), (wide / 2, reach, tall / 2), steel, 2e-4))
    draw = rng.random()
    if draw < 0.45:  # grip: ribs across, on both faces
        count = int(rng.integers(4, 10))
        width = body.broad * float(rng.uniform(0.5, 0.95))
        rib = block((-width / 2, 0.0, -half - 8e-4), (width / 2, 0.0018, half + 8e-4), accent)
        start = -0.42 * body.length
        y = start + np.arange(count) * float(rng.uniform(0.003, 0.006))
        meshes.append(repeated(rib, np.stack([np.zeros(count), y, np.zeros(count)], axis=1)))
    elif draw < 0.7:  # a rubber grip of another colour
        part = outline[(outline[:, 1] > -0.45 * body.length) & (outline[:, 1] < 0.05 * body.length)]
        meshes.append(slab(part * np.array([1.06, 1.0]), -half - 6e-4, half + 6e-4, 4e-4, accent))
    if rng.random() < 0.45:  # an end cap
        size = float(rng.uniform(0.04, 0.1)) * body.length
        wide = 0.42 * body.broad
        meshes.append(
            block(
                (-wide, -body.length / 2 - 0.3 * size, -0.9 * half),
                (wide, -body.length / 2 + size, 0.9 * half),
                accent,
                0.001,
            )
        )
    if rng.random() < 0.3:  # a print
        w, h = 0.3 * body.broad, 0.18 * body.length
        label = printed(rng, random_color(rng), (-w, -h, 2 * w, 2 * h))
        meshes.append(shifted(block((-w, -h, -half - 3e-4), (w, h, half + 3e-4), label), 0, -0.2 * body.length, 0))
    if rng.random() < 0.5:  # screws
        radius = 0.09 * body.broad
        for y in rng.uniform(-0.4, 0.35, int(rng.integers(1, 3))):
            x = 0.3 * body.broad * float(rng.choice([-1, 1]))
            ends = (np.array([x, y * body.length, -half - 6e-4]), np.array([x, y * body.length, half + 6e-4]))
            meshes.append(rod(ends[0], ends[1], radius, steel, 10))
    return meshes


def _blade(
    rng: Generator, body: _Body, accent: Material, steel: Material, edge: float
) -> tuple[list[Mesh], list[Mesh]]:
    """Blade, lying flat, and slider, towards +z, both drawn in; edge: the side, -1 or 1, that cuts."""
    wide, length = body.blade
    tip = body.length / 2 - 0.001
    slant = wide * float(rng.uniform(0.4, 1.3))
    half = wide / 2
    outline = np.array([[-half, tip - length], [half, tip - length], [half, tip - slant], [-half, tip]])
    outline = outline if edge > 0 else (outline * np.array([-1, 1]))[::-1]
    thick = float(rng.uniform(0.0004, 0.001))
    meshes = [slab(outline, -thick / 2, thick / 2, 0.2 * thick, steel)]
    if length > 0.5 * body.length and rng.random() < 0.8:  # where segments break off
        line = np.array([[-0.5 * half, 0], [0.45 * half, 0], [0.5 * half, 4e-4], [-0.45 * half, 4e-4]])
        line[:, 1] += line[:, 0] * -edge * 0.6
        mark = slab(line, -thick / 2 - 1e-4, thick / 2 + 1e-4, 1e-5, plain(rng, gray(rng, 0.1, 0.4)))
        y = np.arange(tip - slant, tip - 0.7 * length, -float(rng.uniform(0.5, 0.8)) * wide)
        meshes.append(repeated(mark, np.stack([np.zeros(len(y)), y, np.zeros(len(y))], axis=1)))
    long = float(rng.uniform(0.012, 0.03))
    tall = float(rng.uniform(0.0015, 0.006))
    y, across = body.slot_y, body.blade[0] * float(rng.uniform(0.35, 0.9))
    top = (body.broad if body.on_edge else body.flat) / 2
    button = [block((-across / 2, y, 0.0), (across / 2, y + long, top + tall), accent, 0.3 * tall)]
    if rng.random() < 0.6:
        count = int(rng.integers(3, 6))
        rib = block((-across / 2, 0, 0), (across / 2, 0.001, 0.0008), accent)
        offsets = np.stack(
            [np.zeros(count), y + long * np.linspace(0.2, 0.8, count), np.full(count, top + tall)], axis=1
        )
        button.append(repeated(rib, offsets))
    if not body.on_edge and rng.random() < 0.2:  # a wheel that locks the blade
        wheel = revolved([(0.45 * across, 0), (0.4 * across, 0.004)], accent, 16)
        button.append(shifted(wheel, 0, y + long, top))
    return meshes, button


def sample_object(rng: Generator) -> ArticulatedObject:
    """A random cutter, its blade drawn in, the slider towards +z."""
    body = _sizes(rng)
    skin = plain(rng, random_color(rng)) if rng.random() < 0.82 else metal(rng)
    accent = plain(rng, gray(rng, 0.02, 0.2)) if rng.random() < 0.45 else plain(rng, random_color(rng))
    steel = plain(rng, gray(rng, 0.45, 0.92), contrast=0.03) if rng.random() < 0.85 else metal(rng)
    handle = _handle(rng, body, skin, accent, steel)
    blade, button = _blade(rng, body, accent, steel, float(rng.choice([-1, 1])))
    if body.on_edge:  # stand it up, the blade's back with the slider to +z
        handle, blade = ([_on_edge(mesh) for mesh in meshes] for meshes in (handle, blade))
    point = (0.0, body.length / 2, 0.0)
    limit = (0.0, body.travel)
    return articulated_object(CATEGORIES["cutter"].joints, (handle, blade + button), (point,), limits=[limit])


def _on_edge(mesh: Mesh) -> Mesh:
    """The mesh turned about y so that what lay to +x is up."""
    vertices = mesh.vertices[:, [2, 1, 0]] * np.array([-1.0, 1.0, 1.0], np.float32)
    return Mesh(vertices, mesh.local, mesh.triangles, mesh.skin, mesh.materials)
