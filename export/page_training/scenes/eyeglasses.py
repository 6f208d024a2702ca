"""Category "eyeglasses": spectacles, sunglasses, goggles; of wire and of plastic, with rims or without."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from page_runtime.geometry import Array
from page_training.categories import CATEGORIES
from page_training.scenes.articulated import ArticulatedObject, States, articulated_object, seen_from
from page_training.scenes.fittings import gray, metal
from page_training.scenes.materials import Material, hsv_color, patterned, plain, random_color
from page_training.scenes.meshes import Mesh, ball, shifted
from page_training.scenes.resting import Rest, held_rest, turned_rest, upright_rest
from page_training.scenes.shapes import rod, slab, tube, upright_to
from page_training.scenes.textures import Generator

Y, Z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])


def distance_m(model: ArticulatedObject) -> tuple[float, float]:
    return seen_from(model, 1.3, 4.2)


def rest(rng: Generator) -> Rest:
    """On rims and temples, upside down, on the front or the back, or held, as on a nose."""
    draw = rng.random()
    if draw < 0.42:
        return upright_rest(rng)
    if draw < 0.58:
        return turned_rest((0.0, 1.0, 0.0), np.pi, rng)
    if draw < 0.78:
        return turned_rest((1.0, 0.0, 0.0), float(rng.choice([-1, 1])) * np.pi / 2, rng)
    return held_rest(rng)


def sample_states(rng: Generator, model: ArticulatedObject) -> States:
    """How far the temples are folded, rad: open as worn, both folded over each other, or anything."""
    low, high = model.joints[0].limits
    draw = rng.random()
    if draw < 0.45:
        both = rng.normal(0.0, 0.06, 2)
    elif draw < 0.7:
        first = float(rng.uniform(1.4, 1.62))
        both = np.array([first, first - rng.uniform(0.03, 0.15)])[rng.permutation(2)]
    else:
        both = rng.uniform(low, high, 2)
    return tuple(float(state) for state in np.clip(both, low, high))


@dataclass(frozen=True, eq=False, slots=True)
class _Frame:
    """Metres. eye: (N,2) outline (x,z) of the right eye's lens about its middle, seen from the front; half: of the
    distance between the lenses' middles; rim, deep: width and depth of the rims; width: between the hinges; hinge_z,
    hinge_y; wrap: how the front curves back, 1/m."""

    eye: Array
    half: float
    rim: float
    deep: float
    width: float
    hinge_y: float
    hinge_z: float
    wrap: float


def _eye(rng: Generator, width: float, height: float) -> Array:
    """Outline (N,2) of the lens at +x, counter-clockwise: round, oval, square, cat-eye, aviator."""
    angle = np.arange(32) * (2 * np.pi / 32)
    c, s = np.cos(angle), np.sin(angle)
    power = float(rng.choice([1.0, rng.uniform(0.5, 0.8), rng.uniform(0.25, 0.5)]))
    x = np.sign(c) * np.abs(c) ** power * width / 2
    z = np.sign(s) * np.abs(s) ** power * height / 2
    draw = rng.random()
    if draw < 0.25:  # cat-eye: the outer upper corner rises
        z = z + 0.25 * height * np.clip(x / width, 0, 1) * (s > 0) * rng.uniform(0.5, 1.2)
    elif draw < 0.5:  # aviator: narrower below
        x = x * (1 - rng.uniform(0.1, 0.35) * np.clip(-z / height, 0, 1) * 2)
    elif draw < 0.65:  # flat above
        z = np.minimum(z, 0.3 * height)
    return np.stack([x, z], axis=1)


def _sizes(rng: Generator) -> _Frame:
    scale = float(rng.uniform(0.75, 1.0) if rng.random() < 0.15 else rng.uniform(0.92, 1.12))
    width = float(rng.uniform(0.040, 0.062)) * scale
    height = float(np.clip(width * rng.uniform(0.42, 1.0), 0.02, 0.055))
    bridge = float(rng.uniform(0.014, 0.024)) * scale
    thin = rng.random() < 0.45
    rim = float(rng.uniform(0.001, 0.0025) if thin else rng.uniform(0.002, 0.0075))
    eye = _eye(rng, width, height)
    half = (width + bridge) / 2
    return _Frame(
        eye=eye,
        half=half,
        rim=rim,
        deep=rim * float(rng.uniform(0.8, 1.6)),
        width=2 * (half + width / 2) + float(rng.uniform(0.002, 0.016)),
        hinge_y=float(rng.uniform(0.002, 0.016)),
        hinge_z=height * float(rng.uniform(0.05, 0.42)),
        wrap=float(rng.uniform(0.0, 1.5) if rng.random() < 0.7 else rng.uniform(1.5, 4.5)),
    )


def _lens_skin(rng: Generator) -> Material | None:
    """Dark or mirrored glass; None for clear lenses, which neither camera nor depth sensor sees."""
    draw = rng.random()
    if draw < 0.45:
        return None
    color = (
        gray(rng, 0.01, 0.12) if draw < 0.8 else hsv_color(rng.random(), rng.uniform(0.2, 0.9), rng.uniform(0.1, 0.7))
    )
    look = plain(rng, color, contrast=0.03)
    return replace(
        look,
        specular=float(rng.uniform(0.3, 0.9)),
        gloss=float(rng.uniform(30, 150)),
        opacity_to_depth=float(rng.uniform(0.4, 1.0)),
    )


def _front(rng: Generator, frame: _Frame, skin: Material, accent: Material) -> list[Mesh]:
    """Rims, lenses, bridge, end pieces and nose pads, standing about x = 0, z = 0, the lenses at y = 0."""
    meshes: list[Mesh] = []
    lens = _lens_skin(rng)
    style = rng.random()  # full rims, half rims, none, a shield over both eyes
    rimless = 0.72 < style < 0.84
    if rimless and lens is None:
        lens = plain(rng, gray(rng, 0.6, 0.95), contrast=0.02)
    top = float(frame.eye[:, 1].max())
    inner = frame.half + float(frame.eye[:, 0].min())
    for sign in (1.0, -1.0):
        eye = frame.eye * np.array([sign, 1.0]) + np.array([sign * frame.half, 0.0])
        eye = eye if sign > 0 else eye[::-1]
        path = np.stack([eye[:, 0], np.zeros(len(eye)), eye[:, 1]], axis=1)
        if style < 0.6 or style > 0.84:
            meshes.append(tube(path, Y, frame.rim, frame.deep, skin, steps=6, closed=True))
        elif not rimless:  # half rims: above, with a little down the sides
            order = np.argsort(np.arctan2(eye[:, 1] + 0.1 * top, eye[:, 0] - sign * frame.half))
            upper = path[order][path[order][:, 2] > -0.25 * top]
            meshes.append(tube(upper, Y, frame.rim, frame.deep, skin, steps=6))
        if lens is not None:
            glass = slab(eye, -0.0008, 0.0008, 0.0002, lens)
            meshes.append(upright_to("-y", glass))
    # Bridge between the rims, straight, arched or double.
    level = top * float(rng.uniform(0.1, 0.75))
    share = np.linspace(-1, 1, 7)
    arch = float(rng.uniform(0.0, 0.006))
    reach = inner + 0.15 * frame.half
    bridge = np.stack([share * reach, np.full(7, -0.3 * arch), level + arch * (1 - share**2)], axis=1)
    thick = max(frame.rim, 0.0014)
    meshes.append(tube(bridge, Y, thick * float(rng.uniform(0.8, 1.8)), frame.deep, skin, steps=6))
    if rng.random() < 0.15:
        meshes.append(tube(bridge + np.array([0, 0, 0.2 * top + 0.004]), Y, thick, frame.deep, accent, steps=6))
    outer = frame.half + float(frame.eye[:, 0].max())
    for sign in (1.0, -1.0):  # end pieces that carry the hinges
        start = np.array([sign * (outer - 0.1 * frame.half), 0.0, 0.85 * frame.hinge_z])
        corner = np.array([sign * frame.width / 2, 0.0, frame.hinge_z])
        hinge = np.array([sign * frame.width / 2, frame.hinge_y, frame.hinge_z])
        tall = max(thick * float(rng.uniform(1.0, 2.2)), 0.002)
        meshes.append(rod(start, corner, tall / 2, skin, 8))
        meshes.append(rod(corner, hinge, tall / 2, skin, 8))
    if rng.random() < 0.6:  # nose pads on wires
        pad = plain(rng, gray(rng, 0.5, 0.95))
        for sign in (1.0, -1.0):
            place = np.array([sign * (inner - 0.003), 0.006, -0.25 * top])
            meshes.append(rod(np.array([sign * (inner + 0.002), 0.0, -0.05 * top]), place, 0.0005, accent, 5))
            button = replace(ball(1.0, pad, 8))
            scaled = replace(button, vertices=(button.vertices - [0, 0, 1]) * np.array([0.0016, 0.003, 0.005]))
            meshes.append(shifted(replace(scaled, vertices=scaled.vertices.astype(np.float32)), *place))
    return [_wrapped(mesh, frame) for mesh in meshes]


def _wrapped(mesh: Mesh, frame: _Frame) -> Mesh:
    """The mesh curved back towards the temples, so that the hinges stay where they are."""
    vertices = mesh.vertices.copy()
    vertices[:, 1] += frame.wrap * (vertices[:, 0] ** 2 - (frame.width / 2) ** 2)
    return replace(mesh, vertices=vertices)


@dataclass(frozen=True, eq=False, slots=True)
class _Temple:
    """Metres. length; tall, thick: at the hinge and at the tip; drop: of the bend behind the ear, over the last `bend`;
    bow: inwards."""

    length: float
    tall: tuple[float, float]
    thick: tuple[float, float]
    drop: float
    bend: float
    bow: float


def _temple_sizes(rng: Generator, frame: _Frame) -> _Temple:
    length = float(rng.uniform(0.11, 0.155)) * float(np.clip(frame.width / 0.138, 0.75, 1.1))
    if rng.random() < 0.4:  # wire
        tall, thick = float(rng.uniform(0.0012, 0.003)), float(rng.uniform(0.0008, 0.002))
        tip = (float(rng.uniform(0.002, 0.006)), float(rng.uniform(0.0015, 0.004)))
    else:
        tall, thick = float(rng.uniform(0.003, 0.022)), float(rng.uniform(0.002, 0.0055))
        tip = (float(np.clip(tall * rng.uniform(0.4, 1.2), 0.002, 0.009)), thick * float(rng.uniform(0.5, 1.0)))
    drop = float(rng.choice([rng.uniform(0.0, 0.008), rng.uniform(0.012, 0.045)], p=[0.2, 0.8]))
    return _Temple(
        length,
        (tall, tip[0]),
        (thick, tip[1]),
        drop,
        length * float(rng.uniform(0.2, 0.4)),
        float(rng.uniform(0, 0.012)),
    )


def _temple(rng: Generator, frame: _Frame, temple: _Temple, sign: float, skin: Material, tip: Material) -> list[Mesh]:
    """The temple at sign * x, open as worn."""
    share = np.linspace(0.0, 1.0, 14)
    y = frame.hinge_y + share * temple.length
    into_bend = np.clip((share * temple.length - (temple.length - temple.bend)) / temple.bend, 0, 1)
    z = frame.hinge_z - temple.drop * into_bend**1.6
    y = y - 0.35 * temple.drop * into_bend**2
    x = sign * (frame.width / 2 - temple.bow * share**2)
    path = np.stack([x, y, z], axis=1)
    tall = temple.tall[0] + (temple.tall[1] - temple.tall[0]) * np.minimum(share / 0.7, 1.0)
    thick = temple.thick[0] + (temple.thick[1] - temple.thick[0]) * share
    across = np.array([0.0, 0.0, 1.0])
    cut = 10 if tip is not skin else 14
    meshes = [tube(path[:cut], across, thick[:cut], tall[:cut], skin, corner=0.5, steps=8)]
    if cut < 14:
        meshes.append(
            tube(path[cut - 1 :], across, 1.25 * thick[cut - 1 :] + 5e-4, 1.2 * tall[cut - 1 :], tip, corner=0.8)
        )
    if rng.random() < 0.7:  # the hinge's barrel
        half = max(temple.tall[0], 0.003) / 2
        place = np.array([sign * (frame.width / 2 - 0.0015), frame.hinge_y, frame.hinge_z])
        meshes.append(rod(place - half * Z, place + half * Z, 0.0013, metal(rng), 8))
    return meshes


def sample_object(rng: Generator) -> ArticulatedObject:
    """Random eyeglasses, open as worn."""
    frame = _sizes(rng)
    draw = rng.random()
    if draw < 0.35:
        skin = metal(rng)
    elif draw < 0.6:
        skin = plain(rng, gray(rng, 0.01, 0.12))
    elif draw < 0.88:
        skin = plain(rng, random_color(rng))
    else:  # tortoiseshell, wood
        skin = patterned(rng, str(rng.choice(["marble", "photo", "wood", "speckle"])), float(rng.uniform(0.02, 0.08)))
    accent = skin if rng.random() < 0.6 else metal(rng)
    temple_skin = skin if rng.random() < 0.65 else plain(rng, random_color(rng))
    tip = temple_skin if rng.random() < 0.6 else plain(rng, gray(rng, 0.01, 0.9))
    front = _front(rng, frame, skin, accent)
    temple = _temple_sizes(rng, frame)
    left, right = (_temple(rng, frame, temple, sign, temple_skin, tip) for sign in (1.0, -1.0))
    points = [(sign * frame.width / 2, frame.hinge_y, frame.hinge_z) for sign in (1.0, -1.0)]
    limit = (-float(rng.uniform(0.05, 0.25)), float(rng.uniform(1.6, 1.75)))
    return articulated_object(CATEGORIES["eyeglasses"].joints, (front, left, right), points, limits=[limit, limit])
