"""The pinhole camera and its mapping matrix M = K [R | t] (PAGE Eq. 7-11).

OpenCV axes: x right, y down, z forward. Integer pixel coordinates are pixel centres, so resizing by s moves
c to (c + 0.5) s - 0.5.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from page_runtime.geometry import Array, require_rigid


@dataclass(frozen=True, eq=False, slots=True)
class Camera:
    """An undistorted pinhole camera.

    K: (3,3) pixels, no skew expected below the diagonal. width, height: pixels. T_camera_world: (4,4) metres,
    the identity where poses are wanted in the camera frame.
    """

    K: Array
    width: int
    height: int
    T_camera_world: Array = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        K = np.asarray(self.K, dtype=float)
        if K.shape != (3, 3) or not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
            raise ValueError(
                f"Camera.K: expected a finite 3x3 matrix with positive focal lengths, "
                f"got {np.asarray(self.K).tolist()}; "
                "nine numbers in a row may be column-major"
            )
        if max(abs(K[1, 0]), abs(K[2, 0]), abs(K[2, 1]), abs(K[2, 2] - 1.0)) > 1e-9:
            raise ValueError(
                f"Camera.K: expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]], got {K.tolist()}; "
                "it may be stored transposed"
            )
        if self.width <= 0 or self.height <= 0:
            raise ValueError(f"Camera: expected a positive size, got {self.width}x{self.height}")
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "T_camera_world", require_rigid(self.T_camera_world, name="Camera.T_camera_world"))

    @property
    def M(self) -> Array:
        """The mapping matrix (3,4) from homogeneous world points to homogeneous pixels (Eq. 10)."""
        return self.K @ self.T_camera_world[:3]

    def project(self, points_world: Array) -> Array:
        """Pixels (..., 2) of points_world (..., 3) in metres, p' = M p (Eq. 11). Points at z <= 0 give NaN."""
        homogeneous = points_world @ self.M[:, :3].T + self.M[:, 3]
        depth = homogeneous[..., 2:]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(depth > 0, homogeneous[..., :2] / depth, np.nan)

    def rays(self, pixels: Array) -> Array:
        """Camera-frame rays (..., 3) with z = 1 through pixels (..., 2)."""
        y = (pixels[..., 1] - self.K[1, 2]) / self.K[1, 1]
        x = (pixels[..., 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def backproject(self, pixels: Array, depth_m: Array) -> Array:
        """points_camera (..., 3), metres, of pixels (..., 2) with z-depth depth_m (...,)."""
        return self.rays(pixels) * np.asarray(depth_m)[..., None]

    def cropped(self, x: int, y: int, width: int, height: int) -> Camera:
        """The camera of the image region that begins at pixel (x, y); it may reach outside the image."""
        K = self.K.copy()
        K[0, 2] -= x
        K[1, 2] -= y
        return replace(self, K=K, width=width, height=height)

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the image resized to width x height, by the half-pixel rule."""
        sx, sy = width / self.width, height / self.height
        K = self.K.copy()
        K[0, :2] *= sx
        K[0, 2] = (self.K[0, 2] + 0.5) * sx - 0.5
        K[1, 1] *= sy
        K[1, 2] = (self.K[1, 2] + 0.5) * sy - 0.5
        return replace(self, K=K, width=width, height=height)
