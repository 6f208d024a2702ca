"""Category "arm": robot arms of seven links in a chain, from desk kits to industrial ones, with a gripper.

Assembled at state 0 the arm stands straight up like a candle, its front to -y. What hangs on one side of a link,
motors, covers, cables, hangs on its back (+y), as on most real ones: by that a half turn about its axis is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from page_runtime.boxes import box_corners
from page_training.categories import CATEGORIES
from page_training.scenes.articulated import ArticulatedObject, States, articulated_object, seen_from
from page_training.scenes.fittings import gray, metal
from page_training.scenes.materials import Material, hsv_color, plain, printed, random_color
from page_training.scenes.meshes import Mesh, revolved, shifted
from page_training.scenes.resting import Rest, turned_rest, upright_rest
from page_training.scenes.shapes import block, rod, tube
from page_training.scenes.textures import Generator

STATE_TRIES = 40


def distance_m(model: ArticulatedObject) -> tuple[float, float]:
    return seen_from(model, 0.9, 2.8)


def on_table(model: ArticulatedObject) -> float:
    return 0.85 if model.diagonal_m < 0.8 else 0.5


def rest(rng: Generator) -> Rest:
    """Standing, now and then hanging from above."""
    return upright_rest(rng) if rng.random() < 0.93 else turned_rest((1.0, 0.0, 0.0), np.pi, rng)


def sample_states(rng: Generator, model: ArticulatedObject) -> States:
    """Angles of the six joints, rad, of which no link goes through the floor or the base."""
    low, high = np.array([joint.limits for joint in model.joints]).T
    states = np.zeros(6)
    for _ in range(STATE_TRIES):
        states = rng.uniform(low, high)
        # Mostly reaching forwards and down, as at work.
        states[1] = rng.uniform(-0.3, 1.3) if rng.random() < 0.8 else states[1]
        states[2] = rng.uniform(0.1, 2.2) if rng.random() < 0.8 else states[2]
        states = np.clip(states, low, high)
        if rng.random() < 0.3:
            states[3] *= 0.15
        if _is_free(model, tuple(states)):
            return tuple(float(state) for state in states)
    return (float(states[0]), 0.3, 0.9, float(states[3]), 0.5, float(states[5]))


def _is_free(model: ArticulatedObject, states: States) -> bool:
    """Whether forearm, wrist and hand stay above the base's foot and out of the column."""
    poses = model.poses(np.eye(4), states)
    foot = -model.parts[0].extents_m[2] / 2
    column = 0.5 * max(model.parts[0].extents_m[:2])
    for pose, part in list(zip(poses, model.parts, strict=True))[2:]:
        if box_corners(pose, part.extents_m)[:, 2].min() < foot:
            return False
    for pose in poses[4:]:
        reach = float(np.linalg.norm(pose[:2, 3]))
        if reach < column and pose[2, 3] < model.parts[0].extents_m[2]:
            return False
    return True


@dataclass(frozen=True, eq=False, slots=True)
class _Chain:
    """Metres. heights: of base top, shoulder axis, elbow axis, forearm's roll, wrist axis, flange, finger tips;
    shoulder_y, forearm_y: of the shoulder axis and of the forearm against the column; girth: of the links at shoulder,
    elbow and wrist."""

    heights: tuple[float, float, float, float, float, float, float]
    shoulder_y: float
    forearm_y: float
    girth: tuple[float, float, float]


@dataclass(frozen=True, eq=False, slots=True)
class _Look:
    """Surfaces, and how links are built between two points: a housing of a girth from one height to another."""

    main: Material
    second: Material
    joint: Material
    dark: Material
    steel: Material
    link: Callable[[float, float, float, float, float, Material], list[Mesh]]
    round_joints: bool
    cover: float


def _chain(rng: Generator) -> _Chain:
    reach = float(np.exp(rng.uniform(np.log(0.22), np.log(1.25))))
    upper = reach * float(rng.uniform(0.36, 0.5))
    fore = reach * float(rng.uniform(0.3, 0.46))
    girth = reach * float(rng.uniform(0.08, 0.2))
    base = girth * float(rng.uniform(0.4, 1.5))
    shoulder = base + girth * float(rng.uniform(0.8, 1.8))
    elbow = shoulder + upper
    roll = elbow + fore * float(rng.uniform(0.15, 0.5))
    wrist = elbow + fore
    flange = wrist + reach * float(rng.uniform(0.06, 0.12))
    tips = flange + reach * float(rng.uniform(0.1, 0.22))
    slim = float(rng.uniform(0.55, 0.95))
    return _Chain(
        (base, shoulder, elbow, roll, wrist, flange, tips),
        shoulder_y=-girth * float(rng.choice([0.0, rng.uniform(0.0, 1.0)])),
        forearm_y=-girth * float(rng.choice([0.0, rng.uniform(0.0, 0.7)])),
        girth=(girth, girth * slim, girth * slim * float(rng.uniform(0.5, 0.9))),
    )


