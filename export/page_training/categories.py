"""The runtime's description of each category the workshop can make scenes of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from page_runtime.category import Category, Joint, JointGeometry, Part
from page_runtime.symmetry import Interchange, Mirror, Symmetry
from page_training.keypoints import NUM_VOTED, off_surface_keypoints

Triple = tuple[float, float, float]

_HINGED_FRAME = (
    "origin: centre of the part's box; +x: along the hinge, to the right of a user in front of the opening; "
    "+y: from the opening edge towards the hinge; +z: {up}"
)


def _part(name: str, frame: str, extents: Triple, diagonal_range_m: tuple[float, float]) -> Part:
    return Part(
        name=name,
        frame=frame,
        keypoints_unit=off_surface_keypoints(),
        extents_unit=np.array(extents) / np.linalg.norm(extents),
        diagonal_range_m=diagonal_range_m,
    )


def _hinged(
    name: str,
    region_radius_m: float,
    base_extents: Triple,
    lid_extents: Triple,
    diagonal_range_m: tuple[float, float],
    lid_up: str,
    hinge: JointGeometry,
) -> Category:
    opening = Joint("hinge", 0, 1, "revolute", (-1.0, 0.0, 0.0), (0.0, float(np.radians(200.0))), hinge)
    return Category(
        name=name,
        parts=(
            _part("base", _HINGED_FRAME.format(up="up, away from the table"), base_extents, diagonal_range_m),
            _part("lid", _HINGED_FRAME.format(up=lid_up), lid_extents, diagonal_range_m),
        ),
        joints=(opening,),
        num_voted=NUM_VOTED,
        region_radius_m=region_radius_m,
    )


def _drawer() -> Category:
    """Body and three drawers, which slide out towards the user."""
    frame = (
        "origin: centre of the part's box; +x: to the right of a user in front of the drawers; "
        "+y: from the front to the back; +z: up"
    )
    names = ("top", "middle", "bottom")
    places = (
        JointGeometry(
            (0.0, -0.484, 0.324), (0.0, -0.406, 0.0), (0.026, 0.014, 0.037), (0.003, 0.045, 0.003), -0.428, 0.163
        ),
        JointGeometry(
            (0.0, -0.484, 0.04), (0.0, -0.406, 0.0), (0.026, 0.014, 0.043), (0.003, 0.045, 0.003), -0.423, 0.158
        ),
        JointGeometry(
            (0.0, -0.484, -0.259), (0.0, -0.406, 0.0), (0.026, 0.014, 0.05), (0.003, 0.045, 0.003), -0.418, 0.155
        ),
    )
    return Category(
        name="drawer",
        parts=(
            _part("body", frame, (0.539, 0.499, 0.678), (0.13, 1.97)),
            *(_part(f"{name} drawer", frame, (0.7, 0.654, 0.29), (0.08, 1.5)) for name in names),
        ),
        joints=tuple(
            Joint(f"{name} slide", 0, k, "prismatic", (0.0, -1.0, 0.0), (0.0, 0.6), place)
            for k, (name, place) in enumerate(zip(names, places, strict=True), 1)
        ),
        num_voted=NUM_VOTED,
        region_radius_m=0.95,
    )


def _scissors() -> Category:
    """Two blades; a half turn about y makes each of them the other."""
    frame = (
        "origin: centre of the part's box; +y: from the handles to the tips of the closed scissors; +z: out of their "
        "face, so that the {name} blade's tip opens to the {side}; +x: to the right, seen from +z with the tips up"
    )
    place = JointGeometry(
        (0.32, 0.049, 0.0), (-0.32, 0.049, 0.0), (0.021, 0.083, 0.004), (0.021, 0.082, 0.004), 0.0, 0.018
    )
    return Category(
        name="scissors",
        parts=(
            _part("first blade", frame.format(name="first", side="right"), (0.293, 0.955, 0.052), (0.07, 0.42)),
            _part("second blade", frame.format(name="second", side="left"), (0.293, 0.955, 0.052), (0.07, 0.42)),
        ),
        joints=(Joint("pivot", 0, 1, "revolute", (0.0, 0.0, 1.0), (0.0, float(np.radians(115.0))), place),),
        num_voted=NUM_VOTED,
        region_radius_m=0.3,
        # Left-handed scissors are right-handed ones with the other blade on top.
        mirror=Mirror(axis=2),
        interchange=Interchange(parts=(1, 0), axis=(0.0, 1.0, 0.0)),
    )


def _eyeglasses() -> Category:
    """Front and two temples, each the other's mirror image."""
    frame = (
        "origin: centre of the part's box; +y: from the front backwards, as the temples point when they are open; "
        "+z: up, as worn; +x: to the wearer's left"
    )
    limits = (-0.3, 1.8)
    left, right = (
        JointGeometry(
            (sign * 0.48, 0.448, 0.214), (sign * 0.33, -0.492, 0.327), (0.012, 0.01, 0.033), (0.008, 0.005, 0.032),
            -0.148, 0.101,
        )
        for sign in (1.0, -1.0)
    )  # fmt: skip
    return Category(
        name="eyeglasses",
        parts=(
            _part("front", frame, (0.954, 0.137, 0.267), (0.07, 0.26)),
            _part("left temple", frame, (0.078, 0.964, 0.255), (0.06, 0.24)),
            _part("right temple", frame, (0.078, 0.964, 0.255), (0.06, 0.24)),
        ),
        joints=(
            Joint("left hinge", 0, 1, "revolute", (0.0, 0.0, 1.0), limits, left),
            Joint("right hinge", 0, 2, "revolute", (0.0, 0.0, -1.0), limits, right),
        ),
        num_voted=NUM_VOTED,
        region_radius_m=0.2,
        mirror=Mirror(parts=(0, 2, 1)),
        focused=True,
    )


