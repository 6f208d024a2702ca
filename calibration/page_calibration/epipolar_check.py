"""Does the calibration of a stereo pair fit its pictures? What one camera sees must lie on the other's epipolar lines.

Epipolar lines do not know how long the baseline is: another unit does not show, and the translation's sign neither.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from page_calibration.check import MIN_SIGNAL, Finding, is_clear
from page_calibration.stereo import epipolar_distances
from page_calibration.suspects import Suspect, suspects
from page_runtime.geometry import Array, invert
from page_runtime.lens import RawCamera

SIGMA_PX = 1.0
RATIO = 0.75
MIN_MATCHES = 60
SEEN_BY_EPIPOLAR_LINES = ("none", "extrinsics", "resolution", "focal")


def check_stereo(
    a: RawCamera, b: RawCamera, pictures: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint8]]]
) -> Finding:
    """Judge two cameras by pictures (H,W) uint8 both took at the same moments."""
    pairs = [_matches(gray_a, gray_b) for gray_a, gray_b in pictures]
    pixels_a, pixels_b = (np.concatenate([pair[side] for pair in pairs]) for side in (0, 1))
    count = len(pixels_a)
    if count < MIN_MATCHES:
        words = (
            f"only {count} points found in both pictures, {MIN_MATCHES} are the least: record something with texture"
        )
        return Finding(None, words, outlines=count)
    shuffled = np.roll(pixels_b, count // 2, axis=0)
    ranked = [
        (_agreement(suspect, pixels_a, pixels_b) - _agreement(suspect, pixels_a, shuffled), suspect)
        for suspect in suspects(a, b, names=("first", "second"))
        if suspect.fault in SEEN_BY_EPIPOLAR_LINES
    ]
    given = ranked[0][0]
    best_score, best = max(ranked, key=lambda one: one[0])
    top = sorted(((suspect.words, score / max(best_score, 1e-9)) for score, suspect in ranked), key=lambda one: -one[1])
    shown = (("as given", given / max(best_score, 1e-9)), *(one for one in top[:8] if one[0] != "as given"))
    if best_score < MIN_SIGNAL:
        words = "points lie on no epipolar lines, whatever is assumed: were the pictures taken at the same moment?"
        return Finding(None, words, shown, best, count)
    # Every match is a point of its own, ten neighbouring ones of an outline are one.
    if best.fault == "none" or not is_clear(best_score - given, best_score, 10 * count):
        off = float(np.median(np.abs(_distances_px(ranked[0][1], pixels_a, pixels_b))))
        words = f"{count} points lie {off:.2f} px off their epipolar lines in the median: the calibration fits"
        return Finding("none", words, shown, ranked[0][1], count)
    share = 100 * max(given / best_score, 0.0)
    words = f"{best.words}; as given, {share:.0f} % of the points that could lie on epipolar lines do"
    return Finding(best.fault, words, shown, best, count)


def _matches(gray_a: NDArray[np.uint8], gray_b: NDArray[np.uint8]) -> tuple[Array, Array]:
    """Pixels (n,2) of the same points in both pictures: SIFT, each the other's best and clearly."""
    sift = cv2.SIFT.create(nfeatures=3000)
    points_a, described_a = sift.detectAndCompute(gray_a, None)
    points_b, described_b = sift.detectAndCompute(gray_b, None)
    if len(points_a) < 2 or len(points_b) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = {match.queryIdx: match.trainIdx for match in matcher.match(described_b, described_a)}
    kept = [
        (points_a[first.queryIdx].pt, points_b[first.trainIdx].pt)
        for first, second in matcher.knnMatch(described_a, described_b, k=2)
        if first.distance < RATIO * second.distance and back[first.trainIdx] == first.queryIdx
    ]
    found = np.array(kept, dtype=float).reshape(-1, 2, 2)
    return found[:, 0], found[:, 1]


def _distances_px(suspect: Suspect, pixels_a: Array, pixels_b: Array) -> Array:
    a, b = suspect.depth, suspect.color
    T_b_a = b.camera.T_camera_world @ invert(a.camera.T_camera_world)
    plane_a, plane_b = a.rays(pixels_a)[:, :2], b.rays(pixels_b)[:, :2]
    return epipolar_distances(T_b_a, plane_a, plane_b) * b.camera.K[0, 0]


def _agreement(suspect: Suspect, pixels_a: Array, pixels_b: Array) -> float:
    off = np.nan_to_num(_distances_px(suspect, pixels_a, pixels_b), nan=1e3)
    return float(np.exp(-0.5 * (off / SIGMA_PX) ** 2).mean())
