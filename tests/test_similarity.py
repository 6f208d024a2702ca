"""Similarity transforms: closed-form fit and exponential."""

import numpy as np

from page_runtime.geometry import rotation_angle
from page_runtime.similarity import skew, so3_exp, umeyama
from synthetic_parts import (
    random_rotation,
)


def test_umeyama_recovers_similarities_of_three_or_more_points() -> None:
    rng = np.random.default_rng(0)
    for count in (3, 4, 8):
        source = rng.normal(size=(30, count, 3))
        R = np.array([random_rotation(rng) for _ in range(30)])
        s, t = rng.uniform(0.1, 2.0, 30), rng.normal(size=(30, 3))
        fit = umeyama(source, s[:, None, None] * (source @ R.transpose(0, 2, 1)) + t[:, None])
        np.testing.assert_allclose(fit.R, R, atol=1e-9)
        np.testing.assert_allclose(fit.s, s, rtol=1e-9)
        np.testing.assert_allclose(fit.t, t, atol=1e-9)


def test_umeyama_gives_proper_rotations_also_for_mirrored_points() -> None:
    rng = np.random.default_rng(1)
    source = rng.normal(size=(20, 5, 3))
    fit = umeyama(source, source * [1.0, 1.0, -1.0])
    np.testing.assert_allclose(np.linalg.det(fit.R), 1.0, atol=1e-9)


def test_the_exponential_is_a_rotation_about_its_vector_by_its_length() -> None:
    rng = np.random.default_rng(2)
    vectors = rng.normal(size=(50, 3)) * rng.choice([0.0, 1e-9, 1e-3, 1.0, 2.0], (50, 1))
    R = so3_exp(vectors)
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose((R @ vectors[:, :, None])[:, :, 0], vectors, atol=1e-12)
    np.testing.assert_allclose(R @ so3_exp(-vectors), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    small = 1e-7 * vectors
    np.testing.assert_allclose(so3_exp(small), np.eye(3) + skew(small), atol=1e-12)
    angle = np.linalg.norm(vectors, axis=1)
    folded = np.arccos(np.cos(angle))
    np.testing.assert_allclose(rotation_angle(R, np.broadcast_to(np.eye(3), R.shape)), folded, atol=1e-7)
