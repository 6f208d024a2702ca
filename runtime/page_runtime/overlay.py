"""Pictures of an estimate: axes, boxes, keypoints and reasons drawn over the frame's colour."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.boxes import EDGES, box_corners
from page_runtime.camera import Camera
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array, apply
from page_runtime.pose import ArticulatedPose, PartPose
from page_runtime.recorded import Instance

Rgb = tuple[int, int, int]

AXIS_COLORS: tuple[Rgb, Rgb, Rgb] = ((235, 45, 45), (40, 200, 60), (60, 100, 255))
PART_COLORS: tuple[Rgb, ...] = ((255, 170, 0), (0, 215, 235), (235, 80, 235), (150, 230, 60), (255, 120, 120))
TRUTH_COLOR: Rgb = (255, 255, 255)
REGION_COLOR: Rgb = (170, 170, 170)
PLATE_COLOR: Rgb = (20, 20, 20)

NEAR_M = 0.02
_SHIFT = 4
_FAR_PX = 1 << 15
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw(
    frame: RgbdFrame, found: Sequence[tuple[Instance, ArticulatedPose]], *, with_truth: bool = False
) -> NDArray[np.uint8]:
    """The frame's colour (H,W,3) uint8 RGB with its objects drawn over it.

    Per part its box and name in the part's colour, its axes (x red, y green, z blue) and its keypoints as dots; the
    region as a grey frame. Parts without a pose are lines of text below the region, or at the top where there is none.
    with_truth: true boxes, thin and white.
    """
    picture = np.ascontiguousarray(frame.color).copy()
    width = _line_width(picture)
    line_height = 12 + 8 * width
    rows_at_top = 0
    for instance, pose in found:
        left, baseline = 8, line_height * (1 + rows_at_top)
        if instance.region is not None:
            x, y, w, h = instance.region
            cv2.rectangle(picture, (x, y), (x + w - 1, y + h - 1), REGION_COLOR, width)
            left, baseline = x, min(y + h, picture.shape[0] - line_height * len(pose.parts)) + line_height
        else:
            rows_at_top += len(pose.parts)
        for truth in (instance.truths or ()) if with_truth else ():
            _draw_box(picture, frame.camera, truth.T_camera_part, truth.extents_m, TRUTH_COLOR, 1)
        for k, part in enumerate(pose.parts):
            color = PART_COLORS[k % len(PART_COLORS)]
            if isinstance(part, PartPose):
                _draw_part(picture, frame.camera, part, color, width)
            else:
                _write(picture, f"{part.name}: {part.reason}", np.array([left, baseline]), color)
                baseline += line_height
    return picture


def write_lines(picture: NDArray[np.uint8], lines: Sequence[str]) -> None:
    """Lines of text at the top left of `picture` (H,W,3) uint8 RGB, in place."""
    line_height = 12 + 8 * _line_width(picture)
    for i, line in enumerate(lines):
        _write(picture, line, np.array([8, line_height * (1 + i)]), TRUTH_COLOR)


def _line_width(picture: NDArray[np.uint8]) -> int:
    return max(1, round(max(picture.shape[:2]) / 640))


def _draw_part(picture: NDArray[np.uint8], camera: Camera, part: PartPose, color: Rgb, width: int) -> None:
    _draw_box(picture, camera, part.T_camera_part, part.extents_m, color, width)
    _draw_axes(picture, camera, part, width + 1)
    _draw_keypoints(picture, camera, part, color, 2 * width)
    corners = _pixels(camera, box_corners(part.T_camera_part, part.extents_m))
    if np.isfinite(corners).all():
        _write(picture, f"{part.name} {part.confidence:.2f}", corners[corners[:, 1].argmin()] - [0, 4 * width], color)


def _pixels(camera: Camera, points_camera: Array) -> Array:
    """(..., 2) px of camera-frame points (..., 3); NaN behind the camera. No world comes into it."""
    depth = points_camera[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(depth > 0, (points_camera @ camera.K.T)[..., :2] / depth, np.nan)


def _draw_segment(picture: NDArray[np.uint8], camera: Camera, start: Array, end: Array, color: Rgb, width: int) -> None:
    """A line between two camera-frame points (3,), as far as it lies in front of the camera."""
    if max(start[2], end[2]) <= NEAR_M:
        return
    if min(start[2], end[2]) < NEAR_M:
        near = start + (end - start) * ((NEAR_M - start[2]) / (end[2] - start[2]))
        start, end = (near, end) if start[2] < NEAR_M else (start, near)
    ends = _pixels(camera, np.stack([start, end]))
    if np.abs(ends).max() > _FAR_PX:
        return
    one, other = (np.round(ends * (1 << _SHIFT)).astype(int)).tolist()
    cv2.line(picture, one, other, color, width, cv2.LINE_AA, _SHIFT)


def _draw_box(
    picture: NDArray[np.uint8], camera: Camera, T_camera_part: Array, extents_m: Array, color: Rgb, width: int
) -> None:
    corners = box_corners(T_camera_part, extents_m)
    for one, other in EDGES:
        _draw_segment(picture, camera, corners[one], corners[other], color, width)


def _draw_axes(picture: NDArray[np.uint8], camera: Camera, part: PartPose, width: int) -> None:
    """Axes as long as a quarter of the box's diagonal, so that a thin part's normal can be seen too."""
    length = float(np.linalg.norm(part.extents_m)) / 4
    tips = apply(part.T_camera_part, np.eye(3) * length)
    for tip, color in zip(tips, AXIS_COLORS, strict=True):
        _draw_segment(picture, camera, part.T_camera_part[:3, 3], tip, color, width)


def _draw_keypoints(picture: NDArray[np.uint8], camera: Camera, part: PartPose, color: Rgb, radius: int) -> None:
    for pixel in _pixels(camera, np.asarray(part.keypoints_camera)):
        if np.isfinite(pixel).all() and np.abs(pixel).max() < _FAR_PX:
            center = np.round(pixel).astype(int).tolist()
            cv2.circle(picture, center, radius, color, -1, cv2.LINE_AA)
            cv2.circle(picture, center, radius, (0, 0, 0), 1, cv2.LINE_AA)


def _write(picture: NDArray[np.uint8], text: str, position: Array, color: Rgb) -> None:
    """Text on a dark plate, so that it can be read over anything: its lower left corner at `position` (2,) px, or as
    far to the left of it as the text needs to end inside the picture."""
    scale = 0.4 * max(1.0, max(picture.shape[:2]) / 900)
    x, y = np.round(np.clip(position, -_FAR_PX, _FAR_PX)).astype(int).tolist()
    (width, height), below = cv2.getTextSize(text, _FONT, scale, 1)
    x = max(2, min(x, picture.shape[1] - width - 4))
    cv2.rectangle(picture, (x - 2, y - height - 2), (x + width + 2, y + below), PLATE_COLOR, -1)
    cv2.putText(picture, text, (x, y), _FONT, scale, color, 1, cv2.LINE_AA)
