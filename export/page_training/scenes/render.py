"""Ray casting and shading: the noiseless picture of a scene. The only module that imports Open3D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.geometry import invert
from page_training.scenes.meshes import Mesh, joined
from page_training.scenes.textures import PATTERN_SIZE, pattern_bank

try:
    import open3d as o3d
except (ImportError, OSError) as error:
    raise ImportError(
        f"Open3D cannot be loaded ({error}); install the extra 'open3d', and on Debian the system library: "
        "apt-get install libusb-1.0-0"
    ) from error

# float32 in fact; NumPy's stubs widen the results of mixed arithmetic.
Floats = NDArray[np.floating]
BACKGROUND = 0
SHADOW_STRIDE = 2
SPECULAR, GLOSS, EMISSION, MOTTLE, OPACITY = range(5)


@dataclass(frozen=True, eq=False, slots=True)
class Light:
    """direction_world: (3,) unit, towards the light. color: (3,). casts_shadow: hard objects darken what is
    behind."""

    direction_world: Floats
    color: Floats
    casts_shadow: bool


@dataclass(frozen=True, eq=False, slots=True)
class Lighting:
    """ambient: (3,) from below to above by `ambient_slope`. occlusion: strength (0-1) of darkening in
    corners."""

    ambient: Floats
    ambient_slope: float
    lights: tuple[Light, ...]
    occlusion: float


@dataclass(frozen=True, eq=False, slots=True)
class World:
    """Everything that can be seen, ready to be cast. Per triangle: texel (F,3,2), its first corner's texel
    and the ways to the other two; skin (F,); label (F,) with 0 = background and k + 1 = part k. Per
    material: table (M*256,3), pattern (M,), optics (M,5) = specular, gloss, emission, mottle, opacity to
    depth.
    """

    caster: Any
    texel: Floats
    skin: NDArray[np.int32]
    label: NDArray[np.uint8]
    table: Floats
    pattern: NDArray[np.int32]
    optics: Floats


@dataclass(frozen=True, eq=False, slots=True)
class Rendering:
    """depth_m: (H,W) float32 z-depth. label: (H,W) uint8. normals_camera: (H,W,3) float32 unit, towards the
    camera. color: (H,W,3) float32, linear light, 1 = white paper in full light. opacity: (H,W) float32, how
    well depth sensors see the surface (1 = well).
    """

    depth_m: Floats
    label: NDArray[np.uint8]
    normals_camera: Floats
    color: Floats
    opacity: Floats


def _tensor(array: NDArray[Any]) -> Any:
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array))


def _caster(vertices: Floats, triangles: NDArray[np.integer]) -> Any:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(_tensor(vertices.astype(np.float32)), _tensor(triangles.astype(np.uint32)))
    return scene


def world_from(meshes: Sequence[Mesh], labels: Sequence[int]) -> World:
    """The world of meshes (in world coordinates), each with the label of the part it belongs to."""
    mesh = joined(meshes)
    label = np.repeat(np.array(labels, np.uint8), [len(m.triangles) for m in meshes])
    corners = mesh.local[mesh.triangles]
    normal = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    # Textures are laid on along the axis a face looks to: (x,y) from above, (x,z) from the front, (y,z) from
    # the side.
    axes = np.array([[1, 2], [0, 2], [0, 1]])[normal.argmax(axis=1)]
    uv = np.take_along_axis(corners, axes[:, None, :], axis=2)
    to_texel = np.stack([m.texel_from_m for m in mesh.materials])[mesh.skin]
    texel = np.matmul(uv, to_texel[:, :, :2].transpose(0, 2, 1)) + to_texel[:, None, :, 2]
    texel[:, 1:] -= texel[:, :1]
    return World(
        caster=_caster(mesh.vertices, mesh.triangles),
        texel=texel.astype(np.float32),
        skin=mesh.skin,
        label=label,
        table=np.concatenate([m.table for m in mesh.materials]).astype(np.float32),
        pattern=np.array([m.pattern for m in mesh.materials], np.int32),
        optics=np.array(
            [[m.specular, m.gloss, m.emission, m.mottle, m.opacity_to_depth] for m in mesh.materials],
            np.float32,
        ),
    )


def silhouette_caster(mesh: Mesh) -> Any:
    """A caster of one mesh alone, for `silhouette`."""
    return _caster(mesh.vertices, mesh.triangles)


def _rays(camera: Camera) -> Floats:
    """(H,W,6) rays in the world; their direction has unit z in the camera, so the hit parameter is the
    z-depth."""
    T_world_camera = invert(camera.T_camera_world)
    x = ((np.arange(camera.width) - camera.K[0, 2]) / camera.K[0, 0]).astype(np.float32)
    y = ((np.arange(camera.height) - camera.K[1, 2]) / camera.K[1, 1]).astype(np.float32)
    right, down, forward = T_world_camera[:3, :3].T.astype(np.float32)
    rays = np.empty((camera.height, camera.width, 6), np.float32)
    rays[..., :3] = T_world_camera[:3, 3]
    np.add((x[:, None] * right)[None], (y[:, None] * down + forward)[:, None], out=rays[..., 3:])
    return rays


def labels_seen(world: World, camera: Camera) -> NDArray[np.uint8]:
    """(H,W) uint8 labels, without shading."""
    hit = world.caster.cast_rays(_tensor(_rays(camera)), nthreads=1)["primitive_ids"].numpy()
    return np.append(world.label, np.uint8(BACKGROUND))[np.minimum(hit, len(world.label))]


def silhouette(caster: Any, camera: Camera) -> NDArray[np.bool_]:
    """(H,W) bool: pixels a mesh covers when nothing else is there."""
    return caster.test_occlusions(_tensor(_rays(camera)), nthreads=1).numpy()


def render(world: World, camera: Camera, lighting: Lighting) -> Rendering:
    """The noiseless picture of `world` from `camera`."""
    rays = _rays(camera)
    answer = world.caster.cast_rays(_tensor(rays), nthreads=1)
    depth = answer["t_hit"].numpy()
    missed = ~np.isfinite(depth)
    anything_missed = bool(missed.any())
    triangle = answer["primitive_ids"].numpy()
    if anything_missed:
        triangle = np.where(missed, np.uint32(0), triangle)
        depth = np.where(missed, np.float32(0), depth)
    normal = answer["primitive_normals"].numpy()
    away = np.einsum("hwc,hwc->hw", normal, rays[..., 3:]) > 0
    normal = np.where(away[..., None], -normal, normal)

    skin = np.take(world.skin, triangle)
    albedo = _reflectance(world, triangle, answer["primitive_uvs"].numpy(), skin)
    light, shine = _light(world, rays, depth, normal, lighting, skin)
    color = albedo * (light + np.take(world.optics[:, EMISSION], skin)[..., None]) + shine
    if lighting.occlusion > 0:
        color *= _corner_darkening(depth, camera, lighting.occlusion)[..., None]
    label = np.take(world.label, triangle)
    normals = normal @ camera.T_camera_world[:3, :3].T.astype(np.float32)
    if anything_missed:
        label[missed] = BACKGROUND
        normals[missed] = 0
    return Rendering(depth, label, normals, color, np.take(world.optics[:, OPACITY], skin))


def _reflectance(world: World, triangle: NDArray[np.uint32], weight: Floats, skin: NDArray[np.int32]) -> Floats:
    """(H,W,3) reflectance at every hit: texel -> byte of the pattern -> colour of the table, with
    blotches."""
    texel = np.take(world.texel, triangle, axis=0)
    place = texel[..., 0, :] + weight[..., :1] * texel[..., 1, :] + weight[..., 1:] * texel[..., 2, :]
    place = np.floor(place).astype(np.int32)
    column, row = place[..., 0], place[..., 1]
    mask = np.int32(PATTERN_SIZE - 1)
    bank = pattern_bank()
    flat = bank.texels.reshape(-1)
    area = PATTERN_SIZE * PATTERN_SIZE
    offset = (row & mask) * np.int32(PATTERN_SIZE) + (column & mask)
    value = np.take(flat, np.take(world.pattern * area, skin) + offset)
    albedo = np.take(world.table, skin * np.int32(256) + value, axis=0)
    blotches = np.take(flat, offset + np.int32(bank.kinds["speckle"][0] * area)).astype(np.float32)
    shade = 1 + np.take(world.optics[:, MOTTLE], skin) * (blotches * np.float32(1 / 128) - 1)
    return albedo * shade[..., None]


def _light(
    world: World, rays: Floats, depth: Floats, normal: Floats, lighting: Lighting, skin: NDArray[np.int32]
) -> tuple[Floats, Floats]:
    """Diffuse (H,W,3) light and the highlights (H,W,3) it makes."""
    diffuse = lighting.ambient * (1 + np.float32(lighting.ambient_slope) * normal[..., 2:3])
    shine = np.zeros_like(diffuse)
    shiny_skins = np.take(world.optics[:, SPECULAR], skin).ravel()
    glossy = np.flatnonzero(shiny_skins > 0)
    strength, gloss = shiny_skins[glossy], np.take(world.optics[:, GLOSS], skin.ravel()[glossy])
    facing = np.take(normal.reshape(-1, 3), glossy, axis=0)
    view = _unit(-np.take(rays.reshape(-1, 6), glossy, axis=0)[:, 3:])
    for light in lighting.lights:
        cosine = np.maximum(normal @ light.direction_world, 0)
        if light.casts_shadow:
            cosine = cosine * _lit(world, rays, depth, normal, light.direction_world)
        diffuse += cosine[..., None] * light.color
        half = _unit(view + light.direction_world)
        sharp = np.einsum("nc,nc->n", facing, half).clip(0)
        # A power by exp and log: NumPy's float32 power is several times slower.
        sharp = np.exp(gloss * np.log(sharp + np.float32(1e-6)))
        shine.reshape(-1, 3)[glossy] += (strength * sharp * (cosine.ravel()[glossy] > 0))[:, None] * light.color
    return diffuse, shine


def _unit(vectors: Floats) -> Floats:
    return vectors / np.sqrt(np.einsum("nc,nc->n", vectors, vectors))[:, None]


def _lit(world: World, rays: Floats, depth: Floats, normal: Floats, direction: Floats) -> Floats:
    """(H,W) share of the light that arrives, cast on every second pixel and smoothed, which softens shadow
    edges."""
    step = slice(None, None, SHADOW_STRIDE)
    few = rays[step, step]
    shadow_rays = np.empty_like(few)
    shadow_rays[..., :3] = few[..., :3] + few[..., 3:] * depth[step, step, None] + normal[step, step] * np.float32(5e-4)
    shadow_rays[..., 3:] = direction
    dark = world.caster.test_occlusions(_tensor(shadow_rays), nthreads=1).numpy()
    lit = cv2.blur((~dark).astype(np.float32), (3, 3))
    return cv2.resize(lit, (depth.shape[1], depth.shape[0]), interpolation=cv2.INTER_LINEAR)


def _corner_darkening(depth: Floats, camera: Camera, strength: float) -> Floats:
    """(H,W) factor: hollows get less sky. A pixel lies in one when it is behind the mean of two opposite
    neighbours.

    The neighbours are about 8 mm away at the median depth; steps of more than 4 cm are another place, not a
    hollow.
    """
    middle = float(np.median(depth[::8, ::8])) or 1.0
    reach = int(np.clip(0.008 * camera.K[0, 0] / middle / 2, 1, 10))
    small = cv2.resize(depth, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_NEAREST)
    height, width = small.shape
    wide = cv2.copyMakeBorder(small, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    dark = np.zeros_like(small)
    for right, down in ((1, 0), (0, 1), (1, 1), (1, -1)):
        x, y = reach * right, reach * down
        one = small - wide[reach + y : reach + y + height, reach + x : reach + x + width]
        other = small - wide[reach - y : reach - y + height, reach - x : reach - x + width]
        near = np.maximum(np.abs(one), np.abs(other)) < 0.04
        dark += np.clip((one + other) * np.float32(1 / 0.008), 0, 1) * near
    dark = cv2.GaussianBlur(dark, (0, 0), max(1.0, reach / 2)) * np.float32(0.4)
    return 1 - np.float32(strength) * cv2.resize(dark, (depth.shape[1], depth.shape[0])).clip(0, 1)