def _dishwasher() -> Category:
    """Housing and the door, which opens downwards."""
    frame = (
        "origin: centre of the part's box; +x: along the hinge, to the right of a user in front of the door; "
        "+y: from the front to the back, for the door when closed; +z: up, for the door when closed"
    )
    place = JointGeometry(
        (0.0, -0.493, -0.406), (0.0, 0.153, -0.475), (0.003, 0.023, 0.033), (0.003, 0.018, 0.015), -0.275, 0.08
    )
    return Category(
        name="dishwasher",
        parts=(
            _part("housing", frame, (0.51, 0.534, 0.674), (0.1, 1.9)),
            _part("door", frame, (0.654, 0.106, 0.749), (0.08, 1.55)),
        ),
        joints=(Joint("hinge", 0, 1, "revolute", (1.0, 0.0, 0.0), (0.0, float(np.radians(100.0))), place),),
        num_voted=NUM_VOTED,
        region_radius_m=1.0,
    )


def _stapler() -> Category:
    """Base and arm; state 0 is the arm parallel to the base."""
    frame = _HINGED_FRAME.replace("the opening", "the nose").replace("opening edge", "nose")
    place = JointGeometry(
        (0.0, 0.418, 0.32), (0.0, 0.442, -0.113), (0.003, 0.029, 0.013), (0.003, 0.021, 0.037), -0.084, 0.068
    )
    return Category(
        name="stapler",
        parts=(
            _part("base", frame.format(up="up, from the base to the arm"), (0.231, 0.949, 0.216), (0.035, 0.52)),
            _part("arm", frame.format(up="from the staples to the top of the arm"), (0.19, 0.961, 0.19), (0.035, 0.48)),
        ),
        joints=(Joint("hinge", 0, 1, "revolute", (-1.0, 0.0, 0.0), (0.0, float(np.radians(200.0))), place),),
        num_voted=NUM_VOTED,
        region_radius_m=0.4,
    )


def _cutter() -> Category:
    """Handle and the blade with its slider; state 0 is the blade drawn in."""
    frame = (
        "origin: centre of the part's box; +y: along the handle, the way the blade comes out; "
        "+z: out of the side on which the slider is; +x: to the right, seen from +z with the blade's tip up"
    )
    place = JointGeometry(
        (0.0, 0.474, 0.0), (0.0, 0.511, -0.364), (0.003, 0.028, 0.003), (0.003, 0.003, 0.025), -0.399, 0.106
    )
    return Category(
        name="cutter",
        parts=(
            _part("handle", frame, (0.173, 0.972, 0.157), (0.06, 0.28)),
            _part("blade", frame, (0.137, 0.972, 0.19), (0.035, 0.22)),
        ),
        joints=(Joint("slide", 0, 1, "prismatic", (0.0, 1.0, 0.0), (0.0, 0.12), place),),
        num_voted=NUM_VOTED,
        region_radius_m=0.3,
        focused=True,
    )


