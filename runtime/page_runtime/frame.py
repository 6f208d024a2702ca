"""One RGB-D frame: what every source yields and everything else takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera


@dataclass(frozen=True, eq=False, slots=True)
class RgbdFrame:
    """Colour and depth seen by one camera at one time.

    color: (H,W,3) uint8 RGB. depth_m: (H,W) float32 z-depth in metres registered to colour, 0 = no reading.
    camera: the undistorted pinhole of both. timestamp_s: of the colour picture, the source's clock. index: the frame's
    number in its source. skew_s: time of the depth minus time of the colour, 0 where they are one reading.
    """

    color: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    camera: Camera
    timestamp_s: float = 0.0
    index: int = 0
    skew_s: float = 0.0

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        if self.color.dtype != np.uint8 or self.color.ndim != 3 or self.color.shape[2] != 3:
            raise ValueError(
                f"RgbdFrame.color: expected (H,W,3) uint8 RGB, got {self.color.shape} {self.color.dtype}; "
                "convert to 8-bit RGB first"
            )
        if self.depth_m.dtype != np.float32 or self.depth_m.ndim != 2:
            raise ValueError(
                f"RgbdFrame.depth_m: expected (H,W) float32 metres, got {self.depth_m.shape} {self.depth_m.dtype}; "
                "multiply by the depth scale first"
            )
        if self.color.shape[:2] != self.depth_m.shape:
            raise ValueError(
                f"RgbdFrame: colour is {self.color.shape[1]}x{self.color.shape[0]} but depth is "
                f"{self.depth_m.shape[1]}x{self.depth_m.shape[0]}; register depth to colour first"
            )
        if self.color.shape[:2] != size:
            raise ValueError(
                f"RgbdFrame.camera: K is for {size[1]}x{size[0]} but the image is "
                f"{self.color.shape[1]}x{self.color.shape[0]}; use the K of this resolution or Camera.resized"
            )
