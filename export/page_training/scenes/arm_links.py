"""The links of robot arms.

What hangs on one side of a link, motors, covers, cables, hangs on its back (+y), as on most real ones: by that a half
turn about its axis is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from page_training.scenes.materials import Material, printed, random_color
from page_training.scenes.meshes import Mesh, revolved, shifted
from page_training.scenes.shapes import block, rod, tube
from page_training.scenes.textures import Generator


@dataclass(frozen=True, eq=False, slots=True)
class Chain:
    """Metres. heights: of base top, shoulder axis, elbow axis, forearm's roll, wrist axis, flange, finger tips;
    shoulder_y, forearm_y: of the shoulder axis and of the forearm against the column; girth: of the links at shoulder,
    elbow and wrist."""

    heights: tuple[float, float, float, float, float, float, float]
    shoulder_y: float
    forearm_y: float
    girth: tuple[float, float, float]


@dataclass(frozen=True, eq=False, slots=True)
class Look:
    """Surfaces, and how links are built between two points: a housing of a girth from one height to another."""

    main: Material
    second: Material
    joint: Material
    dark: Material
    steel: Material
    link: Callable[[float, float, float, float, float, Material], list[Mesh]]
    round_joints: bool
    cover: float


def round_link(y: float, low: float, high: float, wide: float, wide_high: float, skin: Material) -> list[Mesh]:
    return [
        shifted(
            revolved([(wide / 2, low), (wide / 2 * 0.98, low * 0.7 + high * 0.3), (wide_high / 2, high)], skin, 20),
            0,
            y,
            0,
        )
    ]


def square_link(y: float, low: float, high: float, wide: float, wide_high: float, skin: Material) -> list[Mesh]:
    path = np.array([[0, y, low], [0, y, low + 0.25 * (high - low)], [0, y, high]])
    sizes = np.array([wide, 0.95 * wide, wide_high])
    return [tube(path, np.array([0.0, 1.0, 0.0]), sizes, sizes * 0.8, skin, corner=0.25, steps=12)]


def plate_link(y: float, low: float, high: float, wide: float, wide_high: float, skin: Material) -> list[Mesh]:
    """Two plates side by side with spacers between them, as kits have."""
    half, thick = 0.42 * min(wide, wide_high), 0.06 * wide
    meshes = [
        block(
            (side * half - thick / 2, y - 0.3 * wide, low),
            (side * half + thick / 2, y + 0.3 * wide, high),
            skin,
            0.3 * thick,
        )
        for side in (-1, 1)
    ]
    for share in (0.15, 0.5, 0.85):
        z = low + share * (high - low)
        meshes.append(rod(np.array([-half, y, z]), np.array([half, y, z]), 0.06 * wide, skin, 8))
    return meshes


def _joint_housing(look: Look, y: float, z: float, wide: float, size: float, skin: Material) -> list[Mesh]:
    """A drum across x about a pitch axis, with caps of another colour."""
    half = wide / 2
    if not look.round_joints:
        side = 0.45 * size
        return [block((-half, y - side, z - side), (half, y + side, z + side), skin, 0.08 * size)]
    drum = rod(np.array([-half, y, z]), np.array([half, y, z]), size / 2, skin, 18)
    caps = [
        rod(np.array([side * half, y, z]), np.array([side * (half + 0.06 * size), y, z]), 0.42 * size, look.joint, 18)
        for side in (-1, 1)
    ]
    return [drum, *caps]


def _back(rng: Generator, look: Look, y: float, low: float, high: float, wide: float) -> list[Mesh]:
    """What hangs on the back of a link: a motor, a cover or a hose."""
    draw = rng.random()
    out = wide * look.cover
    middle = (low + high) / 2
    tall = max(high - low, 1e-3)
    skin = look.dark if rng.random() < 0.5 else look.second
    if draw < 0.45:
        w, h = 0.32 * wide, 0.3 * tall
        return [block((-w, y + 0.25 * wide, middle - h), (w, y + 0.4 * wide + out, middle + h), skin, 0.08 * w)]
    if draw < 0.8:
        radius = min(0.3 * wide, 0.4 * tall)
        end = np.array([0.0, y + 0.4 * wide + out, middle])
        return [rod(np.array([0.0, y, middle]), end, radius, skin, 14)]
    share = np.linspace(0, 1, 7)
    path = np.stack([0 * share, y + 0.4 * wide + out * np.sin(np.pi * share), low + tall * (0.1 + 0.8 * share)], axis=1)
    hose = tube(path, np.array([1.0, 0.0, 0.0]), 0.14 * wide, 0.14 * wide, look.dark, steps=7)
    return [
        hose,
        block(
            (-0.2 * wide, y, middle - 0.06 * tall), (0.2 * wide, y + 0.5 * wide + 0.8 * out, middle + 0.06 * tall), skin
        ),
    ]


def base_meshes(rng: Generator, look: Look, chain: Chain) -> list[Mesh]:
    girth, top = chain.girth[0], chain.heights[0]
    foot = girth * float(rng.uniform(0.6, 1.1))
    plate = min(0.25 * top, 0.02 + 0.1 * girth)
    meshes = [shifted(revolved([(0.62 * girth, 0), (0.5 * girth, top)], look.main, 24), 0, 0, 0)]
    if rng.random() < 0.7:
        meshes = [
            block((-foot, -foot, 0), (foot, foot, plate), look.second, 0.1 * plate),
            shifted(revolved([(0.6 * girth, 0), (0.5 * girth, top - plate)], look.main, 24), 0, 0, plate),
        ]
    else:
        meshes.append(revolved([(foot, 0), (foot, plate)], look.second, 24))
    # The connectors are at the back.
    w, h = 0.42 * girth, max(0.35 * top, plate)
    reach = 0.6 * girth + girth * float(rng.uniform(0.15, 0.7))
    meshes.append(block((-w, 0.2 * girth, 0), (w, reach, h), look.main if rng.random() < 0.6 else look.dark, 0.05 * w))
    for x in np.linspace(-0.5, 0.5, int(rng.integers(1, 4))):
        end = np.array([x * w, reach + 0.06 * girth, 0.5 * h])
        meshes.append(rod(np.array([x * w, reach - 0.01, 0.5 * h]), end, 0.15 * w, look.dark, 10))
    return meshes


def shoulder_meshes(rng: Generator, look: Look, chain: Chain) -> list[Mesh]:
    girth, low, axis = chain.girth[0], chain.heights[0], chain.heights[1]
    y = chain.shoulder_y
    meshes = [revolved([(0.52 * girth, low + 1e-4), (0.48 * girth, low + 0.35 * (axis - low))], look.joint, 24)]
    half = 0.5 * girth
    if rng.random() < 0.6:  # a fork
        thick = 0.16 * girth
        for side in (-1, 1):
            x = side * (half - thick / 2)
            meshes.append(
                block(
                    (x - thick / 2, min(y, 0) - 0.3 * girth, low + 0.2 * (axis - low)),
                    (x + thick / 2, 0.35 * girth, axis + 0.2 * girth),
                    look.main,
                    0.15 * thick,
                )
            )
    else:
        low_z = low + 0.2 * (axis - low)
        meshes.append(
            block(
                (-0.45 * girth, min(y, 0) - 0.3 * girth, low_z),
                (0.45 * girth, 0.4 * girth, axis),
                look.main,
                0.1 * girth,
            )
        )
        meshes += _joint_housing(look, y, axis, 0.8 * girth, 0.75 * girth, look.main)
    meshes += _back(rng, look, 0.0, low + 0.25 * (axis - low), axis, girth)
    return meshes


def upper_meshes(rng: Generator, look: Look, chain: Chain) -> list[Mesh]:
    one, two = chain.girth[0], chain.girth[1]
    low, high, y = chain.heights[1], chain.heights[2], chain.shoulder_y
    meshes = _joint_housing(look, y, low, 0.62 * one, 0.8 * one, look.joint)
    meshes += look.link(y, low, high, 0.75 * one, 0.75 * two, look.main)
    meshes += _joint_housing(look, y, high, 0.9 * two, 0.85 * two, look.main)
    meshes += _back(rng, look, y, low + 0.3 * (high - low), high - 0.25 * (high - low), 0.75 * two)
    if rng.random() < 0.4:
        w, h = 0.36 * two, 0.25 * (high - low)
        label = printed(rng, random_color(rng), (-0.3 * w, high, h, -2 * h))
        middle = (low + high) / 2
        for side in (-1, 1):
            x = side * 0.38 * one
            meshes.append(
                block((x - 1e-3, y - 0.2 * two, middle - h / 2), (x + 1e-3, y + 0.2 * two, middle + h / 2), label)
            )
    return meshes


def forearm_meshes(rng: Generator, look: Look, chain: Chain) -> list[Mesh]:
    two = chain.girth[1]
    low, high = chain.heights[2], chain.heights[3]
    y = chain.shoulder_y + chain.forearm_y
    meshes = _joint_housing(look, chain.shoulder_y, low, 0.66 * two, 0.8 * two, look.second)
    meshes.append(
        block(
            (-0.36 * two, min(y, chain.shoulder_y) - 0.3 * two, low),
            (0.36 * two, chain.shoulder_y + 0.35 * two, low + 0.6 * (high - low)),
            look.second,
            0.08 * two,
        )
    )
    meshes += look.link(y, low + 0.2 * (high - low), high, 0.78 * two, 0.7 * two, look.second)
    meshes += _back(rng, look, chain.shoulder_y, low, high, 0.8 * two)
    return meshes


def wrist_meshes(rng: Generator, look: Look, chain: Chain) -> list[Mesh]:
    """The forearm's end, which rolls."""
    two, three = chain.girth[1], chain.girth[2]
    low, high = chain.heights[3], chain.heights[4]
    y = chain.shoulder_y + chain.forearm_y
    meshes = look.link(y, low + 1e-4, high - 0.3 * three, 0.66 * two, 0.8 * three, look.main)
    thick = 0.16 * three
    for side in (-1, 1):  # the fork that holds the wrist
        x = side * (0.5 * three - thick / 2)
        meshes.append(
            block(
                (x - thick / 2, y - 0.3 * three, high - 0.75 * three),
                (x + thick / 2, y + 0.3 * three, high + 0.3 * three),
                look.main,
                0.2 * thick,
            )
        )
    meshes.append(
        block(
            (-0.5 * three, y - 0.3 * three, high - 0.95 * three),
            (0.5 * three, y + 0.3 * three, high - 0.6 * three),
            look.main,
        )
    )
    meshes += _back(rng, look, y, low + 0.1 * (high - low), high - 0.4 * three, 0.75 * three)
    return meshes


