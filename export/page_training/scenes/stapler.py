"""Category "stapler": desk, hand and long-arm staplers; a base and an arm that turns up at the back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_runtime.geometry import Array
from page_training.categories import CATEGORIES
from page_training.scenes.articulated import ArticulatedObject, States, articulated_object, seen_from
from page_training.scenes.fittings import gray, metal
from page_training.scenes.materials import Material, plain, printed, random_color, vary
from page_training.scenes.meshes import Mesh, repeated, revolved, shifted
from page_training.scenes.resting import Rest, held_rest, turned_rest, upright_rest
from page_training.scenes.shapes import block, profile, rod, slab, turned, upright_to
from page_training.scenes.textures import Generator


def distance_m(model: ArticulatedObject) -> tuple[float, float]:
    return seen_from(model, 1.4, 4.6)


def rest(rng: Generator) -> Rest:
    """Standing, lying on a side, or held."""
    draw = rng.random()
    if draw < 0.7:
        return upright_rest(rng)
    return turned_rest((0.0, 1.0, 0.0), float(rng.choice([-1, 1])) * np.pi / 2, rng) if draw < 0.88 else held_rest(rng)


def sample_states(rng: Generator, model: ArticulatedObject) -> States:
    """How far the arm is turned up, rad: at rest, open for staples, or all the way round."""
    most = model.joints[0].limits[1]
    draw = rng.random()
    if draw < 0.45:
        return (float(abs(rng.normal(0, 0.03))),)
    return (min(most, float(rng.uniform(0.1, 1.0) if draw < 0.75 else rng.uniform(0.6, most))),)


@dataclass(frozen=True, eq=False, slots=True)
class _Body:
    """Metres. length: of the base, whose front is at y = -length / 2; width; base: its thickness; arm_length, from the
    hinge forwards; arm_width; low, tall: of the arm, its under side and its height at the back; hinge_y, hinge_z."""

    length: float
    width: float
    base: float
    arm_length: float
    arm_width: float
    low: float
    tall: float
    hinge_y: float
    hinge_z: float


def _sizes(rng: Generator) -> _Body:
    draw = rng.random()
    if draw < 0.7:
        length = float(rng.uniform(0.1, 0.2))
    else:
        length = float(rng.uniform(0.05, 0.1) if draw < 0.85 else rng.uniform(0.2, 0.33))
    width = length * float(rng.uniform(0.16, 0.32))
    base = length * float(rng.uniform(0.03, 0.1))
    tall = length * float(rng.uniform(0.14, 0.32))
    gap = length * float(rng.uniform(0.02, 0.07))
    low = base + gap
    hinge_y = length / 2 - length * float(rng.uniform(0.03, 0.14))
    return _Body(
        length=length,
        width=width,
        base=base,
        arm_length=(hinge_y + length / 2) * float(rng.uniform(0.86, 1.06)),
        arm_width=width * float(rng.uniform(0.55, 1.0)),
        low=low,
        tall=tall,
        hinge_y=hinge_y,
        hinge_z=low + tall * float(rng.uniform(0.05, 0.6)),
    )


def _base(rng: Generator, body: _Body, skin: Material, steel: Material) -> list[Mesh]:
    front, back, w = -body.length / 2, body.length / 2, body.width / 2
    waist = float(rng.uniform(0.7, 1.0))
    share = np.linspace(-1, 1, 9)
    right = np.stack([w * (1 - (1 - waist) * (1 - share**2)), share * body.length / 2], axis=1)
    if rng.random() < 0.6:  # rounded ends
        round_front = np.array(
            [[w * np.cos(a), front - 0.35 * w * np.sin(a)] for a in np.linspace(0.4, np.pi - 0.4, 6)]
        )
        outline = np.concatenate([right, right[::-1] * np.array([-1, 1]), round_front[::-1]])
    else:
        outline = np.concatenate([right, right[::-1] * np.array([-1, 1])])
    meshes = [slab(outline, 0.0, body.base, 0.25 * body.base, skin)]
    if rng.random() < 0.5:  # a rubber sole
        rubber = plain(rng, gray(rng, 0.02, 0.3))
        meshes.append(slab(outline * 0.94, -0.002, 0.002, 0.0005, rubber))
    anvil_y = body.hinge_y - body.arm_length * float(rng.uniform(0.88, 0.95))
    size = (0.6 * body.arm_width, 0.5 * body.arm_width)
    meshes.append(
        block(
            (-size[0] / 2, anvil_y - size[1] / 2, body.base - 1e-4),
            (size[0] / 2, anvil_y + size[1] / 2, body.base + 1.2e-3),
            steel,
        )
    )
    # Cheeks that carry the hinge.
    cheek = float(rng.uniform(0.06, 0.14)) * body.width
    room = 0.5 * body.arm_width * float(rng.choice([0.75, 1.02]))
    high = body.hinge_z + float(rng.uniform(0.02, 0.06)) * body.length
    deep = float(rng.uniform(0.06, 0.13)) * body.length
    low_y, high_y = body.hinge_y - deep, min(body.hinge_y + deep, back)
    shape = np.array(
        [
            [low_y - 0.6 * deep, 0.8 * body.base],
            [high_y, 0.8 * body.base],
            [high_y, 0.7 * high + 0.3 * body.base],
            [body.hinge_y + 0.3 * deep, high],
            [body.hinge_y - 0.4 * deep, high],
        ]
    )
    cheek_skin = skin if rng.random() < 0.6 else steel
    meshes += [
        shifted(profile(shape, cheek / 2, 0.2 * cheek, cheek_skin), side * (room + cheek / 2), 0, 0) for side in (-1, 1)
    ]
    pin = rod(
        np.array([-room - 1.3 * cheek, body.hinge_y, body.hinge_z]),
        np.array([room + 1.3 * cheek, body.hinge_y, body.hinge_z]),
        0.02 * body.length,
        steel,
        10,
    )
    meshes.append(pin)
    if rng.random() < 0.4:  # the spring
        y = front + body.length * float(rng.uniform(0.45, 0.7))
        meshes.append(
            block((-0.15 * w, y, body.base - 1e-4), (0.15 * w, y + 0.12 * body.length, body.base + 0.002), steel)
        )
    return meshes


def _cover(rng: Generator, body: _Body) -> Array:
    """Outline (y,z) of the arm's cover, its nose at -y: arched, wedge-shaped or straight."""
    nose_y, back_y = body.hinge_y - body.arm_length, body.hinge_y + 0.08 * body.length * float(rng.uniform(0.2, 1.2))
    low = body.low + 0.3 * body.tall * float(rng.uniform(0.5, 1.2))
    share = np.linspace(0.0, 1.0, 12)
    arch, rise = float(rng.uniform(0.0, 0.35)), float(rng.uniform(-0.15, 0.35))
    top = body.low + body.tall * (0.65 + rise * (share - 0.5) + arch * np.sin(np.pi * np.clip(share * 1.1, 0, 1)))
    round_nose = float(rng.uniform(0.02, 0.3))
    top = low + (top - low) * np.clip((share + 0.25 * (1 - round_nose)) / max(round_nose, 0.05), 0.35, 1.0)
    y = nose_y + share * (back_y - nose_y)
    over = np.stack([y, np.maximum(top, low + 0.1 * body.tall)], axis=1)[::-1]
    return np.concatenate([np.array([[nose_y, low], [back_y, low]]), over])


