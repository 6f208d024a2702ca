"""From frame and region to points: real readings, evenly spread, nothing invented."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.camera import Camera
from page_runtime.frame import RgbdFrame
from page_runtime.neighbours import LEVELS, find_neighbours, nearest
from page_runtime.sampling import RegionSample, progressive_order, sample_region, square_region

CAMERA = Camera(np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]), 640, 480)


def frame_of(depth: np.ndarray) -> RgbdFrame:
    color = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    return RgbdFrame(color, depth.astype(np.float32), CAMERA)


def sampled(depth: np.ndarray, region=(200, 150, 240, 180), **changes) -> RegionSample | str:
    return sample_region(frame_of(depth), region, **{"image_size": 224, "num_points": 2048, "radius_m": 0.6, **changes})


@pytest.mark.parametrize("side", [7, 64, 224])
def test_progressive_order_visits_every_pixel_once_and_every_prefix_evenly(side: int) -> None:
    rows, columns = np.divmod(progressive_order(side), side)
    assert len(set(zip(rows.tolist(), columns.tolist(), strict=True))) == side * side
    if side == 224:
        for count in LEVELS[:3]:
            cells = np.histogram2d(rows[:count], columns[:count], bins=4, range=[[0, side]] * 2)[0]
            assert cells.min() >= 0.6 * count / 16
            assert cells.max() <= 1.4 * count / 16


@given(st.integers(-50, 600), st.integers(-50, 440), st.integers(60, 500), st.integers(60, 400))
@settings(max_examples=40, deadline=None)
def test_every_point_is_a_reading_at_its_own_pixel(x: int, y: int, w: int, h: int) -> None:
    if x >= 640 or y >= 480 or x + w <= 0 or y + h <= 0:
        return
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.95, 1.05, (480, 640)) * (rng.random((480, 640)) > 0.2)
    sample = sampled(depth, (x, y, w, h), radius_m=3.0)
    if isinstance(sample, str):
        return
    v, u = np.divmod(sample.source_index, 640)
    np.testing.assert_allclose(sample.points_camera[:, 2], depth[v, u], rtol=1e-6)
    np.testing.assert_allclose(CAMERA.project(sample.points_camera), np.stack([u, v], 1), atol=1e-3)
    np.testing.assert_allclose(sample.camera.project(sample.points_camera), sample.pixels, atol=1e-3)
    left, top, side, _ = square_region((x, y, w, h))
    assert ((u >= left) & (u < left + side) & (v >= top) & (v < top + side)).all()
    assert len(np.unique(sample.source_index[: sample.num_distinct])) == min(sample.num_distinct, 2048)


def test_background_by_distance_is_left_out_and_the_object_kept() -> None:
    depth = np.full((480, 640), 3.0)
    depth[180:300, 240:400] = 1.0
    sample = sampled(depth)
    assert isinstance(sample, RegionSample)
    assert (sample.points_camera[:, 2] == 1.0).all()


def test_a_thin_object_before_a_far_wall_is_what_is_sampled() -> None:
    """An upright lid seen from the side: a third of its own box, the rest wall."""
    depth = np.full((480, 640), 3.0)
    depth[150:330, 200:280] = 1.0
    sample = sampled(depth)
    assert isinstance(sample, RegionSample)
    assert set(sample.points_camera[:, 2].tolist()) == {1.0}
    depth[150:330, 200:280] = 2.5  # within reach of the wall: then the wall stays
    sample = sampled(depth)
    assert isinstance(sample, RegionSample)
    assert {2.5, 3.0} == set(sample.points_camera[:, 2].tolist())


def test_of_two_things_the_other_one_can_be_asked_for() -> None:
    depth = np.full((480, 640), 1.5)
    depth[150:330, 340:440] = 0.5  # an arm before a part of the object
    near = sampled(depth)
    assert isinstance(near, RegionSample)
    assert set(near.points_camera[:, 2].tolist()) == {0.5}
    assert near.other_depth_m == 1.5
    far = sampled(depth, depth_m=near.other_depth_m)
    assert isinstance(far, RegionSample)
    assert set(far.points_camera[:, 2].tolist()) == {1.5}
    assert far.other_depth_m is None
    alone = sampled(np.full((480, 640), 1.5))
    assert isinstance(alone, RegionSample)
    assert alone.other_depth_m is None


def test_few_readings_are_repeated_in_order_and_counted() -> None:
    depth = np.zeros((480, 640))
    depth[230:240, 300:320] = 1.0
    sample = sampled(depth)
    assert isinstance(sample, RegionSample)
    assert sample.num_distinct < 2048
    np.testing.assert_array_equal(
        sample.source_index[: sample.num_distinct],
        sample.source_index[sample.num_distinct : 2 * sample.num_distinct],
    )


@pytest.mark.parametrize("depth", [np.zeros((480, 640)), np.full((480, 640), np.nan)])
def test_no_valid_depth_is_a_reason(depth: np.ndarray) -> None:
    assert "not seen" in str(sampled(depth))


@pytest.mark.parametrize("region", [(640, 0, 10, 10), (0, -20, 10, 20), (0, 0, 0, 10)])
def test_a_region_outside_the_image_is_refused(region) -> None:
    with pytest.raises(ValueError, match="region"):
        sampled(np.ones((480, 640)), region)


@given(st.integers(0, 2**32 - 1), st.integers(1, 16))
@settings(max_examples=40, deadline=None)
def test_nearest_equals_brute_force_up_to_near_ties(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(int(rng.integers(count, 300)), 3)).astype(np.float32)
    queries = rng.normal(size=(40, 3)).astype(np.float32)
    distance = np.linalg.norm(queries[:, None].astype(float) - points, axis=2) ** 2
    found = nearest(queries, points, count)
    reached = np.sort(np.take_along_axis(distance, found.astype(int), axis=1), axis=1)
    np.testing.assert_allclose(reached, np.sort(distance, axis=1)[:, :count], rtol=2e-3, atol=1e-5)
    assert all(len(set(row)) == count for row in found.tolist())


def test_a_point_is_its_own_neighbour_at_every_level() -> None:
    points = np.random.default_rng(0).normal(size=(LEVELS[0], 3)).astype(np.float32) * np.float32(0.2)
    tables = find_neighbours(points)
    for table, count in ((tables.group1, LEVELS[1]), (tables.group2, LEVELS[2]), (tables.group3, LEVELS[3])):
        assert (table == np.arange(count)[:, None]).any(axis=1).all()


def test_a_second_thread_finds_the_same_neighbours() -> None:
    points = np.random.default_rng(3).normal(size=(LEVELS[0], 3)).astype(np.float32)
    alone = find_neighbours(points)
    with ThreadPoolExecutor(1) as beside:
        together = find_neighbours(points, beside=beside)
    for name in ("group1", "group2", "group3", "up1", "up2", "up3"):
        assert np.array_equal(getattr(alone, name), getattr(together, name)), name
