"""The synchroniser makes as many frames as can be made, counts everything else, and says when there are none."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from page_runtime.capture.pairing import (
    AT_END,
    CLOCK_BACK,
    NO_PARTNER,
    NO_TIME,
    SILENT,
    TOO_LATE,
    NeverInSync,
    Pairing,
    Stream,
    pair_recorded,
)

Readings = list[tuple[float, Stream, int]]


def recorded(color: list[float], depth: list[float]) -> Readings:
    readings: Readings = [(t, "color", i) for i, t in enumerate(color)]
    for i, t in enumerate(depth):
        readings.append((t, "depth", i))
    return readings


def best_possible(color: list[float], depth: list[float], window_s: float) -> int:
    """The size of a largest matching, by the Hungarian method."""
    if not color or not depth:
        return 0
    allowed = np.abs(np.subtract.outer(color, depth)) <= window_s
    rows, columns = linear_sum_assignment(-allowed.astype(float))
    return int(allowed[rows, columns].sum())


def pairs_of(color: list[float], depth: list[float], window_s: float) -> list[tuple[int, int]]:
    try:
        pairs, counts = pair_recorded(recorded(color, depth), window_s=window_s)
    except NeverInSync:
        return []
    assert counts.color + counts.depth == 2 * counts.paired + sum(counts.unpaired.values())
    assert counts.paired == len(pairs)
    assert counts.max_skew_s <= window_s
    return [(pair.color, pair.depth) for pair in pairs]


def tum_stamps(shared_data: Path) -> tuple[list[float], list[float]]:
    lines = (shared_data / "calib_formats/tum/fr1_xyz_associations.txt").read_text().splitlines()
    rows = [line.split() for line in lines if line.strip()]
    return sorted({float(row[0]) for row in rows}), sorted({float(row[2]) for row in rows})


times = st.lists(st.integers(0, 400), unique=True, max_size=14).map(lambda ms: [t / 1e3 for t in sorted(ms)])


@settings(max_examples=300, deadline=None)
@given(times, times, st.integers(0, 60))
def test_as_many_pairs_as_any_matching_has(color: list[float], depth: list[float], window_ms: int) -> None:
    # Half a millisecond more, so that no distance is exactly the window.
    window_s = window_ms / 1e3 + 5e-4
    pairs = pairs_of(color, depth, window_s)
    assert len(pairs) == best_possible(color, depth, window_s)
    assert all(abs(color[c] - depth[d]) <= window_s for c, d in pairs)
    assert pairs == sorted(pairs)
    assert [d for _, d in pairs] == sorted({d for _, d in pairs})


@settings(max_examples=100, deadline=None)
@given(times, times, st.randoms(use_true_random=False))
def test_which_message_arrives_first_does_not_matter(color: list[float], depth: list[float], random) -> None:
    readings = recorded(color, depth)
    streams = {stream: [r for r in readings if r[1] == stream] for stream in ("color", "depth")}
    order = [stream for _, stream, _ in readings]
    random.shuffle(order)
    shuffled = [streams[stream].pop(0) for stream in order]

    def played(stored: Readings) -> list[tuple[int, int]]:
        pairing: Pairing[int] = Pairing(window_s=0.0205)
        return [(p.color, p.depth) for t, stream, i in stored for p in pairing.push(stream, t, i)]

    assert played(shuffled) == played(readings)


@pytest.mark.parametrize("window_ms", [5, 10, 20, 40])
def test_real_associations_are_paired_as_well_as_possible(shared_data: Path, window_ms: int) -> None:
    color, depth = tum_stamps(shared_data)
    assert len(color) > 700
    assert len(pairs_of(color, depth, window_ms / 1e3)) == best_possible(color, depth, window_ms / 1e3)


def test_real_associations_with_losses_are_paired_as_well_as_possible(shared_data: Path) -> None:
    color, depth = tum_stamps(shared_data)
    rng = np.random.default_rng(0)
    for _ in range(5):
        some = [t for t in color if rng.random() < 0.8], [t for t in depth if rng.random() < 0.7]
        assert len(pairs_of(*some, 0.02)) == best_possible(*some, 0.02)


def test_the_usual_window_pairs_all_of_a_kinect_and_ten_milliseconds_do_not(shared_data: Path) -> None:
    color, depth = tum_stamps(shared_data)
    pairs, counts = pair_recorded(recorded(color, depth))
    assert len(pairs) == len(color) == len(depth) == 792
    assert counts.complete
    assert 0.004 < counts.median_skew_s < 0.009
    assert len(pairs_of(color, depth, 0.01)) < 700


def test_a_pair_has_the_time_of_the_colour_and_the_skew_of_the_depth() -> None:
    (pair,), _ = pair_recorded(recorded([1.0], [1.015]))
    assert (pair.timestamp_s, pair.skew_s) == (1.0, pytest.approx(0.015))


def test_constant_skew_beyond_the_window_is_an_error_that_says_how_far_off(shared_data: Path) -> None:
    color, _ = tum_stamps(shared_data)
    with pytest.raises(
        NeverInSync, match=r"792 colour and 792 depth.*no two within 5 ms; the nearest seen lie \d+\.\d ms"
    ):
        pair_recorded(recorded(color, [t + 3600.0 for t in color]), window_s=0.005)
    pairing: Pairing[int] = Pairing(window_s=0.005, patience=30)
    for i in range(29):
        pairing.push("color", i / 30, i)
        pairing.push("depth", i / 30 + 0.010, i)
    pairing.push("color", 1.0, 30)
    with pytest.raises(NeverInSync, match=r"nearest seen lie 10\.0 ms apart"):
        pairing.push("depth", 1.010, 30)


def test_a_silent_stream_makes_the_other_give_up_its_oldest() -> None:
    pairing: Pairing[int] = Pairing(capacity=5)
    assert not any(pairing.push("color", i / 30, i) for i in range(12))
    assert (pairing.counts.unpaired, pairing.counts.waiting) == ({SILENT: 7}, 5)
    (pair,) = pairing.push("depth", 9 / 30, 9)
    assert pair.color == 9
    assert pairing.finish().unpaired == {SILENT: 7, NO_PARTNER: 2, AT_END: 2}


def test_readings_out_of_order_find_their_partner_while_it_waits() -> None:
    readings: Readings = [(t, "color", i) for i, t in enumerate([0.0, 0.066, 0.033, 0.1])]
    depth: Readings = [(t, "depth", i) for i, t in enumerate([0.0, 0.033, 0.066, 0.1])]
    readings += depth
    pairs, counts = pair_recorded(readings)
    assert [(p.color, p.depth) for p in pairs] == [(0, 0), (2, 1), (1, 2), (3, 3)]
    assert counts.complete
    late: Readings = [(0.0, "color", 0), (0.0, "depth", 0), (0.1, "color", 1), (0.1, "depth", 1), (0.05, "color", 2)]
    assert pair_recorded(late)[1].unpaired == {TOO_LATE: 1}


def test_a_clock_that_is_set_back_costs_what_waited_and_no_more() -> None:
    readings: Readings = []
    for begin in (100.0, 3.0):
        for i in range(30):
            readings.append((begin + i / 30, "color", i))
            readings.append((begin + i / 30 + 0.004, "depth", i))
    pairs, counts = pair_recorded(readings)
    assert len(pairs) == 60
    assert counts.complete
    glitch: Readings = [(10.0, "color", 0), (2.0, "color", 1), (10.033, "color", 2), (10.033, "depth", 0)]
    pairs, counts = pair_recorded(glitch)
    assert [(p.color, p.depth) for p in pairs] == [(2, 0)]
    assert counts.unpaired == {CLOCK_BACK: 1, NO_PARTNER: 1}


@pytest.mark.parametrize("time_s", [math.nan, math.inf, -math.inf])
def test_a_reading_without_a_time_is_left_out_and_counted(time_s: float) -> None:
    pairs, counts = pair_recorded([(time_s, "color", 0), (1.0, "color", 1), (1.0, "depth", 0)])
    assert [p.color for p in pairs] == [1]
    assert counts.unpaired == {NO_TIME: 1}


def test_the_counts_say_in_words_what_was_left_out() -> None:
    _, counts = pair_recorded(recorded([0.0, 0.033, 0.066], [0.004, 0.066]))
    assert str(counts) == (
        f"3 colour and 2 depth readings, 2 frames, skew 2.0 ms in the median, 4.0 at most; left out: 1 {NO_PARTNER}"
    )


def test_nonsense_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="window_s: expected seconds"):
        Pairing(window_s=-1)
    with pytest.raises(ValueError, match="capacity"):
        Pairing(capacity=0)
