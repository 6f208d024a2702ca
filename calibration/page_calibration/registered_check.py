"""Does the camera of a recording of registered frames fit it?

Registered depth lies on its colour whatever K is, so outlines only show whether it was registered. K and the camera's
places are judged where the camera moved: what one frame measures must be where another one measures it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from page_calibration.check import (
    MIN_GAIN,
    MIN_OUTLINES,
    MIN_SIGNAL,
    Finding,
    depth_is_plausible,
    focal_range,
    is_clear,
    mean_agreement,
    too_few,
)
from page_calibration.edges import color_edge_distance, depth_outlines
from page_calibration.suspects import FOCALS, UNITS, Fault
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array, apply, invert, rotation_angle
from page_runtime.lens import RawCamera

# Registration that is off by this much is another registration than the pictures'.
MAX_SHIFT_PX = 2.5
_SHIFTS = tuple((float(dx), float(dy)) for dx in range(-12, 13, 2) for dy in range(-8, 9, 2))
_FINER = tuple((float(dx), float(dy)) for dx in (-1, 0, 1) for dy in (-1, 0, 1))
# Frames from places farther apart than this, or turned by more, are different views.
MIN_MOTION_M, MIN_TURN_DEG = 0.03, 3.0
# Depth agrees to its own noise; 1 % is what a stereo camera has at 2 m.
DEPTH_SIGMA = 0.01
POINTS = 2000
FOCAL_FREE = 0.0076


@dataclass(frozen=True, eq=False, slots=True)
class _Claim:
    fault: Fault
    words: str
    frames: tuple[RgbdFrame, ...]
    focal: float = 1.0


def check_frames(frames: Sequence[RgbdFrame]) -> Finding:
    """Judge the cameras of registered frames; the Finding's words say what could not be judged."""
    implausible = depth_is_plausible(frames[0].depth_m)
    if implausible is not None:
        return Finding("unit", implausible)
    shifted = _registration(frames)
    if shifted.fault is not None and shifted.fault != "none":
        return shifted
    pairs = list(_moved_pairs(frames))
    if not pairs:
        words = (
            f"{shifted.words}. K and places cannot be judged: the camera did not move, or its places are not recorded"
        )
        return replace(shifted, words=words)
    return _judged(frames, pairs, shifted.outlines)


def _registration(frames: Sequence[RgbdFrame]) -> Finding:
    distances = [color_edge_distance(frame.color) for frame in frames]
    raws = [RawCamera(replace(frame.camera, T_camera_world=np.eye(4))) for frame in frames]
    outlines = [raw.project(depth_outlines(frame.depth_m).points(raw)) for raw, frame in zip(raws, frames, strict=True)]
    count = sum(len(one) for one in outlines)
    if count < MIN_OUTLINES:
        return Finding(None, too_few(count), outlines=count)
    scores = {shift: mean_agreement(distances, outlines, (shift,)) for shift in _SHIFTS}
    chance = float(np.median(list(scores.values())))
    coarse = max(scores, key=lambda shift: scores[shift])
    for dx, dy in _FINER:
        shift = (coarse[0] + dx, coarse[1] + dy)
        scores[shift] = mean_agreement(distances, outlines, (shift,))
    best = max(scores, key=lambda shift: scores[shift])
    signal = scores[best] - chance
    if signal < MIN_SIGNAL:
        return Finding(None, "outlines in depth lie on no edges in colour, wherever they are moved", outlines=count)
    given = (scores[0.0, 0.0] - chance) / signal
    shown = (("as given", given), (f"moved by {best[0]:g}, {best[1]:g} px", 1.0))
    if np.hypot(*best) > MAX_SHIFT_PX and is_clear(scores[best] - scores[0.0, 0.0], signal, count):
        words = (
            f"depth is not registered to colour: its outlines lie on the edges when moved by ({best[0]:g}, "
            f"{best[1]:g}) px; register with the rig's calibration (page-calibrate register)"
        )
        return Finding("extrinsics", words, shown, outlines=count)
    return Finding("none", f"depth is registered to colour, by {count} outline points", shown, outlines=count)


