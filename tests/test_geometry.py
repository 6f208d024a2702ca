"""Laws of rigid transforms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.geometry import apply, invert, require_rigid, rotation_about, rotation_angle, transform_from

seeds = st.integers(0, 2**32 - 1)


def random_transform(rng: np.random.Generator) -> np.ndarray:
    return transform_from(rotation_about(rng.normal(size=3), rng.uniform(-np.pi, np.pi)), rng.normal(size=3))


@given(seeds)
@settings(max_examples=50, deadline=None)
def test_inverse_undoes_and_composition_is_application(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_a_b, T_b_c, points_c = random_transform(rng), random_transform(rng), rng.normal(size=(7, 3))
    np.testing.assert_allclose(invert(T_a_b) @ T_a_b, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(apply(T_a_b @ T_b_c, points_c), apply(T_a_b, apply(T_b_c, points_c)), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 0.3, 1.5, np.pi - 1e-6, np.pi])
def test_rotation_angle_is_exact_near_zero_and_near_pi(angle: float) -> None:
    rng = np.random.default_rng(3)
    R = rotation_about(rng.normal(size=3), 0.7)
    assert rotation_angle(R, R @ rotation_about(rng.normal(size=3), angle)) == pytest.approx(angle, rel=1e-6, abs=3e-16)


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda T: T * np.diag([1, 1, 1, 1])[:, ::-1], "last row"),
        (lambda T: T @ np.diag([1.1, 1.1, 1.1, 1.0]), "scale"),
        (lambda T: T @ np.diag([1.0, 1.0, -1.0, 1.0]), "determinant -1"),
        (lambda T: T.T, "transposed"),
        (lambda T: T[:3], "4x4"),
        (lambda T: T * np.nan, "finite"),
    ],
)
def test_a_matrix_that_is_not_rigid_is_refused_with_the_reason(spoil, word: str) -> None:
    T = transform_from(rotation_about(np.array([1.0, 2.0, 3.0]), 0.5), np.array([1.0, 2.0, 3.0]))
    assert require_rigid(T, name="T") is not None
    with pytest.raises(ValueError, match=word):
        require_rigid(spoil(T), name="T")
