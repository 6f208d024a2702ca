"""A pose of a size that the category's parts cannot have is no candidate, whichever place it comes in."""

from __future__ import annotations

import numpy as np
import pytest

from page_runtime.registration import Ambiguous, Observed, Registration, _Attempt, _evidence, _result
from page_runtime.similarity import Similarities

RANGE_M = (0.2, 0.75)


def decided(sizes_m: tuple[float, float]) -> Registration | Ambiguous | str:
    """Of two poses of a part of 0.4 m, alike but for their sizes."""
    rng = np.random.default_rng(0)
    middle = np.array([0.0, 0.0, 0.8])
    points, kappa = rng.normal(size=(60, 3)) * 0.05 + middle, rng.normal(size=(8, 3)) * 0.4
    radii = np.linalg.norm(points[:, None] - (0.4 * kappa + middle), axis=2)
    evidence = _evidence(Observed(points, radii, kappa, (), np.full(3, 3**-0.5), RANGE_M))
    assert not isinstance(evidence, str)
    poses = Similarities(np.stack([np.eye(3)] * 2), np.stack([middle] * 2), np.array(sizes_m))
    return _result(poses, _Attempt(0, evidence, evidence.thinned(50), RANGE_M), 0.97)


@pytest.mark.parametrize("sizes_m", [(0.4, 2.5), (2.5, 0.4)])
def test_of_two_poses_the_one_of_a_possible_size_is_taken(sizes_m: tuple[float, float]) -> None:
    found = decided(sizes_m)
    assert isinstance(found, Registration)
    assert found.scale_m == pytest.approx(0.4)


def test_two_of_a_possible_size_stay_two_and_none_is_a_reason() -> None:
    both = decided((0.4, 0.5))
    assert isinstance(both, Ambiguous)
    assert [pose.scale_m for pose in both.poses] == pytest.approx([0.4, 0.5])
    assert decided((2.5, 0.1)) == "the refined scale 2.5 m is outside 0.2 to 0.75 m"
