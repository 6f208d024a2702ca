"""Triangle meshes made of lofts: closed loops joined by bands, which is enough for boxes, trays, plates,
pens and knobs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from page_runtime.geometry import Array
from page_training.scenes.materials import Material
from page_training.scenes.textures import Generator

Points = NDArray[np.float32]


@dataclass(frozen=True, eq=False, slots=True)
class Mesh:
    """vertices: (V,3) metres where the mesh stands now. local: (V,3) where it was made; textures stick to
    these. triangles: (F,3) vertex indices. skin: (F,) index into materials.
    """

    vertices: Points
    local: Points
    triangles: NDArray[np.int32]
    skin: NDArray[np.int32]
    materials: tuple[Material, ...]


def moved(mesh: Mesh, T_a_b: Array) -> Mesh:
    """The mesh in frame a, its texture moving with it; T_a_b: (4,4)."""
    vertices = mesh.vertices @ T_a_b[:3, :3].T.astype(np.float32) + T_a_b[:3, 3].astype(np.float32)
    return replace(mesh, vertices=vertices)


def shifted(mesh: Mesh, x: float, y: float, z: float) -> Mesh:
    """The mesh moved by (x,y,z) metres, its texture staying where it was made."""
    return replace(mesh, vertices=mesh.vertices + np.array([x, y, z], np.float32))


def repeated(mesh: Mesh, offsets: Array) -> Mesh:
    """Copies of the mesh at offsets (K,3) metres, as one mesh."""
    count = len(offsets)
    steps = np.arange(count, dtype=np.int32)[:, None, None] * np.int32(len(mesh.vertices))
    return Mesh(
        vertices=(mesh.vertices[None] + offsets[:, None].astype(np.float32)).reshape(-1, 3),
        local=np.tile(mesh.local, (count, 1)),
        triangles=(mesh.triangles[None] + steps).reshape(-1, 3),
        skin=np.tile(mesh.skin, count),
        materials=mesh.materials,
    )


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several; equal materials are kept once."""
    index: dict[int, int] = {}
    materials: list[Material] = []
    skins, triangles, offset = [], [], 0
    for mesh in meshes:
        for material in mesh.materials:
            if id(material) not in index:
                index[id(material)] = len(materials)
                materials.append(material)
        skins.append(np.array([index[id(m)] for m in mesh.materials], np.int32)[mesh.skin])
        triangles.append(mesh.triangles + np.int32(offset))
        offset += len(mesh.vertices)
    return Mesh(
        vertices=np.concatenate([m.vertices for m in meshes]),
        local=np.concatenate([m.local for m in meshes]),
        triangles=np.concatenate(triangles),
        skin=np.concatenate(skins),
        materials=tuple(materials),
    )


