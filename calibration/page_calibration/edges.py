"""Where depth jumps and where colour changes: the outlines both cameras of a rig see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.geometry import Array
from page_runtime.lens import RawCamera, sampled

# A jump between neighbouring readings that no surface makes which is seen at less than 80 degrees.
MIN_JUMP_M = 0.03
MIN_JUMP_SHARE = 0.05
# Stereo has no reading where only one of its eyes sees, up to the baseline's parallax.
MAX_GAP_PX = 16
MAX_POINTS = 3000
# Edges of colour weaker than this share of the strongest are texture and noise more often than outlines.
CANNY_QUANTILES = (0.85, 0.95)
FAR_PX = 12.0


@dataclass(frozen=True, eq=False, slots=True)
class Outlines:
    """pixels: (n,2) of the depth picture. depth_m: (n,)."""

    pixels: Array
    depth_m: Array

    def __len__(self) -> int:
        return len(self.depth_m)

    def points(self, raw: RawCamera) -> Array:
        """(n,3), metres, frame of the depth camera `raw`; those its lens has no ray for are left out."""
        points = raw.backproject(self.pixels, self.depth_m)
        return points[~np.isnan(points).any(axis=1)]


def depth_outlines(depth_m: NDArray[np.float32]) -> Outlines:
    """Half a pixel outside the near side of each jump, at its depth.

    Depth cameras have no reading beside outlines; a jump may reach across a gap.
    """
    pixels, depths = [], []
    for turned in (False, True):
        for places, near in _jumps(depth_m.T if turned else depth_m):
            pixels.append(places[:, ::-1] if turned else places)
            depths.append(near)
    found = Outlines(np.concatenate(pixels), np.concatenate(depths))
    some = slice(None, None, max(1, -(-len(found) // MAX_POINTS)))
    return Outlines(found.pixels[some], found.depth_m[some])


def _jumps(depth_m: NDArray[np.float32]) -> Iterator[tuple[Array, Array]]:
    """(pixels (n,2), near depths (n,)) of jumps along rows, for each width of gap."""
    is_gap = np.ones((depth_m.shape[0], depth_m.shape[1] - 1), bool)
    for step in range(1, MAX_GAP_PX + 2):
        a, b = depth_m[:, :-step], depth_m[:, step:]
        near = np.minimum(a, b)
        jump = is_gap & (near > 0) & (np.abs(a - b) > np.maximum(MIN_JUMP_M, MIN_JUMP_SHARE * near))
        rows, columns = np.nonzero(jump)
        is_left = a[jump] < b[jump]
        places: Array = np.stack([np.where(is_left, columns + 0.5, columns + step - 0.5), rows], axis=1).astype(float)
        yield places, near[jump].astype(float)
        is_gap = is_gap[:, :-1] & (depth_m[:, step:-1] == 0)


def color_edge_distance(color: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H,W) float32 distance, px, of each pixel to the nearest edge of colour; at most FAR_PX."""
    smooth = cv2.GaussianBlur(color, (0, 0), 1.0).astype(np.float32)
    dx, dy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    strongest = np.argmax(np.hypot(dx, dy), axis=2)[..., None]
    gx, gy = (np.take_along_axis(d, strongest, axis=2)[..., 0] for d in (dx, dy))
    low, high = np.quantile(np.hypot(gx, gy), CANNY_QUANTILES)
    edges = cv2.Canny(
        np.clip(gx, -32768, 32767).astype(np.int16), np.clip(gy, -32768, 32767).astype(np.int16), float(low),
        float(high),
        L2gradient=True,
    )  # fmt: skip
    distance = cv2.distanceTransform((edges == 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.minimum(distance, FAR_PX).astype(np.float32)


def agreement(distance: NDArray[np.float32], pixels: Array, *, sigma_px: float) -> float:
    """Mean over pixels (n,2) of exp(-d^2 / 2 sigma^2), d their distance to an edge; 0 for pixels outside."""
    seen = np.nan_to_num(pixels, nan=-1e3, posinf=-1e3, neginf=-1e3).astype(np.float32)
    d = sampled(distance, seen[None], outside=1e3)
    return float(np.exp(-0.5 * (d / sigma_px) ** 2).mean())
