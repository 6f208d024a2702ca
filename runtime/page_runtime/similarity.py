"""Batches of similarity transforms x_a = s R x_b + t, their closed-form fit and their rotations'
exponential.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class Similarities:
    """B transforms from a frame in units to metres: R (B, 3, 3) proper, t (B, 3) m, s (B,) m per unit."""

    R: FloatArray
    t: FloatArray
    s: FloatArray

    def __len__(self) -> int:
        return len(self.s)

    def arms(self, points_unit: FloatArray) -> FloatArray:
        """(B, k, 3) m, s R x of points (k, 3): where they are seen from the transformed origin."""
        return self.s[:, None, None] * (points_unit @ self.R.transpose(0, 2, 1))

    def place(self, points_unit: FloatArray) -> FloatArray:
        """(B, k, 3) m, s R x + t of points (k, 3)."""
        return self.arms(points_unit) + self.t[:, None, :]

    def take(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> "Similarities":
        """Those chosen, in that order."""
        return Similarities(self.R[chosen], self.t[chosen], self.s[chosen])

    def moved(self, steps: FloatArray) -> "Similarities":
        """Each moved by (B, 7): rotation vector about its own origin (rad), translation (m), log scale."""
        scaled = self.s * np.exp(steps[:, 6])
        return Similarities(so3_exp(steps[:, :3]) @ self.R, self.t + steps[:, 3:6], scaled)


def so3_exp(rotation_vectors: FloatArray) -> FloatArray:
    """(B, 3) rad to rotations (B, 3, 3) by Rodrigues' formula, accurate at every angle, 0 included."""
    angle = np.sqrt(np.einsum("bk,bk->b", rotation_vectors, rotation_vectors))[:, None, None]
    cross = skew(rotation_vectors)
    # np.sinc is finite and accurate at 0, where sin(a) / a and (1 - cos a) / a^2 are not.
    second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.eye(3) + np.sinc(angle / np.pi) * cross + second * (cross @ cross)


def unit_quaternions(R: FloatArray) -> FloatArray:
    """(B, 3, 3) rotations to unit quaternions (B, 4) w, x, y, z with w >= 0; at w = 0 either sign is as good."""
    # Of the quaternion's four squared components the largest is known best; the others follow from it by products.
    m = R
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    squares = np.stack([trace, *(2.0 * m[:, k, k] - trace for k in range(3))], axis=1)
    products = np.empty((len(R), 4, 4))
    products[:, range(4), range(4)] = 1.0 + squares
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0)), start=1):
        products[:, 0, k] = products[:, k, 0] = m[:, i, j] - m[:, j, i]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        products[:, a + 1, b + 1] = products[:, b + 1, a + 1] = m[:, a, b] + m[:, b, a]
    quaternion = products[np.arange(len(R)), squares.argmax(axis=1)]
    quaternion = quaternion * np.where(quaternion[:, :1] < 0.0, -1.0, 1.0)
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)


def so3_log(R: FloatArray) -> FloatArray:
    """(B, 3, 3) rotations to rotation vectors (B, 3) rad of angle in [0, pi]; at pi either sign is as good."""
    quaternion = unit_quaternions(R)
    sine = np.linalg.norm(quaternion[:, 1:], axis=1)
    half = np.arctan2(sine, quaternion[:, 0])
    return quaternion[:, 1:] * (2.0 / np.maximum(np.sinc(half / np.pi), 1e-30))[:, None]


def inverse_left_jacobian(turn: FloatArray) -> FloatArray:
    """(3, 3) J of a rotation vector (3,) rad, shorter than pi: log(exp(d) exp(turn)) = turn + J d to first order."""
    angle = float(np.linalg.norm(turn))
    cross = skew(turn)
    half = 0.5 * angle
    curl = 1.0 / 12.0 if angle < 1e-4 else (1.0 - half / np.tan(half)) / angle**2
    return np.eye(3) - 0.5 * cross + curl * (cross @ cross)


def skew(vectors: FloatArray) -> FloatArray:
    """(..., 3) to (..., 3, 3), the matrix whose product with w is the cross product v x w."""
    matrix = np.zeros((*vectors.shape, 3))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0] = x, y, z
    matrix[..., 1, 2], matrix[..., 2, 0], matrix[..., 0, 1] = -x, -y, -z
    return matrix


def umeyama(source_unit: FloatArray, target: FloatArray) -> Similarities:
    """Least-squares similarities target = s R source + t of B point sets (Umeyama 1991).

    source_unit: (B, k, 3); target: (B, k, 3) m. k >= 3 and the points of no set collinear: then R is unique
    and proper also for three points or a plane, whose mirror image is a rotation of them.
    """
    source_mean, target_mean = source_unit.mean(axis=1), target.mean(axis=1)
    centred = source_unit - source_mean[:, None]
    U, values, Vt = np.linalg.svd((target - target_mean[:, None]).transpose(0, 2, 1) @ centred)
    sign = np.where(np.linalg.det(U) * np.linalg.det(Vt) < 0.0, -1.0, 1.0)
    U[:, :, 2] *= sign[:, None]
    values[:, 2] *= sign
    R = U @ Vt
    s = values.sum(axis=1) / np.maximum(np.einsum("bki,bki->b", centred, centred), 1e-30)
    t = target_mean - s[:, None] * (R @ source_mean[:, :, None])[:, :, 0]
    return Similarities(R, t, s)