@lru_cache(maxsize=256)
def _loft_triangles(levels: int, count: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Triangles of `levels` loops of `count` points and two cap centres, with their band: 0 = first cap,
    levels = last."""
    i = np.arange(count, dtype=np.int32)
    j = (i + 1) % count
    first, last = levels * count, levels * count + 1
    top = (levels - 1) * count
    triangles = [np.stack([np.full(count, first, np.int32), j, i], 1)]
    for level in range(levels - 1):
        a, b, c, d = i + level * count, j + level * count, i + (level + 1) * count, j + (level + 1) * count
        triangles += [np.stack([a, b, d], 1), np.stack([a, d, c], 1)]
    triangles.append(np.stack([np.full(count, last, np.int32), i + top, j + top], 1))
    bands = np.concatenate([np.repeat(np.int32(b), count * (1 if b in (0, levels) else 2)) for b in range(levels + 1)])
    return np.concatenate(triangles).astype(np.int32), bands.astype(np.int32)


def loft(loops: Sequence[Points] | Points, skins: Material | Sequence[Material]) -> Mesh:
    """Join loops (L,N,3) by bands and close both ends.

    skins: one material, or L + 1 of them: first cap, the L - 1 bands, last cap. Caps are fans about the mean
    point.
    """
    stack = np.asarray(loops, np.float32)
    levels, count = stack.shape[:2]
    triangles, bands = _loft_triangles(levels, count)
    vertices = np.concatenate([stack.reshape(-1, 3), stack[:1].mean(1), stack[-1:].mean(1)])
    if isinstance(skins, Material):
        return Mesh(vertices, vertices, triangles, np.zeros(len(triangles), np.int32), (skins,))
    return Mesh(vertices, vertices, triangles, bands, tuple(skins))


def rounded_rectangle(width: float, depth: float, radius: float, steps: int = 3) -> Points:
    """Loop (4 * (steps + 1), 2) counter-clockwise about the origin, corners rounded by `radius` metres."""
    radius = min(radius, 0.49 * min(width, depth))
    quarter = np.linspace(0, np.pi / 2, steps + 1)
    angle = (np.arange(4)[:, None] * (np.pi / 2) + quarter).ravel()
    corner = np.repeat(np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]), steps + 1, axis=0)
    middle = corner * np.array([width / 2 - radius, depth / 2 - radius])
    return (middle + radius * np.stack([np.cos(angle), np.sin(angle)], 1)).astype(np.float32)


def subdivided(loop: Points, step_m: float) -> Points:
    """The loop (N,2) resampled about every `step_m` metres along its edges, corners kept."""
    following = np.roll(loop, -1, axis=0)
    counts = np.maximum(1, np.ceil(np.linalg.norm(following - loop, axis=1) / step_m)).astype(int)
    start = np.repeat(np.arange(len(loop)), counts)
    share = (np.arange(len(start)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[start]
    return (loop[start] + (following - loop)[start] * share[:, None]).astype(np.float32)


def roughened(rng: Generator, loop: Points, amplitude_m: float) -> Points:
    """The loop with the ragged edge of a scanned mesh: resampled every 2-5 mm and displaced at random."""
    fine = subdivided(loop, float(rng.uniform(0.002, 0.005)))
    return (fine + rng.normal(0, amplitude_m, fine.shape)).astype(np.float32)


def inset(loop: Points, by_x: float, by_y: float | None = None) -> Points:
    """The loop shrunk towards the origin by `by_x`, `by_y` metres on each side (grown if negative)."""
    half = np.abs(loop).max(axis=0)
    return loop * np.maximum(1 - np.array([by_x, by_x if by_y is None else by_y], np.float32) / half, 0.02)


def at_height(loop: Points, z: float) -> Points:
    """(N,3) of the loop (N,2) at height z."""
    return np.concatenate([loop, np.full((len(loop), 1), z, np.float32)], axis=1)


def plate(loop: Points, bottom: float, top: float, bevel: float, skins: Material | Sequence[Material]) -> Mesh:
    """A solid between two heights with bevelled rims; skins: bottom, lower bevel, side, upper bevel, top."""
    bevel = min(bevel, 0.45 * (top - bottom))
    small = inset(loop, bevel)
    return loft(
        [
            at_height(small, bottom),
            at_height(loop, bottom + bevel),
            at_height(loop, top - bevel),
            at_height(small, top),
        ],
        skins,
    )


def tray(
    loop: Points,
    bottom: float,
    top: float,
    floor: float,
    wall: float,
    bevel: float,
    skins: Material | Sequence[Material],
) -> Mesh:
    """An open tray (upside down if top < bottom); floor: height of its inner floor, metres.

    skins: under side, lower bevel, outer wall, rim, inner wall, inner floor.
    """
    sign = 1.0 if top > bottom else -1.0
    inner = inset(loop, wall)
    lofted = [
        at_height(inset(loop, bevel), bottom),
        at_height(loop, bottom + sign * bevel),
        at_height(loop, top),
        at_height(inner, top),
        at_height(inner, floor),
    ]
    return loft(lofted, skins)


def cuboid(size: Sequence[float], skin: Material, *, bevel: float = 0.0) -> Mesh:
    """A cuboid of size (x,y,z) standing on z = 0 about the origin; without a bevel it has very few
    triangles."""
    if bevel > 0:
        return plate(rounded_rectangle(size[0], size[1], bevel, steps=1), 0.0, size[2], bevel, skin)
    loop = rounded_rectangle(size[0], size[1], 0.0, steps=0)
    return loft([at_height(loop, 0.0), at_height(loop, size[2])], skin)


def rectangle(width: float, depth: float, skin: Material) -> Mesh:
    """A rectangle in the plane z = 0 about the origin: two triangles."""
    vertices = at_height(rounded_rectangle(width, depth, 0.0, steps=0), 0.0)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(vertices, vertices, triangles, np.zeros(2, np.int32), (skin,))


def revolved(profile: Sequence[tuple[float, float]], skins: Material | Sequence[Material], steps: int = 24) -> Mesh:
    """A solid of revolution about z; profile: (radius, height) metres from bottom to top."""
    angle = np.arange(steps) * (2 * np.pi / steps)
    circle = np.stack([np.cos(angle), np.sin(angle)], 1).astype(np.float32)
    return loft([at_height(circle * np.float32(max(r, 1e-5)), z) for r, z in profile], skins)


def ball(radius: float, skin: Material, steps: int = 24) -> Mesh:
    """A sphere standing on z = 0."""
    tilt = np.linspace(-np.pi / 2, np.pi / 2, steps // 2 + 1)
    return revolved([(radius * float(np.cos(a)), radius * float(1 + np.sin(a))) for a in tilt], skin, steps)