def _arm(rng: Generator, body: _Body, skin: Material, steel: Material) -> list[Mesh]:
    nose_y = body.hinge_y - body.arm_length
    half = body.arm_width / 2
    cover = profile(_cover(rng, body), half, 0.3 * half, skin)
    meshes = [cover]
    rail = half * float(rng.uniform(0.5, 0.85))
    magazine = block((-rail, nose_y * 1.0 - 0.002, body.low), (rail, body.hinge_y, body.low + 0.45 * body.tall), steel)
    meshes.append(magazine)
    if rng.random() < 0.5:  # a nose plate
        share = float(rng.uniform(0.3, 0.6))
        plate_skin = steel if rng.random() < 0.6 else plain(rng, random_color(rng))
        meshes.append(
            block(
                (-half * 0.95, nose_y - 0.004, body.low),
                (half * 0.95, nose_y + 0.004, body.low + share * body.tall),
                plate_skin,
            )
        )
    draw = rng.random()
    if draw < 0.3:  # a rubber or coloured pad to press on
        pad = plain(rng, random_color(rng))
        y = nose_y + body.arm_length * float(rng.uniform(0.1, 0.3))
        outline = np.array(
            [
                [y, 0.0],
                [y + 0.35 * body.arm_length, 0.0],
                [y + 0.33 * body.arm_length, 0.05 * body.tall],
                [y + 0.05 * body.arm_length, 0.05 * body.tall],
            ]
        )
        top = float(cover.vertices[:, 2].max())
        meshes.append(shifted(profile(outline, 0.7 * half, 1e-4, pad), 0, 0, top - 0.03 * body.tall))
    elif draw < 0.5:  # a print on the sides
        label = printed(rng, random_color(rng), (nose_y, body.low + body.tall, body.arm_length, -body.tall))
        y, z = nose_y + 0.35 * body.arm_length, body.low + 0.5 * body.tall
        meshes += [
            block(
                (side * half - 5e-4, y, z),
                (side * half + 5e-4, y + 0.35 * body.arm_length, z + 0.18 * body.tall),
                label,
            )
            for side in (-1, 1)
        ]
    if rng.random() < 0.3:  # grooves for the thumb
        groove = block((-0.5 * half, 0, 0), (0.5 * half, 0.003, 0.0015), plain(rng, gray(rng, 0.02, 0.2)))
        offsets = np.stack(
            [
                np.zeros(4),
                nose_y + body.arm_length * (0.2 + 0.05 * np.arange(4)),
                np.full(4, float(cover.vertices[:, 2].max()) - 0.001),
            ],
            axis=1,
        )
        meshes.append(repeated(groove, offsets))
    if rng.random() < 0.5:
        rivet = upright_to("x", revolved([(0.02 * body.length, 0), (0.015 * body.length, 0.002)], steel, 10))
        right = shifted(rivet, half - 1e-4, 0, 0)
        both = (right, turned(right, (0.0, 0.0, 1.0), np.pi))
        meshes += [shifted(mesh, 0, body.hinge_y, body.hinge_z) for mesh in both]
    return meshes


def sample_object(rng: Generator) -> ArticulatedObject:
    """A random stapler, its arm parallel to the base."""
    body = _sizes(rng)
    color = random_color(rng) if rng.random() < 0.6 else gray(rng, 0.02, 0.95)
    skin = plain(rng, color)
    if rng.random() < 0.12:
        skin = metal(rng)
    base_skin = skin
    draw = rng.random()
    if draw < 0.3:
        base_skin = plain(rng, gray(rng, 0.02, 0.2))
    elif draw < 0.45:
        base_skin = metal(rng)
    elif draw < 0.6:
        base_skin = plain(rng, vary(rng, color, 0.25))
    steel = plain(rng, gray(rng, 0.45, 0.9), contrast=0.03) if rng.random() < 0.8 else metal(rng)
    base, arm = _base(rng, body, base_skin, steel), _arm(rng, body, skin, steel)
    hinge = (0.0, body.hinge_y, body.hinge_z)
    limit = (0.0, float(rng.choice([np.radians(rng.uniform(45, 100)), np.radians(rng.uniform(150, 190))])))
    return articulated_object(CATEGORIES["stapler"].joints, (base, arm), (hinge,), limits=[limit])
