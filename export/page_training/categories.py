"""The runtime's description of each category the workshop can make scenes of."""

from __future__ import annotations

import numpy as np

from page_runtime.category import Category, Joint, JointGeometry, Part
from page_training.keypoints import NUM_VOTED, off_surface_keypoints

_HINGED_FRAME = (
    "origin: centre of the part's box; +x: along the hinge, to the right of a user in front of the opening; "
    "+y: from the opening edge towards the hinge; +z: {up}"
)


def _opening(geometry: JointGeometry) -> Joint:
    return Joint(
        name="hinge",
        parent=0,
        child=1,
        kind="revolute",
        axis=(-1.0, 0.0, 0.0),
        limits=(0.0, float(np.radians(200.0))),
        geometry=geometry,
    )


def _hinged(
    name: str,
    region_radius_m: float,
    base_extents: tuple[float, float, float],
    lid_extents: tuple[float, float, float],
    diagonal_range_m: tuple[float, float],
    lid_up: str,
    hinge: JointGeometry,
) -> Category:
    def part(part_name: str, extents: tuple[float, float, float], up: str) -> Part:
        return Part(
            name=part_name,
            frame=_HINGED_FRAME.format(up=up),
            keypoints_unit=off_surface_keypoints(),
            extents_unit=np.array(extents) / np.linalg.norm(extents),
            diagonal_range_m=diagonal_range_m,
        )

    return Category(
        name=name,
        parts=(
            part("base", base_extents, "up, away from the table"),
            part("lid", lid_extents, lid_up),
        ),
        joints=(_opening(hinge),),
        num_voted=NUM_VOTED,
        region_radius_m=region_radius_m,
    )


# Where the hinges are: mean and spread over instances of the scenes, at least 3 mm a metre.
CATEGORIES: dict[str, Category] = {
    "box": _hinged(
        "box", 0.42, (0.225, 0.095, 0.035), (0.225, 0.095, 0.012), (0.09, 0.55),
        "outwards: up when closed, away from the box's inside when open",
        JointGeometry(
            (0.0, 0.477, 0.523), (0.0, 0.479, 0.011), (0.003, 0.008, 0.016), (0.028, 0.010, 0.015), -0.037, 0.06
        ),
    ),
    "laptop": _hinged(
        "laptop", 0.60, (0.34, 0.24, 0.02), (0.34, 0.235, 0.008), (0.20, 0.75),
        "out of the back of the screen: up when closed; the user looks along it into the screen",
        JointGeometry(
            (0.0, 0.472, 0.474), (0.0, 0.484, -0.054), (0.003, 0.008, 0.009), (0.003, 0.010, 0.005), -0.017, 0.01
        ),
    ),
}  # fmt: skip


def category_named(name: str) -> Category:
    """The category, or a ValueError that lists those there are."""
    if name not in CATEGORIES:
        raise ValueError(f"category: expected one of {', '.join(sorted(CATEGORIES))}, got {name!r}")
    return CATEGORIES[name]
