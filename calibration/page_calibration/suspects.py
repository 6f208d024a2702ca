"""What is usually wrong with a calibration, each as the calibration that would be right if it were so."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from page_runtime.camera import Camera
from page_runtime.geometry import Array, invert
from page_runtime.lens import RawCamera

Fault = Literal["none", "extrinsics", "unit", "resolution", "focal"]

UNITS = {1e-3: "millimetres taken for metres", 1e-2: "centimetres taken for metres",
         10.0: "metres taken for decimetres",
         100.0: "metres taken for centimetres", 1e3: "metres taken for millimetres"}  # fmt: skip
RESOLUTIONS = (1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0)
FOCALS = tuple(np.round(np.arange(0.94, 1.0601, 0.0025), 4))


@dataclass(frozen=True, eq=False, slots=True)
class Suspect:
    """What the calibration would be, and what that says of the one given. focal: factor of the focal length."""

    fault: Fault
    words: str
    depth: RawCamera
    color: RawCamera
    focal: float = 1.0


def suspects(depth: RawCamera, color: RawCamera, *, names: tuple[str, str] = ("depth", "colour")) -> Iterator[Suspect]:
    """The calibration as given first, then each usual mistake undone. names: of the cameras, in words."""
    first, second = names
    yield Suspect("none", "as given", depth, color)
    T = color.camera.T_camera_world @ invert(depth.camera.T_camera_world)
    yield Suspect("extrinsics", "the extrinsics are inverted", depth, _at(color, depth, invert(T)))
    transposed, negated = T.copy(), T.copy()
    transposed[:3, :3], negated[:3, 3] = T[:3, :3].T, -T[:3, 3]
    yield Suspect("extrinsics", "the rotation is transposed", depth, _at(color, depth, transposed))
    yield Suspect("extrinsics", "the translation has the wrong sign", depth, _at(color, depth, negated))
    for factor, words in UNITS.items():
        scaled = T.copy()
        scaled[:3, 3] *= factor
        yield Suspect("unit", f"the translation is in another unit: {words}", depth, _at(color, depth, scaled))
    for scale in RESOLUTIONS:
        words = f"K is of another resolution, {1 / scale:.3g} times the picture's"
        yield Suspect("resolution", f"the {second} camera's {words}", depth, _resized(color, scale))
        yield Suspect("resolution", f"the {first} camera's {words}", _resized(depth, scale), color)
    for focal in FOCALS:
        if focal != 1.0:
            amount = f"{abs(1 / focal - 1) * 100:.1f} % too {'long' if focal < 1 else 'short'}"
            words = f"the {second} camera's focal length is {amount}, or the {first} camera's as much the other way"
            yield Suspect("focal", words, depth, _zoomed(color, focal), float(focal))


def _at(color: RawCamera, depth: RawCamera, T_color_depth: Array) -> RawCamera:
    T_camera_world = T_color_depth @ depth.camera.T_camera_world
    return replace(color, camera=replace(color.camera, T_camera_world=T_camera_world))


def _resized(raw: RawCamera, scale: float) -> RawCamera:
    """K as if it were for a picture 1/scale times as large; the picture's own size stays."""
    here = raw.camera
    K = here.K.copy()
    K[:2] *= scale
    K[:2, 2] = (here.K[:2, 2] + 0.5) * scale - 0.5
    return replace(raw, camera=Camera(K, here.width, here.height, here.T_camera_world))


def _zoomed(raw: RawCamera, focal: float) -> RawCamera:
    K = raw.camera.K.copy()
    K[[0, 1], [0, 1]] *= focal
    return replace(raw, camera=replace(raw.camera, K=K))