def knuckle_meshes(rng: Generator, look: Look, chain: Chain) -> list[Mesh]:
    """The wrist that pitches, up to the flange."""
    three, low, high = chain.girth[2], chain.heights[4], chain.heights[5]
    y = chain.shoulder_y + chain.forearm_y
    meshes = _joint_housing(look, y, low, 0.58 * three, 0.62 * three, look.joint)
    meshes.append(shifted(revolved([(0.27 * three, low), (0.3 * three, high)], look.second, 18), 0, y, 0))
    meshes += _back(rng, look, y, low, high, 0.6 * three)
    return meshes


def hand_meshes(rng: Generator, look: Look, chain: Chain) -> list[Mesh]:
    """A gripper with two fingers or a bar with cups: the same after half a turn about its axis."""
    three, low, tip = chain.girth[2], chain.heights[5], chain.heights[6]
    y, tall = chain.shoulder_y + chain.forearm_y, tip - low
    meshes = [
        shifted(revolved([(0.34 * three, low + 1e-4), (0.32 * three, low + 0.12 * tall)], look.steel, 20), 0, y, 0)
    ]
    half, deep = float(rng.uniform(0.35, 0.9)) * three, float(rng.uniform(0.2, 0.36)) * three
    palm = low + tall * float(rng.uniform(0.4, 0.6))
    skin = look.dark if rng.random() < 0.5 else look.second
    if rng.random() < 0.65:
        meshes.append(block((-half, y - deep, low + 0.1 * tall), (half, y + deep, palm), skin, 0.2 * deep))
    else:
        path = np.array([[0, y, low + 0.1 * tall], [0, y, palm]])
        meshes.append(tube(path, np.array([0.0, 1.0, 0.0]), 2 * half, 2 * deep, skin, steps=16))
    if rng.random() < 0.85:
        opening = float(rng.uniform(0.05, 1.0)) * half
        thick, wide = float(rng.uniform(0.12, 0.3)) * half, float(rng.uniform(0.4, 1.0)) * deep
        finger_skin = look.steel if rng.random() < 0.5 else look.dark
        for side in (-1, 1):
            x = side * (opening + thick / 2)
            meshes.append(
                block(
                    (x - thick / 2, y - wide / 2, palm - 1e-3),
                    (x + thick / 2, y + wide / 2, tip),
                    finger_skin,
                    0.1 * thick,
                )
            )
            if rng.random() < 0.5:
                bent = sorted((side * opening, side * (opening + 0.6 * thick)))
                meshes.append(
                    block(
                        (bent[0], y - wide / 2, palm + 0.7 * (tip - palm)),
                        (bent[1], y + wide / 2, tip - 1e-4),
                        look.joint,
                    )
                )
    else:
        for side in (-1, 1):
            profile = [(0.06 * half, palm - 1e-3), (0.08 * half, 0.5 * (palm + tip)), (0.25 * half, tip)]
            meshes.append(shifted(revolved(profile, look.dark, 14), side * 0.7 * half, y, 0))
    return meshes


LINKS = (base_meshes, shoulder_meshes, upper_meshes, forearm_meshes, wrist_meshes, knuckle_meshes, hand_meshes)
