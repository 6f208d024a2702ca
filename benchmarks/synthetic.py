"""Parts as a depth camera sees them, with the radii a network would predict for them, and the truth.

A part is a union of boxes and cylinders of 0.2 to 0.6 m; the rays of a pinhole camera hit its near side only. Radii
carry independent noise, gross outliers and, where wanted, an error that is smooth over the part, which is what a
network really makes.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tests.synthetic_parts import SyntheticPart, random_rotation

FloatArray = NDArray[np.float64]

SHAPES = ("box", "cylinder", "plate", "scissors")
# Distance of a keypoint from the part's box, m; "far" is the regime of the radii in Table X of the paper.
KEYPOINT_DISTANCE_M = {"near": (0.10, 0.25), "mid": (0.20, 0.45), "far": (0.55, 0.70)}
NUM_KEYPOINTS = 8
NUM_VOTED = 3

_SMALLEST_RASTER = 128
_APART_M = 0.12
_WAVES = 4


@dataclass(frozen=True, slots=True)
class Noise:
    """Of radii: sigma_m independent, outliers a share, correlated_m standard deviation of a smooth error. Of points:
    depth_m along the ray."""

    sigma_m: float = 0.005
    outliers: float = 0.15
    correlated_m: float = 0.0
    depth_m: float = 0.001


EXACT = Noise(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Solid:
    """A box, or a cylinder about z, along the part's axes: center and half extents (3,) m; a cylinder's radius is
    half[0]."""

    center: FloatArray
    half: FloatArray
    round: bool = False


def solids_of(shape: str, rng: np.random.Generator) -> list[Solid]:
    """A part of one of SHAPES at a random size; its bounding box is centred at the origin."""
    length = rng.uniform(0.2, 0.6)
    origin = np.zeros(3)
    if shape == "box":
        return [Solid(origin, 0.5 * length * np.array([1.0, *rng.uniform(0.35, 0.9, 2)]))]
    if shape == "cylinder":
        radius = length * rng.uniform(0.15, 0.35)
        return [Solid(origin, np.array([radius, radius, 0.5 * length]), round=True)]
    if shape == "plate":
        return [Solid(origin, np.array([0.5 * length, 0.5 * length * rng.uniform(0.5, 0.9), 0.002]))]
    if shape == "scissors":
        # One of its two parts: a blade that ends in a disc for the fingers, off the blade's line.
        handle, blade, thickness = 0.1 * length, 0.03 * length, 0.01 * length
        low = np.array([-0.5 * length, -handle, -thickness])
        blade_half = np.array([0.5 * length - 0.5 * handle, blade, thickness])
        disc_half = np.array([handle, handle, thickness])
        disc_low = np.array([0.5 * length - 2.0 * handle, low[1], -thickness])
        return [Solid(low + blade_half, blade_half), Solid(disc_low + disc_half, disc_half, round=True)]
    raise ValueError(f"shape: expected one of {', '.join(SHAPES)}, got {shape!r}")


def make_part(
    shape: str,
    distance: str,
    num_points: int,
    noise: Noise,
    *,
    geometry: np.random.Generator,
    errors: np.random.Generator,
) -> SyntheticPart:
    """A part 0.8 to 1.6 m before the camera. `geometry` decides part, pose, keypoints and the points seen, `errors`
    everything else, so that the same part can be had with other noise."""
    solids = solids_of(shape, geometry)
    extents_m = _extents(solids)
    keypoints_m = _keypoints(geometry, extents_m, *KEYPOINT_DISTANCE_M[distance])
    while True:
        R = random_rotation(geometry)
        t = np.array([*geometry.uniform(-0.2, 0.2, 2), geometry.uniform(0.8, 1.6)])
        # Edge on, a camera would not see enough of a thin part to segment it.
        if extents_m[2] > 0.1 * extents_m[0] or abs(R[:, 2] @ t) > 0.3 * np.linalg.norm(t):
            break
    rays, depth, normals = _seen(geometry, solids, extents_m, R, t, num_points)
    points = (rays * depth[:, None]).astype(np.float32).astype(np.float64)
    radii = np.linalg.norm(points[:, None] - (keypoints_m @ R.T + t), axis=2)
    limit_m = 1.25 * radii.max(axis=0)
    radii += noise.sigma_m * errors.normal(size=radii.shape)
    radii += noise.correlated_m * _smooth_field(errors, points, radii.shape[1])
    outlier = errors.random(radii.shape) < noise.outliers
    radii = np.where(outlier, limit_m * errors.random(radii.shape), np.maximum(radii, 0.0))
    points += noise.depth_m * errors.normal(size=(len(points), 1)) * rays
    scale_m = float(np.linalg.norm(extents_m))
    return SyntheticPart(
        points_camera=points.astype(np.float32),
        radii_m=radii.astype(np.float32),
        keypoints_unit=keypoints_m / scale_m,
        extents_unit=extents_m / scale_m,
        R=R,
        t=t,
        scale_m=scale_m,
        normals_camera=normals @ R.T,
    )


def suite(
    count: int, distance: str, num_points: int, noise: Noise, *, seed: int, shapes: tuple[str, ...] = SHAPES
) -> list[SyntheticPart]:
    """`count` parts, the shapes in turn. Part i of a seed has the same surface, pose and keypoints under any noise."""
    return [
        make_part(
            shapes[i % len(shapes)],
            distance,
            num_points,
            noise,
            geometry=np.random.default_rng([seed, i, 0]),
            errors=np.random.default_rng([seed, i, 1]),
        )
        for i in range(count)
    ]


def _extents(solids: list[Solid]) -> FloatArray:
    low = np.min([solid.center - solid.half for solid in solids], axis=0)
    high = np.max([solid.center + solid.half for solid in solids], axis=0)
    return high - low


def _keypoints(rng: np.random.Generator, extents_m: FloatArray, nearest_m: float, farthest_m: float) -> FloatArray:
    """(NUM_KEYPOINTS, 3) m, canonical frame, so far off the part's box; the voted ones form a fair triangle."""
    reach_m = farthest_m + 0.5 * float(np.linalg.norm(extents_m))
    while True:
        keypoints: list[FloatArray] = []
        while len(keypoints) < NUM_KEYPOINTS:
            keypoint = rng.uniform(-reach_m, reach_m, 3)
            off_m = np.linalg.norm(np.maximum(np.abs(keypoint) - 0.5 * extents_m, 0.0))
            apart = all(np.linalg.norm(keypoint - other) > _APART_M for other in keypoints)
            if nearest_m <= off_m <= farthest_m and apart:
                keypoints.append(keypoint)
        if _smallest_angle(keypoints[:NUM_VOTED]) > math.radians(20.0):
            return np.array(keypoints)


