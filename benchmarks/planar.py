"""Flat parts: is the keypoint told from its mirror image, and by what?"""

from typing import Any

import numpy as np
from benchmarks.figures import figure
from benchmarks.synthetic import NUM_VOTED, Noise, suite
from benchmarks.trials import WRONG_PEAK_M, register, score
from numpy.typing import NDArray

from page_runtime.registration import Ambiguous, Registration

FloatArray = NDArray[np.float64]

# Of a plate a position is right this near to the keypoint, or not at a wrong peak and nearer than to its mirror image.
RIGHT_M = 0.02
WRONG_SIDES = 0.2


def measure_planar(*, parts: int, correlated_m: float = 0.0, voxel_m: float = 0.005) -> dict[str, Any]:
    """Plates: whether the keypoint is among the listed modes, and which evidence tells it from its mirror image.

    The evidence is added step by step: radii and triangle of three keypoints, the part's box (template), sides of
    which WRONG_SIDES are wrong, the other five keypoints. The last is what the runtime uses.
    """
    steps = ("triangle", "template", "sides", "eight_keypoints")
    right: dict[str, list[bool]] = {name: [] for name in ("argmax", *steps, "eight_keypoints_without_sides")}
    ambiguous: dict[str, list[bool]] = {name: [] for name in right}
    listed: list[bool] = []
    decided: dict[str, int] = dict.fromkeys((*steps, "none"), 0)
    plates = suite(parts, "mid", 512, Noise(correlated_m=correlated_m), seed=7, shapes=("plate",))
    for i, part in enumerate(plates):
        rng = np.random.default_rng([7, i])
        votes, truths = score(part, voxel_m), part.keypoints_camera[:NUM_VOTED]
        images = truths - 2.0 * ((truths - part.t) @ part.R[:, 2:]) * part.R[:, 2]
        for one, truth, image in zip(votes, truths, images, strict=True):
            listed.append(any(_is_right(peak.position_camera, truth, image) for peak in one.peaks))
        first = [one.peaks[0].position_camera if one.peaks else np.full(3, np.inf) for one in votes]
        flipped = np.where(rng.random((len(part.radii_m), NUM_VOTED)) < WRONG_SIDES, -1.0, 1.0)
        sides = 3.0 * flipped * part.sides[:, :NUM_VOTED]
        results = {
            "triangle": register(part, votes, keypoints=NUM_VOTED, box=False),
            "template": register(part, votes, keypoints=NUM_VOTED),
            "sides": register(part, votes, keypoints=NUM_VOTED, side_logits=sides),
            "eight_keypoints": register(part, votes, side_logits=sides),
            "eight_keypoints_without_sides": register(part, votes),
        }
        right["argmax"].append(all(map(_is_right, first, truths, images)))
        ambiguous["argmax"].append(False)
        for name, result in results.items():
            placed = list(result.keypoints_camera[:NUM_VOTED]) if isinstance(result, Registration) else []
            right[name].append(bool(placed) and all(map(_is_right, placed, truths, images)))
            ambiguous[name].append(isinstance(result, Ambiguous))
        decided[next((name for name in steps if right[name][-1]), "none")] += 1
    return {
        "truth_listed": figure(np.mean(listed)),
        "chosen": figure(np.mean(right["eight_keypoints"])),
        "ambiguous": figure(np.mean(ambiguous["eight_keypoints"])),
        "right_with": {name: figure(np.mean(values)) for name, values in right.items()},
        "ambiguous_with": {name: figure(np.mean(values)) for name, values in ambiguous.items()},
        "decided_by": {name: figure(count / parts) for name, count in decided.items()},
        "plates": parts,
        "correlated_m": correlated_m,
        "meaning": (
            f"right: within {RIGHT_M} m, or within {WRONG_PEAK_M} m and nearer than to the mirror image; a pose is if "
            "its three voted keypoints are; decided_by: first step of evidence with which the pose is right"
        ),
    }


def _is_right(position: FloatArray, truth: FloatArray, image: FloatArray) -> bool:
    error_m = float(np.linalg.norm(position - truth))
    nearer = error_m < float(np.linalg.norm(position - image))
    return error_m <= RIGHT_M or (error_m <= WRONG_PEAK_M and nearer)
