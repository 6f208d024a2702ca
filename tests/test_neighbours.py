"""The neighbour search finds the nearest points, whatever their number and order."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.neighbours import LEVELS, find_neighbours, nearest


@pytest.mark.parametrize("count", [1, 3, 4, 5, 16])
@settings(max_examples=15, deadline=None)
@given(queries=st.integers(1, 700), points=st.sampled_from([16, 17, 255, 256, 257, 512, 2048]), seed=st.integers(0, 99))
def test_nearest_finds_what_a_full_sort_finds(count: int, queries: int, points: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    cloud = rng.normal(0.0, 0.25, (points, 3)).astype(np.float32)
    asked = rng.normal(0.0, 0.25, (queries, 3)).astype(np.float32)
    found = nearest(asked, cloud, count)
    assert found.shape == (queries, count)
    assert found.dtype == np.int32
    assert all(len(set(row)) == count for row in found.tolist())
    squared = ((asked[:, None].astype(float) - cloud[None]) ** 2).sum(axis=2)
    ours = np.sort(np.take_along_axis(squared, found.astype(int), axis=1), axis=1)
    best = np.sort(squared, axis=1)[:, :count]
    # Ties: distances equal to within 2^-11 of their value, and what float32 leaves of differences.
    np.testing.assert_allclose(ours, best, rtol=2.0**-11, atol=1e-6)


def test_of_points_in_one_place_the_first_are_taken() -> None:
    cloud = np.zeros((512, 3), np.float32)
    for count in (3, 16):
        found = nearest(cloud[:5], cloud, count)
        np.testing.assert_array_equal(np.sort(found, axis=1), np.tile(np.arange(count), (5, 1)))


def test_a_second_thread_changes_no_table_and_is_not_waited_for() -> None:
    points = np.random.default_rng(0).normal(0.0, 0.25, (LEVELS[0], 3)).astype(np.float32)
    alone = find_neighbours(points)
    with ThreadPoolExecutor(1) as beside:
        free = threading.Event()
        shared = [find_neighbours(points, beside=beside) for _ in range(20)]
        beside.submit(free.wait)
        late = find_neighbours(points, beside=beside)
        free.set()
    for found in (*shared, late):
        for table in fields(alone):
            np.testing.assert_array_equal(
                np.sort(getattr(found, table.name), axis=1), np.sort(getattr(alone, table.name), axis=1)
            )
