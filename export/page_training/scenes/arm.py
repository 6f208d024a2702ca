"""Category "arm": robot arms of seven links in a chain, from desk kits to industrial ones, with a gripper.

Assembled at state 0 the arm stands straight up like a candle, its front to -y.
"""

from __future__ import annotations

import numpy as np

from page_runtime.boxes import box_corners
from page_training.categories import CATEGORIES
from page_training.scenes.arm_links import LINKS, Chain, Look, plate_link, round_link, square_link
from page_training.scenes.articulated import ArticulatedObject, States, articulated_object, seen_from
from page_training.scenes.fittings import gray, metal
from page_training.scenes.materials import hsv_color, plain, random_color
from page_training.scenes.resting import Rest, turned_rest, upright_rest
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


def _chain(rng: Generator) -> Chain:
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
    return Chain(
        (base, shoulder, elbow, roll, wrist, flange, tips),
        shoulder_y=-girth * float(rng.choice([0.0, rng.uniform(0.0, 1.0)])),
        forearm_y=-girth * float(rng.choice([0.0, rng.uniform(0.0, 0.7)])),
        girth=(girth, girth * slim, girth * slim * float(rng.uniform(0.5, 0.9))),
    )


def _look(rng: Generator) -> Look:
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
    link = round_link if kind < 0.45 else square_link if kind < 0.8 else plate_link
    return Look(
        main=main,
        second=second,
        joint=joint,
        dark=plain(rng, gray(rng, 0.02, 0.2)),
        steel=metal(rng),
        link=link,
        round_joints=bool(rng.random() < 0.8),
        cover=float(rng.uniform(0.25, 0.7)),
    )


def sample_object(rng: Generator) -> ArticulatedObject:
    """A random arm, standing straight up."""
    chain, look = _chain(rng), _look(rng)
    parts = [make(rng, look, chain) for make in LINKS]
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