def _arm() -> Category:
    """A chain of seven links; at state 0 it stands straight up, its front towards -y."""
    frame = (
        "origin: centre of the part's box; of the arm stretched straight up (all joints at 0): +z: up along the chain; "
        "+y: to the back, where the base has its connectors; +x: to the right of a user before its front"
    )
    yaw, pitch = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    joints = (
        ("base yaw", yaw, 3.1, JointGeometry(
            (0.0, -0.065, 0.5), (0.0, -0.072, -0.501), (0.003, 0.035, 0.003), (0.003, 0.055, 0.003), -0.116, 0.166)),
        ("shoulder pitch", pitch, 1.9, JointGeometry(
            (0.0, -0.204, 0.324), (0.0, -0.056, -0.397), (0.003, 0.061, 0.033), (0.003, 0.011, 0.021), 0.522, 0.229)),
        ("elbow pitch", pitch, 2.6, JointGeometry(
            (0.0, -0.056, 0.419), (0.0, -0.045, -0.238), (0.003, 0.011, 0.021), (0.003, 0.066, 0.064), -0.893, 0.205)),
        ("forearm roll", yaw, 3.1, JointGeometry(
            (0.0, -0.21, 0.5), (0.0, -0.113, -0.501), (0.003, 0.046, 0.004), (0.003, 0.016, 0.003), 0.277, 0.279)),
        ("wrist pitch", pitch, 2.1, JointGeometry(
            (0.0, -0.113, 0.421), (0.0, -0.131, -0.303), (0.003, 0.016, 0.026), (0.003, 0.015, 0.05), -0.793, 0.208)),
        ("hand roll", yaw, 3.1, JointGeometry(
            (0.0, -0.131, 0.5), (0.0, 0.0, -0.501), (0.003, 0.015, 0.003), (0.003, 0.003, 0.003), 0.347, 0.207)),
    )  # fmt: skip
    parts = (
        ("base", (0.614, 0.709, 0.348), (0.03, 1.1)),
        ("shoulder", (0.433, 0.639, 0.636), (0.025, 0.85)),
        ("upper arm", (0.199, 0.221, 0.955), (0.07, 1.15)),
        ("forearm", (0.352, 0.596, 0.721), (0.018, 0.62)),
        ("wrist", (0.251, 0.26, 0.932), (0.035, 0.7)),
        ("knuckle", (0.339, 0.435, 0.834), (0.015, 0.32)),
        ("hand", (0.483, 0.261, 0.836), (0.018, 0.46)),
    )
    described = tuple(_part(name, frame, extents, diagonals) for name, extents, diagonals in parts)
    hand = replace(described[-1], symmetry=Symmetry(axis=yaw, fold=2))
    return Category(
        name="arm",
        parts=(*described[:-1], hand),
        joints=tuple(
            Joint(name, k, k + 1, "revolute", axis, (-limit, limit), place)
            for k, (name, axis, limit, place) in enumerate(joints)
        ),
        num_voted=NUM_VOTED,
        region_radius_m=1.1,
        focused=True,
    )


# Sizes and where the joints are: mean and spread over instances of the scenes, at least 3 mm a metre.
CATEGORIES: dict[str, Category] = {
    "arm": _arm(),
    "box": _hinged(
        "box", 0.42, (0.225, 0.095, 0.035), (0.225, 0.095, 0.012), (0.09, 0.55),
        "outwards: up when closed, away from the box's inside when open",
        JointGeometry(
            (0.0, 0.474, 0.438), (0.0, 0.478, -0.015), (0.003, 0.008, 0.017), (0.026, 0.010, 0.014), -0.037, 0.06
        ),
    ),
    "laptop": _hinged(
        "laptop", 0.60, (0.34, 0.24, 0.02), (0.34, 0.235, 0.008), (0.20, 0.75),
        "out of the back of the screen: up when closed; the user looks along it into the screen",
        JointGeometry(
            (0.0, 0.472, 0.474), (0.0, 0.484, -0.054), (0.003, 0.008, 0.009), (0.003, 0.010, 0.005), -0.017, 0.01
        ),
    ),
    "cutter": _cutter(),
    "dishwasher": _dishwasher(),
    "drawer": _drawer(),
    "eyeglasses": _eyeglasses(),
    "scissors": _scissors(),
    "stapler": _stapler(),
}  # fmt: skip


BUILT_IN = frozenset(CATEGORIES)
# Those of `page-train from-urdf`, a folder each.
OWN_CATEGORIES = Path("export/categories")


def own_folder(name: str) -> Path:
    """Where a category of the user's own lives, below the working directory."""
    return OWN_CATEGORIES / name


def known_categories() -> list[str]:
    """The names of all categories there are, the user's own included."""
    own = [path.parent.name for path in OWN_CATEGORIES.glob("*/category.json")]
    return sorted({*CATEGORIES, *own})


def category_named(name: str) -> Category:
    """The category, or a ValueError that lists those there are."""
    if name in CATEGORIES:
        return CATEGORIES[name]
    if name not in known_categories():
        raise ValueError(f"category: expected one of {', '.join(known_categories())}, got {name!r}")
    from page_training.own.files import read_own

    return read_own(own_folder(name)).category
