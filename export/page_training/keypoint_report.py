"""Keypoints compared: how even their radii are (the paper's Table X), and what a pose from them is worth."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.geometry import Array, rotation_about
from page_runtime.similarity import skew
from page_training.keypoint_estimator import farthest_keypoints
from page_training.keypoints import off_surface_keypoints
from page_training.templates import evenly_spread

# Radius errors a pose is judged under, in units of the part's diagonal, and views it is judged from.
SIGMA = 0.01
VIEWS = 24
COLORS = ((230, 60, 60), (40, 160, 60), (60, 90, 230), (200, 140, 20), (150, 60, 190), (20, 160, 180), (120, 120, 20))


@dataclass(frozen=True, slots=True)
class KeypointFigures:
    """Lengths in units of the part's diagonal, means over instances. radius_mean, radius_std: of each keypoint.
    apart: mean Wasserstein distance of two keypoints' radii. rotation_deg, translation: standard deviations of a pose
    by all radii of the visible points, each with an independent error of SIGMA, scale unknown; medians over views.
    """

    radius_mean: tuple[float, ...]
    radius_std: tuple[float, ...]
    apart: float
    rotation_deg: float
    translation: float


def heuristics(clouds: NDArray[np.floating], count: int) -> dict[str, Array]:
    """What the estimator is compared with, each (count,3): farthest points of one instance's cloud (I,P,3), corners of
    the instances' mean box, and the off-surface keypoints that the network is trained with."""
    half = np.abs(np.asarray(clouds, float)).max(axis=1).mean(axis=0)
    corners = half * np.array(list(itertools.product((1.0, -1.0), repeat=3)))
    return {
        "FPS": farthest_keypoints(clouds[0], count),
        "box corners": corners[evenly_spread(corners, count)],
        "off surface": off_surface_keypoints()[:count],
    }


def figures_of(keypoints: Array, clouds: NDArray[np.floating]) -> KeypointFigures:
    """Of keypoints (n,3) for the clouds (I,P,3) of a part, all in units of its diagonal."""
    radii = np.linalg.norm(np.asarray(clouds, float)[:, None] - keypoints[None, :, None], axis=3)
    ordered = np.sort(radii, axis=2)
    first, second = np.triu_indices(len(keypoints), 1)
    rng = np.random.default_rng(0)
    spreads = []
    for cloud in np.asarray(clouds, float)[:8]:
        for _ in range(VIEWS // 8):
            direction = rng.normal(size=3)
            spreads.append(pose_spread(keypoints, visible_half(cloud, direction)))
    rotation_deg, translation = np.median(spreads, axis=0)
    return KeypointFigures(
        radius_mean=tuple(np.round(radii.mean(axis=(0, 2)), 4).tolist()),
        radius_std=tuple(np.round(radii.std(axis=2).mean(axis=0), 4).tolist()),
        apart=float(np.abs(ordered[:, first] - ordered[:, second]).mean()),
        rotation_deg=float(rotation_deg),
        translation=float(translation),
    )


def visible_half(cloud: Array, direction: Array) -> Array:
    """The half of a cloud (P,3) that is nearer to a camera far off in a direction (3,): one-sided, as a camera sees."""
    depth = cloud @ (direction / np.linalg.norm(direction))
    return cloud[depth >= np.median(depth)]


def pose_spread(keypoints: Array, points: Array) -> tuple[float, float]:
    """(degrees, diagonals): standard deviations of rotation and translation of a pose with free scale, by the radii of
    points (P,3) to the keypoints (n,3) with errors of SIGMA each (normal equations of METHOD 11)."""
    away = keypoints[:, None] - points[None]
    # A keypoint on the surface may be one of the points, whose radius then says nothing of its direction.
    unit = away / np.maximum(np.linalg.norm(away, axis=2, keepdims=True), 1e-9)
    jacobian = np.concatenate(
        [-skew(np.asarray(keypoints, np.float64)), np.tile(np.eye(3), (len(keypoints), 1, 1)), keypoints[:, :, None]],
        axis=2,
    )
    rows = np.einsum("npk,nkc->npc", unit, jacobian).reshape(-1, 7)
    covariance = SIGMA**2 * np.linalg.inv(rows.T @ rows + 1e-9 * np.eye(7))
    return float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))), float(np.sqrt(np.trace(covariance[3:6, 3:6])))


def picture_of(
    methods: dict[str, list[Array]], clouds: list[NDArray[np.floating]], *, instances: int = 5, size: int = 240
) -> NDArray[np.uint8]:
    """RGB picture (the paper's Fig. 8): a row for each method and part, a column for each instance, the keypoints of a
    method (n,3) for each part drawn over the clouds."""
    turn = rotation_about(np.array([1.0, 0.0, 0.0]), -1.0) @ rotation_about(np.array([0.0, 0.0, 1.0]), 0.6)
    rows = []
    for name, by_part in methods.items():
        for part, (keypoints, cloud) in enumerate(zip(by_part, clouds, strict=True)):
            tiles = []
            for points in np.asarray(cloud, float)[:instances]:
                tile = np.full((size, size, 3), 255, np.uint8)
                for spot in _pixels(points @ turn.T, size):
                    cv2.circle(tile, spot, 1, (170, 170, 170), -1, cv2.LINE_AA)
                for k, spot in enumerate(_pixels(keypoints @ turn.T, size)):
                    cv2.circle(tile, spot, 5, COLORS[k % len(COLORS)], -1, cv2.LINE_AA)
                tiles.append(tile)
            cv2.putText(
                tiles[0], f"{name}, part {part}", (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA
            )
            rows.append(np.hstack(tiles))
    return np.vstack(rows)


def _pixels(points: Array, size: int) -> list[tuple[int, int]]:
    spots = np.round(size / 2 + points[:, :2] * [1.0, -1.0] * 0.55 * size).astype(int)
    return [(int(x), int(y)) for x, y in spots]
