"""What a picture shows of a part that an annotation has placed: its marked pixels and their depth against its box.

Two laws need no model of the object: a part's pixels lie in the silhouette of its box, and its depth in the box. The
first asks for pose and K alone, so that depth may be as noisy as it likes; the second for the unit as well.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.geometry import Array, apply
from page_runtime.sampling import Region

# A mask's border is a pixel off on either side, and edges drawn by hand another.
SILHOUETTE_MARGIN_PX = 2.0
# Depth out of a box by this and by so much of the distance is still in it. True poses of recordings made with the
# scenes' worst stereo cameras have a median of up to 1 % of the distance outside; hinges and rims are models' faults.
BOX_MARGIN_M = 0.01
BOX_MARGIN_SHARE = 0.01
MAX_PIXELS = 2000
# Of fewer pixels nothing can be said.
LEAST_PIXELS = 30

_UNIT_CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))


@dataclass(frozen=True, eq=False, slots=True)
class SeenPart:
    """A part as annotated and as seen.

    place: where it is written, for people. T_camera_box: (4,4), a similarity, from the frame that box (2,3), smallest
    and largest corner, is in. pixels: (n,2) px of at most MAX_PIXELS of its mask. units: (n,) their raw depth, 0 where
    there is none. visible_share: of its silhouette, None where nobody measured it. region: (x,y,w,h) px of its object,
    None where unknown. others: boxes (2,3) in the same frame that it could be instead, by what would be changed.
    """

    place: str
    camera: Camera
    metres_per_unit: float
    T_camera_box: Array
    box: Array
    pixels: Array
    units: Array
    visible_share: float | None = None
    region: Region | None = None
    others: Mapping[str, Array] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether all of it is in the picture and nothing hides any of it, as far as is known."""
        low, high = self.pixels.min(axis=0), self.pixels.max(axis=0)
        inside = (low > 0).all() and high[0] < self.camera.width - 1 and high[1] < self.camera.height - 1
        return bool(inside) and (self.visible_share is None or self.visible_share > 0.95)


def thinned(mask: NDArray[np.bool_], units: NDArray[np.float32]) -> tuple[Array, Array]:
    """pixels (n,2) of mask (H,W) and their raw depth (n,), at most about MAX_PIXELS, the outermost among them."""
    rows, columns = np.nonzero(mask)
    # They say how far the part reaches.
    ends = [] if not len(rows) else [rows.argmin(), rows.argmax(), columns.argmin(), columns.argmax()]
    spread = np.linspace(0, len(rows) - 1, min(len(rows), MAX_PIXELS)).astype(np.intp)
    chosen = np.unique(np.concatenate([spread, np.array(ends, np.intp)]))
    rows, columns = rows[chosen], columns[chosen]
    return np.stack([columns, rows], axis=1).astype(float), units[rows, columns].astype(float)


def outline_px(part: SeenPart, camera: Camera, box: Array | None = None) -> Array | None:
    """(n,2) px, the convex outline of the part's box, or another one, in order; None where it reaches behind the
    camera."""
    low, high = part.box if box is None else box
    corners = apply(part.T_camera_box, low + _UNIT_CORNERS * (high - low))
    if corners[:, 2].min() <= 1e-6:
        return None
    projected = (corners / corners[:, 2:]) @ camera.K.T
    return cv2.convexHull(projected[:, :2].astype(np.float32))[:, 0].astype(float)


def share_in_outline(part: SeenPart, outline: Array) -> float:
    """Of the marked pixels, what lies in the outline (n,2) grown by SILHOUETTE_MARGIN_PX."""
    contour = outline[:, None].astype(np.float32)
    inside = [cv2.pointPolygonTest(contour, (float(u), float(v)), True) for u, v in part.pixels[::4]]
    return float(np.mean(np.array(inside) >= -SILHOUETTE_MARGIN_PX))


def reach_in_outline(part: SeenPart, outline: Array) -> float:
    """Width or height of the marked pixels over the outline's, the larger: 1 for a tight box, seen whole."""
    seen, of_box = np.ptp(part.pixels, axis=0) + 1.0, np.maximum(np.ptp(outline, axis=0), 1.0)
    return float((seen / of_box).max())


def share_outside_region(part: SeenPart) -> float:
    """Of the marked pixels, what lies outside the object's region; 0 where that is unknown."""
    if part.region is None:
        return 0.0
    x, y, w, h = part.region
    low, high = np.array([x, y]) - SILHOUETTE_MARGIN_PX, np.array([x + w, y + h]) - 1 + SILHOUETTE_MARGIN_PX
    return float(((part.pixels < low) | (part.pixels > high)).any(axis=1).mean())


def overlap(part: SeenPart, camera: Camera, box: Array | None = None) -> float:
    """Intersection over union of the rectangles around the marked pixels and around the outline of its box, or of
    another one."""
    outline = outline_px(part, camera, box)
    if outline is None:
        return 0.0
    low = np.stack([part.pixels.min(axis=0) - 0.5, outline.min(axis=0)])
    high = np.stack([part.pixels.max(axis=0) + 0.5, outline.max(axis=0)])
    both = np.maximum(high.min(axis=0) - low.max(axis=0), 0.0).prod()
    return float(both / ((high - low).prod(axis=1).sum() - both))


def share_in_box(
    part: SeenPart, *, camera: Camera | None = None, metres_per_unit: float | None = None, box: Array | None = None
) -> float:
    """Of the marked pixels with depth, what lies in the box grown by the margins; NaN without any or for a matrix that
    cannot be inverted. What is given is taken instead of the part's own."""
    known = part.units > 0
    if not known.any() or abs(np.linalg.det(part.T_camera_box)) < 1e-12:
        return float("nan")
    depth_m = part.units[known] * (part.metres_per_unit if metres_per_unit is None else metres_per_unit)
    points_camera = (camera or part.camera).backproject(part.pixels[known], depth_m)
    low, high = part.box if box is None else box
    points = apply(np.linalg.inv(part.T_camera_box), points_camera)
    # The matrix may carry a scale: distances in the box's frame are divided by it.
    scale = float(np.cbrt(abs(np.linalg.det(part.T_camera_box[:3, :3]))))
    margin = ((BOX_MARGIN_M + BOX_MARGIN_SHARE * depth_m) / scale)[:, None]
    return float(((points >= low - margin) & (points <= high + margin)).all(axis=1).mean())


def with_focal_times(camera: Camera, factor: float) -> Camera:
    """The camera with other focal lengths and the same principal point."""
    return Camera(camera.K * np.array([[factor, factor, 1.0], [factor, factor, 1.0], [1.0, 1.0, 1.0]]), camera.width,
                  camera.height)  # fmt: skip


def with_K_times(camera: Camera, factor: float) -> Camera:
    """The camera with the K of pictures of another size, which is what a K of half or twice the resolution is."""
    K = camera.K * np.array([[factor, factor, factor], [factor, factor, factor], [1.0, 1.0, 1.0]])
    return Camera(K, camera.width, camera.height)
