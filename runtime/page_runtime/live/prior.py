"""What the last frames say of the next one: poses with covariances, where to look, and what surface to expect."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.articulation import PartEvidence
from page_runtime.camera import Camera
from page_runtime.category import Category
from page_runtime.equivalents import Renaming, interchanged, turned_extents, turned_part
from page_runtime.focus import Focus, focus_on
from page_runtime.geometry import Array, apply, invert, transform_from
from page_runtime.neighbours import nearest
from page_runtime.part_poses import LabelledPoints
from page_runtime.pose import ArticulatedPose, PartPose
from page_runtime.sampling import Region, square_region

# Surfaces that stick out of the picture count as far as this many of its sides.
_FAR_SIDES = 2
_LEAST_SIDE_PX = 8
_NEAR_M = 0.05


@dataclass(frozen=True, eq=False, slots=True)
class Surface:
    """Visible points of a part: points (n,3) m in its frame, colors (n,3) uint8 RGB."""

    points: NDArray[np.float32]
    colors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False, slots=True)
class PartPrior:
    """One part as it is expected. evidence: its pose, size and their covariance. last: its pose as the network last saw
    it. surface: the points that made it, in the part's frame."""

    evidence: PartEvidence
    last: PartPose
    surface: Surface

    @property
    def surface_camera(self) -> NDArray[np.float32]:
        """(n,3) m, where these points are expected."""
        return apply(self.evidence.T_camera_part, self.surface.points).astype(np.float32)


@dataclass(frozen=True, eq=False, slots=True)
class Prior:
    """An object as it is expected in a frame. parts: in the category's order, None for one that was not seen.
    background_camera: (m,3) m, points around it that are not of it."""

    parts: tuple[PartPrior | None, ...]
    background_camera: NDArray[np.float32]

    @property
    def poses(self) -> list[Array | None]:
        """(4,4) T_camera_part of each part as it is expected, None for one that was not seen."""
        return [None if part is None else part.evidence.T_camera_part for part in self.parts]

    @property
    def known(self) -> list[PartPrior]:
        return [part for part in self.parts if part is not None]

    @property
    def depth_m(self) -> float:
        """z of the object's middle."""
        return float(np.mean([part.evidence.T_camera_part[2, 3] for part in self.known]))


def expected_region(prior: Prior, category: Category, camera: Camera) -> Region | None:
    """(x,y,w,h) px around the expected surfaces, as far as they are in the picture; None if they are not."""
    surfaces = [_outline(part, index, category) for index, part in enumerate(prior.parts) if part is not None]
    points = np.concatenate(surfaces)
    if points[:, 2].min() < _NEAR_M:
        return None
    pixels = _pixels(points, camera)
    size = np.array([camera.width, camera.height])
    low, high = np.maximum(pixels.min(axis=0), 0.0), np.minimum(pixels.max(axis=0), size - 1.0)
    if (high - low < _LEAST_SIDE_PX).any():
        return None
    x, y = np.floor(low).astype(int)
    w, h = np.ceil(high - low).astype(int) + 1
    return int(x), int(y), int(w), int(h)


def expected_focus(prior: Prior, category: Category, camera: Camera, region: Region) -> Focus | None:
    """Where points of a thin object are to be taken, from where its surfaces are expected; None for a category that
    fills its regions."""
    if not category.focused:
        return None
    nowhere = np.empty((0, 3), np.float32)
    surfaces = [nowhere if part is None else part.surface_camera for part in prior.parts]
    seen = [_pixels(surface[surface[:, 2] > _NEAR_M], camera).astype(np.float32) for surface in surfaces]
    return focus_on(seen, square_region(region)[2])


def _pixels(points_camera: NDArray[np.floating], camera: Camera) -> NDArray[np.floating]:
    """(n,2) px of points in front of the camera, wherever in the world that is."""
    return (points_camera @ camera.K.T)[:, :2] / points_camera[:, 2:]


def _outline(part: PartPrior, index: int, category: Category) -> NDArray[np.floating]:
    """(n,3) m of the part's template where it is expected, or of its box without one."""
    evidence, template = part.evidence, category.parts[index].template
    half = 0.5 * evidence.extents_unit
    unit = (
        np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
        if template is None or not len(template.points_unit)
        else template.points_unit * (evidence.extents_unit / template.extents_unit)
    )
    return apply(evidence.T_camera_part, evidence.scale_m * unit)


def prior_as_named(category: Category, prior: Prior, labelled: LabelledPoints) -> Prior:
    """`prior` in the words of `labelled`: where the category's parts may take each other's place, that one of the two
    descriptions by which more of the points lie on the surface of the part they are said to be of."""
    if category.interchange is None:
        return prior
    renaming = interchanged(category)
    owner = _owners(prior, labelled.points_camera)
    own, other = (
        sum(int(np.count_nonzero(owner[rows] == k)) for k, rows in zip(order, labelled.members, strict=True))
        for order in (range(len(prior.parts)), renaming.order)
    )
    return _renamed(prior, category, renaming) if other > own else prior


def _owners(prior: Prior, points_camera: NDArray[np.float32]) -> NDArray[np.intp]:
    """(N,) of each point the part whose expected surface is nearest."""
    placed = [np.empty((0, 3), np.float32) if part is None else part.surface_camera for part in prior.parts]
    surface, owner = np.concatenate(placed), np.repeat(np.arange(len(placed)), [len(points) for points in placed])
    if not len(surface):
        return np.full(len(points_camera), -1)
    middle = surface.mean(axis=0)
    return owner[nearest(points_camera - middle, surface - middle, 1)[:, 0]]


def _renamed(prior: Prior, category: Category, renaming: Renaming) -> Prior:
    parts: list[PartPrior | None] = []
    turns = zip(renaming.turns, renaming.box_turns, strict=True)
    for spec, other, (turn, box_turn) in zip(category.parts, renaming.order, turns, strict=True):
        part = prior.parts[other]
        if part is None:
            parts.append(None)
            continue
        evidence = replace(
            part.evidence,
            T_camera_part=part.evidence.T_camera_part @ transform_from(turn, np.zeros(3)),
            extents_unit=turned_extents(part.evidence.extents_unit, box_turn),
        )
        surface = replace(part.surface, points=(part.surface.points @ turn).astype(np.float32))
        parts.append(PartPrior(evidence, turned_part(part.last, spec, turn, box_turn), surface))
    return replace(prior, parts=tuple(parts))


def surfaces_of(
    pose: ArticulatedPose, labelled: LabelledPoints, colors: NDArray[np.uint8]
) -> tuple[list[Surface | None], NDArray[np.float32]]:
    """The surface of every part that has a pose, and the points (m,3) m that are of none. colors: (N,3) of the labelled
    points."""
    surfaces: list[Surface | None] = []
    for part, own in zip(pose.parts, labelled.members, strict=True):
        if isinstance(part, PartPose):
            points = apply(invert(part.T_camera_part), labelled.points_camera[own])
            surfaces.append(Surface(points.astype(np.float32), colors[own]))
        else:
            surfaces.append(None)
    return surfaces, np.delete(labelled.points_camera, np.concatenate(labelled.members), axis=0)
