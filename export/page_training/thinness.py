"""Which categories have objects so thin that points are taken again where a first look saw them (`Category.focused`).

A part of a laptop or a drawer fills a tenth and more of the square around the object, a cutter's blade a twentieth, an
eyeglasses' temple a thirtieth: of the network's points too few are then on it to tell its pose.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from page_runtime.geometry import Array, apply
from page_runtime.sampling import REGION_MARGIN
from page_training.scenes.articulated import ArticulatedObject, States
from page_training.templates import surface_samples

# Of the square around an object, on average. The least parts of scissors, which gain nothing by a second look, have
# 0.073, those of cutters 0.055, of eyeglasses 0.04; the guide's door and what else there is have 0.1 and more.
THIN_BELOW = 0.064
# The square in so many cells; a part fills those in which one of so many of its points is.
_GRID, _POINTS = 64, 4000


def are_thin(objects: Sequence[tuple[ArticulatedObject, States]], rng: np.random.Generator) -> bool:
    """Whether a part of these objects, in these joint states and from a random side each, fills too little of their
    regions."""
    return float(np.mean([part_shares(model, states, rng) for model, states in objects], axis=0).min()) < THIN_BELOW


def part_shares(model: ArticulatedObject, states: States, rng: np.random.Generator) -> Array:
    """(K,) of the square around the object, seen from a random side, what each part fills; nothing hides it."""
    view, _ = np.linalg.qr(rng.normal(size=(3, 2)))
    poses = model.poses(np.eye(4), states)
    shadows = [
        apply(T, surface_samples(part.mesh, rng, _POINTS)[0]) @ view for part, T in zip(model.parts, poses, strict=True)
    ]
    everything = np.concatenate(shadows)
    low, high = everything.min(axis=0), everything.max(axis=0)
    side = (1.0 + 2.0 * REGION_MARGIN) * float((high - low).max())
    corner = (low + high - side) / 2
    cells = [np.floor((one - corner) * (_GRID / side)).astype(np.intp) @ np.array([1, _GRID]) for one in shadows]
    return np.array([len(np.unique(one)) / _GRID**2 for one in cells])
