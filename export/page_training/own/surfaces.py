"""Mesh files into coloured surfaces of few triangles. The only module that imports trimesh and yourdfpy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from page_runtime.geometry import Array
from page_training.own.model import Surface

# All parts of a model together: what a ray caster and a texture map do in a few milliseconds.
MOST_TRIANGLES = 24_000
MOST_COLORS = 12
GRAY = np.array([0.6, 0.6, 0.6], np.float32)
_MISSING = "pip install 'page-edge[models]'"
_LFS_POINTER = b"version https://git-lfs.github.com/spec/"


def open_mesh(path: Path, unit_m: float = 1.0) -> list[Any]:
    """The meshes of an OBJ, STL, PLY, GLB, ... file where they stand in it, metres; ValueError when it has none."""
    try:
        import trimesh
    except ImportError as error:
        raise ImportError(f"mesh files need trimesh ({error}): {_MISSING}") from error
    if not path.is_file():
        raise ValueError(f"{path}: expected a mesh file, got nothing there")
    with path.open("rb") as file:
        if file.read(len(_LFS_POINTER)) == _LFS_POINTER:
            raise ValueError(
                f"{path}: expected a mesh, got a Git-LFS pointer to one; `git lfs pull` in its repository fetches it"
            )
    try:
        scene = trimesh.load_scene(path)
    except Exception as error:  # every format's loader raises its own
        raise ValueError(f"{path}: expected a mesh that trimesh can load, got {error}") from error
    meshes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not meshes:
        raise ValueError(f"{path}: expected triangles, got none; the file is empty, cut off or of another format")
    for mesh in meshes:
        mesh.apply_scale(unit_m)
    return meshes


def open_urdf(path: Path) -> Any:
    """The robot of a URDF file with its visual meshes; ValueError when it or one of them cannot be read."""
    try:
        import yourdfpy
    except ImportError as error:
        raise ImportError(f"URDF files need yourdfpy ({error}): {_MISSING}") from error
    faults: dict[str, str | None] = {}

    def mesh_file(fname: str, **_: object) -> str:
        found = _mesh_file(path, fname)
        if fname not in faults:
            faults[fname] = _mesh_fault(fname, found)
        return fname if found is None else str(found)

    failure: Exception | None = None
    robot = None
    try:
        robot = yourdfpy.URDF.load(str(path), load_meshes=True, build_scene_graph=True, filename_handler=mesh_file)
    except Exception as error:  # XML, mesh and path errors of several libraries
        failure = error
    # yourdfpy leaves out what trimesh finds nothing in, without a word.
    if found := [fault for fault in faults.values() if fault]:
        more = f"; {len(found) - 1} more of its meshes cannot be read either" if len(found) > 1 else ""
        raise ValueError(f"{path}: {found[0]}{more}")
    if failure is not None:
        raise ValueError(f"{path}: expected a URDF that yourdfpy can load, got {failure}") from failure
    return robot


def _mesh_fault(name: str, found: Path | None) -> str | None:
    """Why a mesh that a URDF names cannot be read, None for one that can."""
    if found is None:
        return f"expected the mesh {name} beside it or in a folder above, got nothing there"
    try:
        open_mesh(found)
    except ValueError as error:
        return f"mesh {error}"
    return None


def _mesh_file(urdf: Path, name: str) -> Path | None:
    """The file a URDF names, by a path from its folder or package://NAME/PATH with the package in a folder above; some
    leave out the name, or have the package in a folder of another one."""
    inside = name.partition("://")[2] or name
    shorter = inside.partition("/")[2] if "://" in name else ""
    for folder in (urdf.parent, *urdf.resolve().parents):
        for tail in filter(None, (inside, shorter)):
            if (folder / tail).is_file():
                return folder / tail
    return None


def link_meshes(robot: Any) -> dict[str, list[Any]]:
    """Of every link with visual geometry its meshes, in the link's frame."""
    graph, found = robot.scene.graph, {}
    parents = graph.transforms.parents
    for node in graph.nodes_geometry:
        T_world_node, geometry = graph.get(node)
        link = node
        while link is not None and link not in robot.link_map:
            link = parents.get(link)
        mesh = robot.scene.geometry[geometry].copy()
        if link is None or not len(getattr(mesh, "faces", ())):
            continue
        mesh.apply_transform(np.linalg.inv(robot.get_transform(link)) @ T_world_node)
        found.setdefault(link, []).append(mesh)
    return found


