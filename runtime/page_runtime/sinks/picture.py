"""A result as a picture: the overlay, and a line on how the loop is doing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from page_runtime.live.result import LiveResult
from page_runtime.overlay import draw, write_lines
from page_runtime.recorded import Instance


def picture_of(result: LiveResult) -> NDArray[np.uint8]:
    """(H,W,3) uint8 RGB: the frame's colour with every object drawn over it, and why there is none where there is."""
    picture = draw(result.frame, [(Instance(found.region), found.pose) for found in result.objects])
    if not result.objects:
        write_lines(picture, [result.reason or "no object found"])
    return picture