def _moved_pairs(frames: Sequence[RgbdFrame]) -> Iterator[tuple[int, int]]:
    for i in range(len(frames) - 1):
        T = frames[i + 1].camera.T_camera_world @ invert(frames[i].camera.T_camera_world)
        turn = np.degrees(float(rotation_angle(T[:3, :3], np.eye(3))))
        if np.linalg.norm(T[:3, 3]) > MIN_MOTION_M or turn > MIN_TURN_DEG:
            yield i, i + 1


def _claims(frames: Sequence[RgbdFrame]) -> Iterator[_Claim]:
    yield _Claim("none", "as given", tuple(frames))
    yield _Claim(
        "extrinsics", "the camera's places are inverted", tuple(_at(f, invert(f.camera.T_camera_world)) for f in frames)
    )
    for factor, words in UNITS.items():
        scaled = []
        for frame in frames:
            T = frame.camera.T_camera_world.copy()
            T[:3, 3] *= factor
            scaled.append(_at(frame, T))
        yield _Claim("unit", f"the camera's places are in another unit: {words}", tuple(scaled))
    for focal in FOCALS:
        if focal != 1.0:
            amount = f"{abs(1 / focal - 1) * 100:.1f} % too {'long' if focal < 1 else 'short'}"
            zoomed = tuple(_zoomed(frame, float(focal)) for frame in frames)
            yield _Claim("focal", f"the focal length is {amount}", zoomed, float(focal))


def _at(frame: RgbdFrame, T_camera_world: Array) -> RgbdFrame:
    return replace(frame, camera=replace(frame.camera, T_camera_world=T_camera_world))


def _zoomed(frame: RgbdFrame, focal: float) -> RgbdFrame:
    K = frame.camera.K.copy()
    K[[0, 1], [0, 1]] *= focal
    return replace(frame, camera=replace(frame.camera, K=K))


def _judged(frames: Sequence[RgbdFrame], pairs: list[tuple[int, int]], outlines: int) -> Finding:
    ranked = [(_consistency(claim.frames, pairs), claim) for claim in _claims(frames)]
    given = ranked[0][0]
    best_score, best = max(ranked, key=lambda one: one[0])
    top = sorted(((c.words, score / max(best_score, 1e-9)) for score, c in ranked), key=lambda one: -one[1])
    shown = (("as given", given / max(best_score, 1e-9)), *(one for one in top[:8] if one[0] != "as given"))
    if best_score < 2 * MIN_SIGNAL:
        return Finding(None, "frames from different places do not measure the same scene, whatever is assumed; did "
                       "something move?", shown, outlines=outlines)  # fmt: skip
    is_near = best.fault == "focal" and abs(best.focal - 1.0) < FOCAL_FREE
    if best.fault == "none" or is_near or best_score - given < MIN_GAIN * best_score:
        words = (
            "depth is registered to colour, and frames from different places measure the same scene: the camera fits; "
            f"{focal_range(ranked)}"
        )
        return Finding("none", words, shown, outlines=outlines)
    share = 100 * given / best_score
    words = f"{best.words}; as given, frames from different places agree on {share:.0f} % of what they could"
    return Finding(best.fault, words, shown, outlines=outlines)


def _consistency(frames: Sequence[RgbdFrame], pairs: Sequence[tuple[int, int]]) -> float:
    """Mean over points of one frame, seen by another, of exp(-(z - measured)^2 / 2 (1 % of z)^2); both ways."""
    found = []
    for i, j in (*pairs, *((j, i) for i, j in pairs)):
        a, b = frames[i], frames[j]
        rows, columns = np.nonzero(a.depth_m > 0)
        some = slice(None, None, max(1, len(rows) // POINTS))
        pixels = np.stack([columns[some], rows[some]], axis=1).astype(float)
        points_camera = a.camera.backproject(pixels, a.depth_m[rows[some], columns[some]])
        points_world = apply(invert(a.camera.T_camera_world), points_camera)
        z = apply(b.camera.T_camera_world, points_world)[:, 2]
        u, v = np.nan_to_num(np.rint(b.camera.project(points_world)), nan=-1.0).clip(-1, 1e6).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < b.camera.width) & (v < b.camera.height)
        measured = np.zeros(len(z))
        measured[inside] = b.depth_m[v[inside], u[inside]]
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.where(measured > 0, (z - measured) / (DEPTH_SIGMA * measured), np.inf)
        found.append(np.exp(-0.5 * off**2).mean())
    return float(np.mean(found))
