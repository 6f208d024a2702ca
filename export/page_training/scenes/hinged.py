"""What all categories of a base and a lid on one hinge share.

Axes: +x runs along the hinge, to the right for a user sitting in front of the opening; +y from the front edge, where
the object opens, to the hinge; +z up when closed. State 0 is closed. A state q turns the lid by q about -x, so that its
front edge rises.
"""

from __future__ import annotations

from collections.abc import Sequence

from page_training.categories import CATEGORIES
from page_training.scenes.articulated import ArticulatedObject, articulated_object
from page_training.scenes.meshes import Mesh, joined

PART_NAMES = ("base", "lid")
BASE, LID = 0, 1


def hinged_object(
    base: Sequence[Mesh], lid: Sequence[Mesh], hinge: tuple[float, float, float], loose: Sequence[Mesh] = ()
) -> ArticulatedObject:
    """Assemble meshes that stand closed in one frame (axes as the canonical ones) about a hinge point
    (x,y,z) metres; loose: things lying in the base."""
    things = ((BASE, joined(loose)),) if loose else ()
    return articulated_object(CATEGORIES["box"].joints, (base, lid), (hinge,), loose=things)
