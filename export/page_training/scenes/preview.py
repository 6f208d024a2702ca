"""Contact sheets: looking at scenes as the network will see them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from page_training.scenes.scene import sample_scene
from page_training.scenes.textures import Generator
from page_training.scenes.view import SceneView, training_view

AXIS_COLORS = ((255, 40, 40), (40, 255, 40), (60, 90, 255))


def depth_colors(depth_m: NDArray[np.float32], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H,W,3) colour map of depth, scaled to the object's range as far as it is seen; missing readings dark
    blue."""
    known = depth_m[(depth_m > 0) & (mask > 0)]
    low, high = np.percentile(known, [2, 98]) if known.size else (0.0, 1.0)
    margin = 0.25 * (high - low) + 0.02
    scaled = np.clip((depth_m - low + margin) / (high - low + 2 * margin), 0.08, 1.0)
    colors = cv2.applyColorMap((scaled * 255).astype(np.uint8), cv2.COLORMAP_JET)[..., ::-1]
    colors = np.array(colors, np.uint8)
    colors[depth_m <= 0] = (0, 0, 128)
    return colors


def draw_axes(image: NDArray[np.uint8], view: SceneView) -> NDArray[np.uint8]:
    """The picture with x (red), y (green), z (blue) of every part, half its extents long."""
    drawn = image.copy()
    for truth in view.truths:
        tips = np.vstack([np.zeros(3), np.diag(truth.extents_m / 2).clip(0.02)])
        points = tips @ truth.T_camera_part[:3, :3].T + truth.T_camera_part[:3, 3]
        pixels = points @ view.frame.camera.K.T
        pixels = (pixels[:, :2] / pixels[:, 2:]).round().astype(int)
        for axis, color in enumerate(AXIS_COLORS):
            cv2.line(drawn, pixels[0].tolist(), pixels[axis + 1].tolist(), color, 2)
    return drawn


def contact_sheet(
    category: str, rng: Generator, rows: int, cols: int, *, size: int = 224, axes: bool = True
) -> NDArray[np.uint8]:
    """(2*rows*size, cols*size, 3) uint8 RGB: training views, colour above depth."""
    lines = []
    for _ in range(rows):
        views = [training_view(sample_scene(category, rng), rng, size) for _ in range(cols)]
        lines.append(np.hstack([draw_axes(v.frame.color, v) if axes else v.frame.color for v in views]))
        lines.append(np.hstack([depth_colors(v.frame.depth_m, v.part_mask) for v in views]))
    return np.vstack(lines)
