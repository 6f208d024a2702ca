"""Solids beyond the lofts of `meshes`: blocks between corners, slabs of any outline, tubes along a path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from page_runtime.geometry import Array, rotation_about, transform_from
from page_training.scenes.materials import Material
from page_training.scenes.meshes import Mesh, Points, cuboid, loft, moved, plate, revolved, shifted

Y_AXIS = np.array([0.0, 1.0, 0.0])
X_AXIS = np.array([1.0, 0.0, 0.0])


def block(low: Sequence[float], high: Sequence[float], skin: Material, bevel: float = 0.0) -> Mesh:
    """A cuboid between two corners, metres."""
    size = [max(end - start, 1e-5) for start, end in zip(low, high, strict=True)]
    return shifted(
        cuboid(size, skin, bevel=min(bevel, 0.4 * min(size))), (low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]
    )


def slab(outline: Array, bottom: float, top: float, bevel: float, skins: Material | Sequence[Material]) -> Mesh:
    """A plate whose outline (N,2), seen whole from its mean point, may lie anywhere; skins as `plate`'s."""
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    loop = (outline - middle).astype(np.float32)
    return shifted(plate(loop, bottom, top, bevel, skins), float(middle[0]), float(middle[1]), 0.0)


def rod(
    start: Array, end: Array, radius: float, skin: Material, steps: int = 12, end_radius: float | None = None
) -> Mesh:
    """A round rod between two points, tapered to end_radius."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = float(np.linalg.norm(end - start))
    mesh = revolved([(radius, 0.0), (radius if end_radius is None else end_radius, length)], skin, steps)
    return moved(mesh, transform_from(_turn_z_to((end - start) / max(length, 1e-9)), start))


def _turn_z_to(direction: Array) -> Array:
    """A rotation (3,3) whose third column is the unit `direction`."""
    axis = np.cross([0.0, 0.0, 1.0], direction)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return np.eye(3) if direction[2] > 0 else rotation_about(X_AXIS, np.pi)
    return rotation_about(axis, float(np.arctan2(sine, direction[2])))


def upright_to(axis: str, mesh: Mesh) -> Mesh:
    """A mesh made along +z laid along "x", "-x", "y" or "-y"."""
    turns = {
        "x": rotation_about(Y_AXIS, np.pi / 2),
        "-x": rotation_about(Y_AXIS, -np.pi / 2),
        "y": rotation_about(X_AXIS, -np.pi / 2),
        "-y": rotation_about(X_AXIS, np.pi / 2),
    }
    return moved(mesh, transform_from(turns[axis], np.zeros(3)))


def tube(
    path: Array,
    across: Array,
    widths: Array | float,
    heights: Array | float,
    skin: Material,
    *,
    corner: float = 1.0,
    steps: int = 8,
    closed: bool = False,
) -> Mesh:
    """A tube along path (N,3): its section is `heights` along `across` (3,) or (N,3) and `widths` sideways.

    corner: 1 for elliptic sections, towards 0 for rectangular ones. closed: the end joins the start, without caps.
    Every segment's section stands across the mean of its neighbours' directions.
    """
    path = np.asarray(path, float)
    count = len(path)
    following, before = np.roll(path, -1, axis=0), np.roll(path, 1, axis=0)
    if not closed:
        following[-1], before[0] = path[-1], path[0]
    along = following - before
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    up = np.broadcast_to(np.asarray(across, float), (count, 3))
    up = up - (up * along).sum(axis=1, keepdims=True) * along
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    side = np.cross(along, up)
    angle = (np.arange(steps) + 0.5) * (2 * np.pi / steps)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    unit = np.sign(unit) * np.abs(unit) ** max(corner, 0.05)
    w = np.broadcast_to(np.asarray(widths, float), (count,))[:, None, None] / 2
    h = np.broadcast_to(np.asarray(heights, float), (count,))[:, None, None] / 2
    loops = path[:, None] + w * unit[None, :, :1] * side[:, None] + h * unit[None, :, 1:] * up[:, None]
    if not closed:
        return loft(loops.astype(np.float32), skin)
    ring = loft(np.concatenate([loops, loops[:1]]).astype(np.float32), skin)
    # A ring has no ends: leave out the caps, one triangle for each point of a section at either end.
    return replace(ring, triangles=ring.triangles[steps:-steps], skin=ring.skin[steps:-steps])


def ellipse(width: float, height: float, steps: int = 28, power: float = 1.0) -> Points:
    """Loop (steps,2) counter-clockwise about the origin; power below 1 makes it squarer, above 1 more pointed."""
    angle = np.arange(steps) * (2 * np.pi / steps)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    unit = np.sign(unit) * np.abs(unit) ** power
    return (unit * np.array([width / 2, height / 2])).astype(np.float32)


def profile(outline_yz: Array, half_width: float, bevel: float, skins: Material | Sequence[Material]) -> Mesh:
    """A slab whose outline (N,2) is of (y,z), standing across x from -half_width to half_width; skins as `plate`'s,
    from -x to +x."""
    made = slab(np.asarray(outline_yz, float), -half_width, half_width, bevel, skins)
    return replace(made, vertices=made.vertices[:, [2, 0, 1]], local=made.local[:, [2, 0, 1]])


def turned(mesh: Mesh, axis: Sequence[float], angle_rad: float) -> Mesh:
    """The mesh turned about the origin."""
    return moved(mesh, transform_from(rotation_about(np.array(axis, float), angle_rad), np.zeros(3)))