def _smallest_angle(corners: list[FloatArray]) -> float:
    angles = []
    for i in range(3):
        a, b = corners[i - 1] - corners[i], corners[i - 2] - corners[i]
        angles.append(math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b)))
    return min(angles)


def _seen(
    rng: np.random.Generator, solids: list[Solid], extents_m: FloatArray, R: FloatArray, t: FloatArray, num_points: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rays (N, 3) with z = 1, depths (N,) m where they first meet the part, and its normals (N, 3) there, canonical."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * extents_m @ R.T + t
    image = corners[:, :2] / corners[:, 2:]
    low, high = image.min(axis=0), image.max(axis=0)
    side = _SMALLEST_RASTER
    while True:
        u, v = (np.linspace(low[k], high[k], side + 2)[1:-1] for k in (0, 1))
        rays = np.stack((*np.meshgrid(u, v, indexing="ij"), np.ones((side, side))), axis=-1).reshape(-1, 3)
        depth, normals = _first_hit(solids, -t @ R, rays @ R)
        hit = np.flatnonzero(np.isfinite(depth))
        if len(hit) >= num_points:
            chosen = rng.permutation(hit)[:num_points]
            return rays[chosen], depth[chosen], normals[chosen]
        side *= 2


def _first_hit(solids: list[Solid], eye: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(M,) multiples of the rays (M, 3) from the eye (3,) to the nearest solid, inf for none; normals (M, 3)."""
    depth, normals = np.full(len(rays), np.inf), np.zeros(rays.shape)
    for solid in solids:
        entry, normal = _entry(solid, eye - solid.center, rays)
        nearer = entry < depth
        depth[nearer], normals[nearer] = entry[nearer], normal[nearer]
    return depth, normals


def _entry(solid: Solid, eye: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """As `_first_hit`, of one solid, the eye given from its centre: where the ray has entered all slabs, left none."""
    safe = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    ends = np.stack(((-solid.half - eye) / safe, (solid.half - eye) / safe))
    enters, leaves = ends.min(axis=0), ends.max(axis=0)
    if solid.round:
        # The cylinder's wall takes the place of the slabs in x and y.
        a = np.maximum(np.einsum("mk,mk->m", rays[:, :2], rays[:, :2]), 1e-24)
        b, c = rays[:, :2] @ eye[:2], eye[:2] @ eye[:2] - solid.half[0] ** 2
        root = np.sqrt(np.where(b * b > a * c, b * b - a * c, np.nan))
        enters, leaves = enters[:, 1:].copy(), leaves[:, 1:].copy()
        enters[:, 0], leaves[:, 0] = (-b - root) / a, (-b + root) / a
    axis = enters.argmax(axis=1)
    entry = enters.max(axis=1)
    entry = np.where((entry <= leaves.min(axis=1)) & (entry > 0.0), entry, np.inf)
    if not solid.round:
        return entry, -np.sign(rays) * (np.arange(3) == axis[:, None])
    normals = np.zeros(rays.shape)
    wall, hit = axis == 0, np.isfinite(entry)
    at = eye[:2] + np.where(hit, entry, 0.0)[:, None] * rays[:, :2]
    normals[wall, :2] = at[wall] / solid.half[0]
    normals[~wall, 2] = -np.sign(rays[~wall, 2])
    return entry, normals


def _smooth_field(rng: np.random.Generator, points: FloatArray, count: int) -> FloatArray:
    """(N, count), fields of variance 1 over space: waves of 0.15 to 0.6 m length in random directions."""
    directions = rng.normal(size=(_WAVES, count, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    wave_numbers = 2.0 * np.pi / rng.uniform(0.15, 0.6, (_WAVES, count, 1)) * directions
    phases = rng.uniform(0.0, 2.0 * np.pi, (_WAVES, count))
    waves = np.sin(np.einsum("nk,wck->nwc", points, wave_numbers) + phases)
    return math.sqrt(2.0 / _WAVES) * waves.sum(axis=1)
