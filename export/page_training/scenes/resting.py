"""How objects rest before the camera: upright, lying on a side, or held in the air."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from page_runtime.geometry import Array, rotation_about
from page_training.scenes.textures import Generator


@dataclass(frozen=True, eq=False, slots=True)
class Rest:
    """rotation: (3,3) R_world_root but for the yaw. height_m: of its lowest point above the support."""

    rotation: Array
    height_m: float = 0.0


def upright_rest(rng: Generator) -> Rest:
    """Standing as in use, now and then tilted a little by what lies under it."""
    tilt_deg = float(rng.choice([0.0, abs(rng.normal(0, 2)), rng.uniform(3, 20)], p=[0.6, 0.3, 0.1]))
    direction = rng.uniform(0, 2 * np.pi)
    return Rest(rotation_about(np.array([np.cos(direction), np.sin(direction), 0.0]), np.radians(tilt_deg)))


def held_rest(rng: Generator) -> Rest:
    """In a hand or hanging: any way up, some way above the support."""
    axis = rng.normal(size=3)
    return Rest(rotation_about(axis, float(rng.uniform(0, np.pi))), float(rng.uniform(0.0, 0.3)))


def turned_rest(axis: tuple[float, float, float], angle_rad: float, rng: Generator) -> Rest:
    """Resting on another side: turned by angle_rad about an axis of the object, tilted as `upright_rest` is."""
    tilt = upright_rest(rng)
    return Rest(tilt.rotation @ rotation_about(np.array(axis), angle_rad), tilt.height_m)
