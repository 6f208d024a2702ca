"""Does this calibration fit this recording? Outlines in depth must lie on edges in colour.

Every usual mistake (suspects.py) is undone in turn; where the outlines then lie on the edges much better than with the
calibration as given, that is what is wrong with it. Only what outlines can show is judged: of the two focal lengths
their ratio, of the baseline what it moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from page_calibration.edges import agreement, color_edge_distance, depth_outlines
from page_calibration.suspects import FOCALS, Fault, Suspect, suspects
from page_runtime.geometry import Array, apply, invert
from page_runtime.lens import RawCamera

SIGMA_PX = 2.0
# Fewer outline points say nothing: an empty table, a wall.
MIN_OUTLINES = 200
# The best suspect's agreement must be this much above that of outlines laid anywhere.
MIN_SIGNAL = 0.08
# A mistake is named when undoing it explains this much more of the signal than the calibration as given.
MIN_GAIN = 0.15
# Focal lengths nearer than this to the one given are the search's own spread.
FOCAL_FREE = 0.0076
DEPTH_RANGE_M = (0.15, 10.0)
MIN_VALID = 0.05
_CHANCE_SHIFTS = ((37, 11), (-31, 23), (17, -41), (-43, -13), (53, 29), (-19, 47))

Picture = tuple[NDArray[np.uint8], NDArray[np.float32]]


@dataclass(frozen=True, eq=False, slots=True)
class Finding:
    """fault: "none" when the calibration fits, None when this recording cannot tell. words: the sentence. scores: of
    each suspect, its agreement above chance over the best one's; chance: agreement of outlines laid anywhere. best:
    the suspect that fits best."""

    fault: Fault | None
    words: str
    scores: tuple[tuple[str, float], ...] = ()
    best: Suspect | None = None
    outlines: int = 0


def depth_is_plausible(depth_m: NDArray[np.float32]) -> str | None:
    """Why the first frame's depth cannot be metres of a scene, None when it can."""
    valid = depth_m[depth_m > 0]
    if valid.size < MIN_VALID * depth_m.size:
        return f"only {100 * valid.size / depth_m.size:.1f} % of the first depth picture has a reading"
    middle = float(np.median(valid))
    low, high = DEPTH_RANGE_M
    if low <= middle <= high:
        return None
    factor = 1000 if middle < low else 0.001
    return (
        f"the first depth picture's median is {middle:.4g} m, expected {low} to {high} m: the depth unit is probably "
        f"{factor:g} times what was said"
    )


def check_pair(depth: RawCamera, color: RawCamera, pictures: Sequence[Picture]) -> Finding:
    """Judge the calibration of two cameras by raw pictures (colour (H,W,3) uint8 RGB, depth (h,w) float32 metres)."""
    implausible = depth_is_plausible(pictures[0][1])
    if implausible is not None:
        return Finding("unit", implausible)
    distances = [color_edge_distance(image) for image, _ in pictures]
    ranked: list[tuple[float, Suspect]] = []
    chance = 0.0
    outlines = [depth_outlines(depth_m) for _, depth_m in pictures]
    count = sum(map(len, outlines))
    if count < MIN_OUTLINES:
        return Finding(None, too_few(count), outlines=count)
    for suspect in suspects(depth, color):
        projected = [_project(suspect, one.points(suspect.depth)) for one in outlines]
        if suspect.fault == "none":
            chance = mean_agreement(distances, projected, _CHANCE_SHIFTS)
        ranked.append((mean_agreement(distances, projected) - chance, suspect))
    return _judged(ranked, count)


def too_few(count: int) -> str:
    """The sentence for a recording without outlines."""
    return (
        f"only {count} points where depth jumps, {MIN_OUTLINES} are the least: record objects standing free before "
        "something farther away"
    )


def _project(suspect: Suspect, points_depth: Array) -> Array:
    return suspect.color.project(apply(invert(suspect.depth.camera.T_camera_world), points_depth))


def mean_agreement(
    distances: Sequence[NDArray[np.float32]],
    projected: Sequence[Array],
    shifts: Sequence[tuple[float, float]] = ((0.0, 0.0),),
) -> float:
    """Agreement of outlines (n,2) px with edges, over all pictures and shifts of the outlines."""
    return float(np.mean([
        agreement(d, p + np.array(shift), sigma_px=SIGMA_PX)
        for d, p in zip(distances, projected, strict=True)
        for shift in shifts
    ]))  # fmt: skip


def is_clear(gain: float, signal: float, count: int) -> bool:
    """Whether `gain` in agreement of `count` outline points is a large part of the signal and no accident of few of
    them.

    Neighbouring points are on one edge: about one in ten tells something of its own.
    """
    return gain >= MIN_GAIN * signal and gain >= 4.0 * 0.35 / np.sqrt(count / 10.0)


class Ranked(Protocol):
    """What was assumed: which fault, and by which factor the focal length."""

    @property
    def fault(self) -> Fault: ...

    @property
    def focal(self) -> float: ...


def focal_range(ranked: Sequence[tuple[float, Ranked]]) -> str:
    """In words, which focal lengths this recording would not have told from the one given."""
    best = max(score for score, _ in ranked)
    alike = [
        claim.focal for score, claim in ranked if claim.fault in ("none", "focal") and score >= (1 - MIN_GAIN) * best
    ]
    low, high = 100 * (min(alike) - 1.0), 100 * (max(alike) - 1.0)
    at_least = " at least" if min(alike) == min(FOCALS) or max(alike) == max(FOCALS) else ""
    return f"focal lengths from {low:+.1f} to {high:+.1f} %{at_least} would have fitted as well"


def _judged(ranked: list[tuple[float, Suspect]], count: int) -> Finding:
    given = ranked[0][0]
    best_score, best = max(ranked, key=lambda one: one[0])
    top = sorted(((suspect.words, score / max(best_score, 1e-9)) for score, suspect in ranked), key=lambda one: -one[1])
    shown = (("as given", given / max(best_score, 1e-9)), *(one for one in top[:8] if one[0] != "as given"))
    if best_score < MIN_SIGNAL:
        words = (
            "outlines in depth lie on edges in colour no better than anywhere, whatever is assumed: were both pictures "
            "taken at the same moment, of the same thing?"
        )
        return Finding(None, words, shown, best, count)
    is_near = best.fault == "focal" and abs(best.focal - 1.0) < FOCAL_FREE
    if best.fault == "none" or is_near or not is_clear(best_score - given, best_score, count):
        words = f"outlines in depth lie on edges in colour: the calibration fits; {focal_range(ranked)}"
        return Finding("none", words, shown, ranked[0][1], count)
    share = max(given / best_score, 0.0)
    words = f"{best.words}; as given, {100 * share:.0f} % of the outlines that could lie on edges do"
    return Finding(best.fault, words, shown, best, count)