def surfaces_of(parts: Sequence[Sequence[Any]]) -> list[Surface]:
    """One surface for the meshes of each part, all in one palette and with at most MOST_TRIANGLES together."""
    colors = [[_face_colors(mesh) for mesh in meshes] for meshes in parts]
    palette = _palette(np.concatenate([one for own in colors for one in own]))
    total = sum(len(mesh.faces) for meshes in parts for mesh in meshes)
    keep = min(1.0, MOST_TRIANGLES / total)
    return [_surface(meshes, own, palette, keep) for meshes, own in zip(parts, colors, strict=True)]


def _face_colors(mesh: Any) -> NDArray[np.float32]:
    """(F,3) RGB in [0,1]; a texture gives every face the mean of its corners', no colour is gray."""
    visual, faces = mesh.visual, np.asarray(mesh.faces)
    colors = np.empty(0)
    if visual is not None and visual.defined and visual.kind == "texture":
        # Undefined where there is no picture, or no place in it for each vertex.
        sampled = visual.to_color()
        colors = sampled.vertex_colors if sampled.defined else np.tile(visual.material.main_color, (len(faces), 1))
    elif visual is not None and visual.defined:
        colors = visual.vertex_colors if visual.kind == "vertex" else visual.face_colors
    rgb = np.asarray(colors, np.float32).reshape(-1, 4)[:, :3] / np.float32(255)
    if len(rgb) == len(mesh.vertices) != len(faces):
        return rgb[faces].mean(axis=1)
    return rgb if len(rgb) == len(faces) else np.tile(GRAY, (len(faces), 1))


def _palette(colors: NDArray[np.float32]) -> NDArray[np.float32]:
    """(P,3) the commonest of the colours (N,3), those nearly alike taken together."""
    coarse, index, counts = np.unique(np.round(colors * 12), axis=0, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(index.ravel(), colors[:, c], len(coarse)) / counts for c in range(3)], axis=1)
    return means[np.argsort(-counts, kind="stable")[:MOST_COLORS]].astype(np.float32)


def _surface(
    meshes: Sequence[Any], colors: Sequence[NDArray[np.float32]], palette: NDArray[np.float32], keep: float
) -> Surface:
    vertices, triangles, color, offset = [], [], [], 0
    for mesh, own in zip(meshes, colors, strict=True):
        nearest = ((own[:, None] - palette[None]) ** 2).sum(axis=2).argmin(axis=1)
        for shade in np.unique(nearest):
            points, faces = _simplified(
                np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)[nearest == shade], keep
            )
            vertices.append(points)
            triangles.append(faces + offset)
            color.append(np.full(len(faces), shade, np.int32))
            offset += len(points)
    return Surface(
        np.concatenate(vertices).astype(np.float32),
        np.concatenate(triangles).astype(np.int32),
        np.concatenate(color),
        palette,
    )


def _simplified(
    vertices: NDArray[np.float64], faces: NDArray[Any], keep: float
) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Points and triangles of these faces alone, about `keep` of them."""
    used, flat = np.unique(faces, return_inverse=True)
    points, own = vertices[used], flat.reshape(-1, 3)
    # Files like STL repeat every corner; only joined ones can be simplified.
    points, index = np.unique(np.round(points, 7), axis=0, return_inverse=True)
    own = index.ravel()[own]
    own = own[(own[:, 0] != own[:, 1]) & (own[:, 1] != own[:, 2]) & (own[:, 2] != own[:, 0])]
    if keep >= 1.0 or len(own) < 60:
        return points, own
    try:
        import fast_simplification
    except ImportError as error:
        raise ImportError(f"fine meshes need fast-simplification ({error}): {_MISSING}") from error
    simple = fast_simplification.simplify(points, own.astype(np.int32), target_reduction=1.0 - keep)
    return simple[0], simple[1]


def multiplied(meshes: Sequence[Any], T_a_b: Array) -> list[Any]:
    """The meshes in frame a."""
    moved = []
    for mesh in meshes:
        copy = mesh.copy()
        copy.apply_transform(T_a_b)
        moved.append(copy)
    return moved