def _round_link(y: float, low: float, high: float, wide: float, wide_high: float, skin: Material) -> list[Mesh]:
    return [
        shifted(
            revolved([(wide / 2, low), (wide / 2 * 0.98, low * 0.7 + high * 0.3), (wide_high / 2, high)], skin, 20),
            0,
            y,
            0,
        )
    ]


def _square_link(y: float, low: float, high: float, wide: float, wide_high: float, skin: Material) -> list[Mesh]:
    path = np.array([[0, y, low], [0, y, low + 0.25 * (high - low)], [0, y, high]])
    sizes = np.array([wide, 0.95 * wide, wide_high])
    return [tube(path, np.array([0.0, 1.0, 0.0]), sizes, sizes * 0.8, skin, corner=0.25, steps=12)]


def _plate_link(y: float, low: float, high: float, wide: float, wide_high: float, skin: Material) -> list[Mesh]:
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


def _look(rng: Generator) -> _Look:
    draw = rng.random()
    if draw < 0.3:
        main = plain(rng, gray(rng, 0.7, 1.0), contrast=0.03)
    elif draw < 0.5:  # orange, yellow
        main = plain(rng, hsv_color(rng.uniform(0.03, 0.15), rng.uniform(0.7, 1.0), rng.uniform(0.6, 1.0)))
    elif draw < 0.65:
        main = plain(rng, gray(rng, 0.02, 0.5))
    elif draw < 0.75:
        main = metal(rng)
    else:
        main = plain(rng, random_color(rng))
    second = (
        main if rng.random() < 0.6 else plain(rng, random_color(rng) if rng.random() < 0.5 else gray(rng, 0.02, 0.9))
    )
    joint = (
        main if rng.random() < 0.35 else plain(rng, gray(rng, 0.02, 0.9) if rng.random() < 0.6 else random_color(rng))
    )
    kind = rng.random()
    link = _round_link if kind < 0.45 else _square_link if kind < 0.8 else _plate_link
    return _Look(
        main=main,
        second=second,
        joint=joint,
        dark=plain(rng, gray(rng, 0.02, 0.2)),
        steel=metal(rng),
        link=link,
        round_joints=bool(rng.random() < 0.8),
        cover=float(rng.uniform(0.25, 0.7)),
    )


def _joint_housing(look: _Look, y: float, z: float, wide: float, size: float, skin: Material) -> list[Mesh]:
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


def _back(rng: Generator, look: _Look, y: float, low: float, high: float, wide: float) -> list[Mesh]:
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


def _base(rng: Generator, look: _Look, chain: _Chain) -> list[Mesh]:
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


def _shoulder(rng: Generator, look: _Look, chain: _Chain) -> list[Mesh]:
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


def _upper(rng: Generator, look: _Look, chain: _Chain) -> list[Mesh]:
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


def _forearm(rng: Generator, look: _Look, chain: _Chain) -> list[Mesh]:
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


def _wrist(rng: Generator, look: _Look, chain: _Chain) -> list[Mesh]:
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


def _knuckle(rng: Generator, look: _Look, chain: _Chain) -> list[Mesh]:
    """The wrist that pitches, up to the flange."""
    three, low, high = chain.girth[2], chain.heights[4], chain.heights[5]
    y = chain.shoulder_y + chain.forearm_y
    meshes = _joint_housing(look, y, low, 0.58 * three, 0.62 * three, look.joint)
    meshes.append(shifted(revolved([(0.27 * three, low), (0.3 * three, high)], look.second, 18), 0, y, 0))
    meshes += _back(rng, look, y, low, high, 0.6 * three)
    return meshes


def _hand(rng: Generator, look: _Look, chain: _Chain) -> list[Mesh]:
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


def sample_object(rng: Generator) -> ArticulatedObject:
    """A random arm, standing straight up."""
    chain, look = _chain(rng), _look(rng)
    parts = [make(rng, look, chain) for make in (_base, _shoulder, _upper, _forearm, _wrist, _knuckle, _hand)]
    base, shoulder, elbow, roll, wrist, flange, _ = chain.heights
    y, forearm_y = chain.shoulder_y, chain.shoulder_y + chain.forearm_y
    points = [
        (0.0, 0.0, base),
        (0.0, y, shoulder),
        (0.0, y, elbow),
        (0.0, forearm_y, roll),
        (0.0, forearm_y, wrist),
        (0.0, forearm_y, flange),
    ]
    return articulated_object(CATEGORIES["arm"].joints, parts, points)
