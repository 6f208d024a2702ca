"""A template of every part of a category: the surface that the runtime's optional refinement (icp.py) fits to points.

Made from procedural instances alone, so that the exporter can put it into a bundle. The instances of a part are brought
to one box, the category's; the template is the one whose surface is nearest to all others', not a mean of them: a mean
of trays with different floors has no floor anywhere.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.category import Category
from page_runtime.geometry import Array
from page_runtime.similarity import FloatArray
from page_runtime.template import Template
from page_training.scenes.articulated import ArticulatedObject, PartModel
from page_training.scenes.kinds import scene_category
from page_training.scenes.meshes import Mesh
from page_training.scenes.textures import Generator

TEMPLATE_POINTS = 512
# Of all parts together: of seven they would be a tenth of a bundle's bytes.
MOST_POINTS = 2048
INSTANCES = 48
_CANDIDATES_A_POINT = 6
# Samples come farthest first, so that the first few are spread evenly as well.
_COMPARED = 128

ObjectOf = Callable[[Generator], ArticulatedObject]


def with_templates(category: Category, sample_object: ObjectOf | None = None, instances: int = INSTANCES) -> Category:
    """The category with a template for each part, the same at every call; as it is where its parts have theirs, which
    those of a category of the user's own do. sample_object: of the category, None for that of its scenes; instances: as
    `part_templates` takes them."""
    if all(part.template is not None for part in category.parts):
        return category
    templates = part_templates(
        sample_object or scene_category(category.name).sample_object,
        np.random.default_rng(zlib.crc32(category.name.encode())),
        instances=instances,
        points=min(TEMPLATE_POINTS, MOST_POINTS // len(category.parts)),
    )
    parts = (replace(part, template=template) for part, template in zip(category.parts, templates, strict=True))
    return replace(category, parts=tuple(parts))


def part_templates(
    sample_object: ObjectOf, rng: Generator, *, instances: int = INSTANCES, points: int = TEMPLATE_POINTS
) -> tuple[Template, ...]:
    """One template for each part of a category's objects, in the order of its parts, of `points` samples each.

    instances: objects it is chosen from; their number squared is compared.
    """
    if instances < 1 or points < 4:
        raise ValueError(f"expected at least 1 instance and 4 points, got {instances} and {points}; ask for more")
    objects = [sample_object(rng) for _ in range(instances)]
    return tuple(
        central_template([template_of(item.parts[k], rng, points) for item in objects])
        for k in range(len(objects[0].parts))
    )


def central_template(templates: list[Template]) -> Template:
    """The template whose surface is nearest to the others' in the median, all in the box of median proportions."""
    proportions = np.median([template.extents_unit for template in templates], axis=0)
    alike = [template.stretched(proportions) for template in templates]
    distances = np.array([[_misfit(one, other) for other in alike] for one in alike])
    return alike[int(np.median(distances + distances.T, axis=1).argmin())]


def template_of(part: PartModel, rng: Generator, points: int = TEMPLATE_POINTS) -> Template:
    """Samples of one part's surface, evenly spread, in units of its diagonal."""
    diagonal_m = float(np.linalg.norm(part.extents_m))
    samples, normals = surface_samples(part.mesh, rng, _CANDIDATES_A_POINT * points)
    chosen = evenly_spread(samples, points)
    return Template(samples[chosen] / diagonal_m, normals[chosen], np.asarray(part.extents_m, float) / diagonal_m)


def surface_samples(mesh: Mesh, rng: Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """(count,3) points uniform over the area of a mesh of closed pieces, m, and their outward unit normals."""
    corners = mesh.vertices.astype(np.float64)[mesh.triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * _outward(mesh)[:, None]
    doubled = np.linalg.norm(cross, axis=1)
    chosen = rng.choice(len(doubled), count, p=doubled / doubled.sum())
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1.0 - u, u * (1.0 - v), u * v], axis=1)
    points = np.einsum("nk,nkc->nc", weights, corners[chosen])
    return np.asarray(points, np.float64), np.asarray(cross[chosen] / doubled[chosen, None], np.float64)


def _outward(mesh: Mesh) -> Array:
    """(F,) +1 where a triangle's vertices turn left seen from outside, else -1: lofts made downwards are inside out."""
    piece = np.arange(len(mesh.vertices))
    while True:
        lowest = piece[mesh.triangles].min(axis=1)
        before = piece.copy()
        np.minimum.at(piece, mesh.triangles.ravel(), np.repeat(lowest, 3))
        if np.array_equal(piece, before):
            break
    first = piece[mesh.triangles[:, 0]]
    corners = mesh.vertices.astype(float)[mesh.triangles]
    volume = np.bincount(first, np.linalg.det(corners), minlength=len(piece))
    return np.where(volume[first] < 0.0, -1.0, 1.0)


def evenly_spread(points: Array, count: int) -> NDArray[np.intp]:
    """Indices of `count` of the points (n,3) by farthest-point selection; all of them if there are no more."""
    if len(points) <= count:
        return np.arange(len(points))
    chosen = np.zeros(count, np.intp)
    nearest = np.full(len(points), np.inf)
    for k in range(1, count):
        nearest = np.minimum(nearest, ((points - points[chosen[k - 1]]) ** 2).sum(axis=1))
        chosen[k] = nearest.argmax()
    return chosen


def _misfit(one: Template, other: Template) -> float:
    """Mean distance from samples of `one` to the nearest of `other` that face the same way, diagonals."""
    points, normals = one.points_unit[:_COMPARED], one.normals_unit[:_COMPARED]
    squared = (points**2).sum(axis=1)[:, None] - 2.0 * points @ other.points_unit.T + (other.points_unit**2).sum(axis=1)
    squared[normals @ other.normals_unit.T < 0.5] = 0.25
    return float(np.sqrt(np.maximum(squared.min(axis=1), 0.0)).mean())
