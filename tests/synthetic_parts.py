"""One visible part of an articulated object with the radii a network would predict, and the truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.template import Template

FloatArray = NDArray[np.float64]

NUM_POINTS = 500


@dataclass(frozen=True, eq=False, slots=True)
class SyntheticPart:
    """points_camera (N, 3) and radii_m (N, n), float32 m; keypoints_unit (n, 3) and extents_unit (3,) in
    diagonals; R (3, 3), t (3,) m, scale_m: x_camera = scale_m R kappa + t; normals_camera (N, 3) of the
    surface."""

    points_camera: NDArray[np.float32]
    radii_m: NDArray[np.float32]
    keypoints_unit: FloatArray
    extents_unit: FloatArray
    R: FloatArray
    t: FloatArray
    scale_m: float
    normals_camera: FloatArray

    @property
    def keypoints_camera(self) -> FloatArray:
        return self.scale_m * self.keypoints_unit @ self.R.T + self.t

    @property
    def sides(self) -> FloatArray:
        """(N, n), the sign of (keypoint - point) . normal, the normal towards the camera."""
        away = self.keypoints_camera - self.points_camera[:, None, :].astype(np.float64)
        return np.sign(np.einsum("njk,nk->nj", away, self.normals_camera))


def random_rotation(rng: np.random.Generator) -> FloatArray:
    Q, upper = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.sign(np.diag(upper))
    return Q * np.sign(np.linalg.det(Q))


def box_extents_m(rng: np.random.Generator) -> FloatArray:
    return rng.uniform(0.15, 0.45, 3)


def plate_extents_m(rng: np.random.Generator) -> FloatArray:
    """A plate without thickness: all its visible points lie exactly in its plane z = 0."""
    return np.array([rng.uniform(0.15, 0.45), rng.uniform(0.15, 0.45), 0.0])


def keypoints_around(rng: np.random.Generator, extents_m: FloatArray, count: int) -> FloatArray:
    """(count, 3) m, canonical frame, 0.1 to 0.4 m off the box and well off a plate's plane, mutually apart."""
    keypoints: list[FloatArray] = []
    while len(keypoints) < count:
        direction = rng.normal(size=3)
        keypoint = direction / np.linalg.norm(direction) * rng.uniform(0.2, 0.65)
        off = float(np.linalg.norm(np.maximum(np.abs(keypoint) - 0.5 * extents_m, 0.0)))
        apart = all(np.linalg.norm(keypoint - other) > 0.15 for other in keypoints)
        if 0.1 <= off <= 0.4 and apart and (extents_m[2] > 0.0 or abs(keypoint[2]) > 0.08):
            keypoints.append(keypoint)
    return np.array(keypoints)


def seen_part(
    rng: np.random.Generator,
    extents_m: FloatArray,
    keypoints_m: FloatArray,
    *,
    sigma_m: float = 0.0,
    outliers: float = 0.0,
    correlated_m: float = 0.0,
    depth_noise_m: float = 0.0,
) -> SyntheticPart:
    """A box of `extents_m` at a random pose 0.8 to 1.6 m before the camera, points on the faces it shows.

    Radii to keypoints_m (n, 3) carry Gaussian noise, a share of outliers uniform in 0.05 to 1 m, and a smooth
    error over the part, which is what a network makes.
    """
    R = random_rotation(rng)
    t = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.8, 1.6)])
    areas = np.prod(extents_m) / np.maximum(extents_m, 1e-9)
    areas = areas if extents_m.min() > 0.0 else np.where(extents_m == 0.0, 1.0, 0.0)
    points, normals = np.empty((0, 3)), np.empty((0, 3))
    while len(points) < NUM_POINTS:
        face = rng.choice(3, 4 * NUM_POINTS, p=areas / areas.sum())
        side = rng.choice([-1.0, 1.0], 4 * NUM_POINTS)
        unit = rng.uniform(-0.5, 0.5, (4 * NUM_POINTS, 3))
        unit[np.arange(len(face)), face] = 0.5 * side
        facing = side[:, None] * R.T[face]
        seen = (unit * extents_m) @ R.T + t
        visible = np.einsum("nk,nk->n", facing, seen) < 0.0
        points, normals = np.concatenate((points, seen[visible])), np.concatenate((normals, facing[visible]))
    points, normals = points[:NUM_POINTS], normals[:NUM_POINTS]
    points = points.astype(np.float32).astype(np.float64)
    radii = np.linalg.norm(points[:, None] - (keypoints_m @ R.T + t), axis=2)
    radii += sigma_m * rng.normal(size=radii.shape)
    waves = rng.normal(size=(3, radii.shape[1])) * 8.0
    radii += correlated_m * np.sqrt(2.0) * np.sin(points @ waves + rng.uniform(0.0, 6.28, radii.shape[1]))
    radii = np.where(rng.random(radii.shape) < outliers, rng.uniform(0.05, 1.0, radii.shape), np.abs(radii))
    points += depth_noise_m * rng.normal(size=points.shape)
    scale_m = float(np.linalg.norm(extents_m))
    return SyntheticPart(
        points.astype(np.float32),
        radii.astype(np.float32),
        keypoints_m / scale_m,
        extents_m / scale_m,
        R,
        t,
        scale_m,
        normals,
    )


def box_template(extents_unit: np.ndarray, side: int = 9) -> Template:
    """A grid of side x side samples on each face of a box."""
    steps = (np.arange(side) + 0.5) / side - 0.5
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    points, normals = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            points.append(np.insert(grid, axis, 0.5 * sign, axis=1) * extents_unit)
            normals.append(np.tile(sign * np.eye(3)[axis], (len(grid), 1)))
    return Template(np.concatenate(points), np.concatenate(normals), np.asarray(extents_unit))
