"""Cameras as their sensors see: a pinhole and the distortion of its lens.

Everything after registration works on `Camera`, which has no distortion. This is what comes before: raw pictures, and
the map between their pixels and rays. Pixels and axes are those of camera.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.geometry import Array, rotation_about

DistortionModel = Literal["none", "brown-conrady", "kannala-brandt"]
COUNTS: dict[DistortionModel, tuple[int, ...]] = {
    "none": (0,),
    "brown-conrady": (4, 5, 8, 12, 14),
    "kannala-brandt": (4,),
}
# Names of the models in ROS camera_info.
ROS_MODELS: dict[str, DistortionModel] = {
    "plumb_bob": "brown-conrady",
    "rational_polynomial": "brown-conrady",
    "equidistant": "kannala-brandt",
}
# OpenCV's own inversions are fixed-point iterations, which leave the corners of factory-calibrated wide lenses out.
_NEWTON_STEPS = 30
_STEP = 1e-6
_EXACT = 1e-13
# What is left after Newton, on the plane z = 1: a thousandth of a pixel at f = 10,000.
_FOUND = 1e-7


@dataclass(frozen=True, eq=False, slots=True)
class Distortion:
    """What a lens does to points (x/z, y/z) of the plane z = 1.

    brown-conrady: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]], OpenCV's order (ROS plumb_bob and
    rational_polynomial, Kalibr radtan). kannala-brandt: k1 k2 k3 k4 of the angle to the axis (OpenCV fisheye, ROS and
    Kalibr equidistant). none: no coefficients.
    """

    model: DistortionModel = "none"
    coefficients: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if self.model not in COUNTS:
            raise ValueError(f"Distortion.model: expected {', '.join(COUNTS)}, got {self.model!r}")
        coefficients = np.asarray(self.coefficients, dtype=float).ravel()
        counts = COUNTS[self.model]
        if len(coefficients) not in counts or not np.isfinite(coefficients).all():
            raise ValueError(
                f"Distortion.coefficients: {self.model} has {' or '.join(map(str, counts))} finite numbers, "
                f"got {coefficients.tolist()}"
            )
        object.__setattr__(self, "coefficients", coefficients)

    @property
    def is_none(self) -> bool:
        """Whether pixels stay where they are. Kannala-Brandt never is: with zeros it is the equidistant projection."""
        return self.model != "kannala-brandt" and not self.coefficients.any()

    def distorted(self, points: Array) -> Array:
        """Where the lens images points (..., 2) of the plane z = 1, on the same plane."""
        points = np.asarray(points, dtype=float)
        if self.is_none:
            return points
        x, y = points[..., 0], points[..., 1]
        if self.model == "kannala-brandt":
            radius = np.hypot(x, y)
            theta = np.arctan(radius)
            with np.errstate(divide="ignore", invalid="ignore"):
                scale = np.where(radius > 0, theta * polyval(theta**2, self._powers) / radius, 1.0)
            return points * scale[..., None]
        return self._brown_conrady(x, y)

    def _brown_conrady(self, x: Array, y: Array) -> Array:
        """OpenCV, camera calibration and 3D reconstruction, detailed description."""
        c = self.coefficients
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y = (*c, *np.zeros(14 - len(c)))
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        if k4 or k5 or k6:
            radial = radial / (1.0 + square * (k4 + square * (k5 + square * k6)))
        xy = 2.0 * x * y
        u = x * radial + p1 * xy + p2 * (square + 2.0 * x * x)
        v = y * radial + p2 * xy + p1 * (square + 2.0 * y * y)
        if s1 or s2 or s3 or s4:
            u, v = u + square * (s1 + square * s2), v + square * (s3 + square * s4)
        if tau_x or tau_y:
            u, v = _tilted(u, v, tau_x, tau_y)
        return np.stack([u, v], axis=-1)

    def undistorted(self, points: Array) -> Array:
        """The inverse of `distorted`, NaN where it has none: beyond 90 degrees, or where the model folds."""
        wanted = np.asarray(points, dtype=float).reshape(-1, 2)
        if self.is_none or not len(wanted):
            return wanted.reshape(np.shape(points))
        found = self._equidistant(wanted) if self.model == "kannala-brandt" else self._newton(wanted)
        return found.reshape(np.shape(points))

    @property
    def _powers(self) -> Array:
        """Of theta^2 in r(theta) / theta."""
        return np.concatenate([[1.0], self.coefficients])

    def _newton(self, wanted: Array) -> Array:
        """Damped Newton from each point itself; beyond a fold the picture is mirrored or upside down."""
        found = wanted.copy()
        residual = self.distorted(found) - wanted
        for _ in range(_NEWTON_STEPS):
            left = np.flatnonzero(np.abs(residual).max(axis=1) > _EXACT)
            if not len(left):
                break
            step, _ = self._step(found[left], residual[left])
            proposed = found[left] - step
            moved = self.distorted(proposed) - wanted[left]
            worse = ~(np.linalg.norm(moved, axis=1) <= np.linalg.norm(residual[left], axis=1))
            proposed[worse] = found[left][worse] - 0.25 * step[worse]
            moved[worse] = self.distorted(proposed[worse]) - wanted[left][worse]
            found[left], residual[left] = proposed, moved
        _, is_upright = self._step(found, residual)
        lost = ~((np.abs(residual).max(axis=1) < _FOUND) & is_upright)
        found[lost] = np.nan
        return found

    def _step(self, at: Array, residual: Array) -> tuple[Array, NDArray[np.bool_]]:
        """(Newton's step (n,2), whether the Jacobian neither mirrors nor turns round (n,)), central differences."""
        columns = [
            (self.distorted(at + shift) - self.distorted(at - shift)) / (2 * _STEP) for shift in _STEP * np.eye(2)
        ]
        (a, c), (b, d) = columns[0].T, columns[1].T
        determinant = a * d - b * c
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.stack([d * residual[:, 0] - b * residual[:, 1], a * residual[:, 1] - c * residual[:, 0]], axis=1)
            return np.nan_to_num(step / determinant[:, None]), (determinant > 0) & (a + d > 0)

    def _equidistant(self, wanted: Array) -> Array:
        """theta of r = theta (1 + k1 theta^2 + ... + k4 theta^8), then its tangent."""
        radius = np.linalg.norm(wanted, axis=1)
        slopes = self._powers * (2 * np.arange(5) + 1)
        theta = radius.copy()
        for _ in range(_NEWTON_STEPS):
            value, slope = theta * polyval(theta**2, self._powers) - radius, polyval(theta**2, slopes)
            with np.errstate(divide="ignore", invalid="ignore"):
                theta = np.clip(theta - np.nan_to_num(value / slope), 0.0, np.pi)
        residual, slope = theta * polyval(theta**2, self._powers) - radius, polyval(theta**2, slopes)
        ok = (np.abs(residual) < _FOUND) & (slope > 0) & (theta < np.pi / 2 - _STEP)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(radius > 0, np.tan(theta) / radius, 1.0)
        return np.where(ok[:, None], wanted * scale[:, None], np.nan)


def _tilted(u: Array, v: Array, tau_x: float, tau_y: float) -> tuple[Array, Array]:
    """Points of the plane z = 1 on a sensor turned by tau_x and tau_y (Scheimpflug), radians."""
    R = rotation_about(np.array([0.0, 1.0, 0.0]), -tau_y) @ rotation_about(np.array([1.0, 0.0, 0.0]), -tau_x)
    onto = np.array([[R[2, 2], 0.0, -R[0, 2]], [0.0, R[2, 2], -R[1, 2]], [0.0, 0.0, 1.0]]) @ R
    tilted = np.stack([u, v, np.ones_like(u)], axis=-1) @ onto.T
    return tilted[..., 0] / tilted[..., 2], tilted[..., 1] / tilted[..., 2]


def sampled(picture: NDArray[Any], pixels: Array, *, nearest: bool = False, outside: float = 0.0) -> NDArray[Any]:
    """Values of `picture` (H,W) or (H,W,c) at pixels (h,w,2): between four, or the nearest one; `outside` beyond it."""
    u, v = (np.ascontiguousarray(pixels[..., i], dtype=np.float32) for i in (0, 1))
    how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    return np.asarray(cv2.remap(picture, u, v, how, borderMode=cv2.BORDER_CONSTANT, borderValue=(outside,) * 4))


# Whole pixels (h,w,2) int16 and their 32nds (h,w) uint16.
FixedMap = tuple[NDArray[np.int16], NDArray[np.uint16]]


def fixed_map(pixels: Array) -> FixedMap:
    """Pixels (h,w,2) as cv2.remap takes them for 8-bit pictures in half the time, rounded to a 32nd."""
    u, v = (np.ascontiguousarray(pixels[..., i], dtype=np.float32) for i in (0, 1))
    whole, parts = cv2.convertMaps(u, v, cv2.CV_16SC2)
    return np.asarray(whole, np.int16), np.asarray(parts, np.uint16)


NO_DISTORTION = Distortion()


@dataclass(frozen=True, eq=False, slots=True)
class RawCamera:
    """A camera with its lens. camera: K, size and T_camera_world of the raw picture."""

    camera: Camera
    distortion: Distortion = NO_DISTORTION

    def project(self, points_world: Array) -> Array:
        """Raw pixels (..., 2) of points_world (..., 3), metres. Points at z <= 0 give NaN."""
        T = self.camera.T_camera_world
        points_camera = points_world @ T[:3, :3].T + T[:3, 3]
        z = points_camera[..., 2:]
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = np.where(z > 0, points_camera[..., :2] / z, np.nan)
        return self.pixels(plane)

    def pixels(self, points: Array) -> Array:
        """Raw pixels (..., 2) of points (..., 2) of the plane z = 1 in front of the camera."""
        K = self.camera.K
        return self.distortion.distorted(points) @ K[:2, :2].T + K[:2, 2]

    def rays(self, pixels: Array) -> Array:
        """Camera-frame rays (..., 3) with z = 1 through raw pixels (..., 2); NaN where the lens model has none."""
        plane = self.distortion.undistorted(self.camera.rays(np.asarray(pixels, dtype=float))[..., :2])
        return np.concatenate([plane, np.ones_like(plane[..., :1])], axis=-1)

    def backproject(self, pixels: Array, depth_m: Array) -> Array:
        """points_camera (..., 3), metres, of raw pixels (..., 2) with z-depth depth_m (...,)."""
        return self.rays(pixels) * np.asarray(depth_m)[..., None]

    def pixel_map(self, pinhole: Camera) -> Array:
        """(H,W,2) float32 for `sampled`: the raw pixel that each pixel of `pinhole`, at the same place, shows."""
        rows, columns = np.mgrid[: pinhole.height, : pinhole.width]
        rays = pinhole.rays(np.stack([columns, rows], axis=-1).astype(float))
        return self.pixels(rays[..., :2]).astype(np.float32)

    def cropped(self, x: int, y: int, width: int, height: int) -> RawCamera:
        """The camera of the picture's region that begins at pixel (x, y)."""
        return replace(self, camera=self.camera.cropped(x, y, width, height))

    def resized(self, width: int, height: int) -> RawCamera:
        """The camera of the picture resized to width x height, by the half-pixel rule."""
        return replace(self, camera=self.camera.resized(width, height))

    def covering(self, width: int, height: int) -> RawCamera:
        """The camera of the picture scaled evenly until it covers width x height, the overhang cut off on both sides.

        What a device does that delivers another aspect ratio than it was calibrated at (depthai's ImgResizeMode.CROP):
        1280x720 to 640x400 is scaled by 400/720, and 35.6 pixels are cut off left and right.
        """
        return self._centred(max(width / self.camera.width, height / self.camera.height), width, height)

    def letterboxed(self, width: int, height: int) -> RawCamera:
        """The camera of the picture scaled evenly until it fits into width x height, with bars on two sides
        (depthai's ImgResizeMode.LETTERBOX)."""
        return self._centred(min(width / self.camera.width, height / self.camera.height), width, height)

    def _centred(self, scale: float, width: int, height: int) -> RawCamera:
        here = self.camera
        K = here.K.copy()
        K[:2] *= scale
        K[:2, 2] = (here.K[:2, 2] + 0.5) * scale - 0.5
        K[:2, 2] += (np.array([width, height]) - scale * np.array([here.width, here.height])) / 2.0
        return replace(self, camera=replace(here, K=K, width=width, height=height))
