"""Training samples of a region as the runtime takes them: one and, of thin objects, another where the first saw them.

What a first look would have seen is made of the truth. A network's labels err, and not point by point: here some of the
object's points are missed, now and then all of a piece, and now and then something beside the object is taken for it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from page_runtime.category import Category
from page_runtime.focus import Focus, focus_on
from page_runtime.frame import RgbdFrame
from page_runtime.neighbours import ANSWERED, LEVELS
from page_runtime.sampling import Region, RegionSample, sample_region, square_region
from page_training.records import IMAGE_SIZE

# Of the object's points, at most this share is missed one by one.
MISSED_SHARE = 0.3
# How often all points of a disc are missed, or taken for the object's, and its radius in sides of the region.
PIECE_PROBABILITY = 0.25
PIECE_RADII = (0.02, 0.15)


def samples_of_region(
    category: Category,
    frame: RgbdFrame,
    region: Region,
    margin: float,
    labels_of: Callable[[RegionSample], NDArray[np.int64]],
    rng: np.random.Generator,
) -> list[RegionSample]:
    """One sample of the region (x, y, w, h px), or two; none where it holds too little depth. margin: as in
    `square_region`. labels_of: for a sample, the part of each point (N,), the number of parts for background."""

    def sampled(focus: Focus | None) -> RegionSample | str:
        return sample_region(
            frame,
            region,
            image_size=IMAGE_SIZE,
            num_points=LEVELS[0],
            radius_m=category.region_radius_m,
            margin=margin,
            focus=focus,
        )

    first = sampled(None)
    if isinstance(first, str):
        return []
    if not category.focused:
        return [first]
    pixels = np.stack(np.divmod(first.source_index, frame.depth_m.shape[1])[::-1], axis=1).astype(np.float32)
    focus = guessed_focus(pixels, labels_of(first), len(category.parts), square_region(region, margin)[2], rng)
    second = None if focus is None else sampled(focus)
    return [first, second] if isinstance(second, RegionSample) else [first]


def guessed_focus(
    pixels: NDArray[np.float32], labels: NDArray[np.int64], num_parts: int, side_px: int, rng: np.random.Generator
) -> Focus | None:
    """Where a network might have seen the object, of points of a square region at pixels (N,2) of the frame; labels
    (N,): the part of each, num_parts for background. None where it would have seen too little."""
    pixels, labels = pixels[:ANSWERED], labels[:ANSWERED]
    on_object = labels < num_parts
    seen = on_object & (rng.random(len(pixels)) > rng.uniform(0.0, MISSED_SHARE))
    for adds, centres in ((False, pixels[on_object]), (True, pixels)):
        if len(centres) and rng.random() < PIECE_PROBABILITY:
            away = np.linalg.norm(pixels - centres[rng.integers(len(centres))], axis=1)
            seen[away < side_px * rng.uniform(*PIECE_RADII)] = adds
    # What is taken for the object is taken for any of its parts.
    named = np.where(on_object, labels, rng.integers(num_parts))
    return focus_on([pixels[seen & (named == part)] for part in range(num_parts)], side_px)
