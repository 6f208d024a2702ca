"""Sinks behind their queues: nothing slows the loop, every result is counted, a fault is told once."""

from __future__ import annotations

import os
import threading
import time

from hypothesis import given, settings
from hypothesis import strategies as st

from live_results import empty_result
from page_runtime.sinks.json_lines import LineSink
from page_runtime.sinks.queue import EVERY, NEWEST, Sinks
from sink_trials import Script


def test_every_result_reaches_a_sink_in_order_on_one_thread_that_is_not_the_loops() -> None:
    sink = Script()
    with Sinks([(sink, EVERY)]) as sinks:
        for i in range(20):
            sinks.put(empty_result(i))
    assert sink.seen == list(range(20))
    assert (sink.closings, len(sink.threads)) == (1, 1)
    assert threading.get_ident() not in sink.threads
    counts = sinks.counts["script"]
    assert (counts.given, counts.written, counts.dropped, counts.closed) == (20, 20, 0, True)


def test_a_queue_of_one_keeps_the_newest_and_counts_the_others() -> None:
    begun, go_on = threading.Event(), threading.Event()

    def wait(number: int) -> None:
        if number == 1:
            begun.set()
            go_on.wait(10)

    sink = Script(wait)
    with Sinks([(sink, NEWEST)]) as sinks:
        sinks.put(empty_result(0))
        assert begun.wait(10)
        for i in range(1, 50):
            sinks.put(empty_result(i))
        counts = sinks.counts["script"]
        assert (counts.waiting, counts.dropped) == (2, 48)
        go_on.set()
    assert sink.seen == [0, 49]


@settings(deadline=None, max_examples=30)
@given(
    capacity=st.integers(1, 5),
    fates=st.lists(st.sampled_from(["write", "fail", "slow"]), min_size=1, max_size=25),
)
def test_given_is_written_dropped_failed_and_waiting_at_any_time(capacity: int, fates: list[str]) -> None:
    def act(number: int) -> None:
        fate = fates[number - 1]
        if fate == "fail":
            raise RuntimeError("no")
        if fate == "slow":
            time.sleep(0.001)

    told: list[str] = []
    sink = Script(act)
    with Sinks([(sink, capacity)], tell=told.append) as sinks:
        for i in range(len(fates)):
            sinks.put(empty_result(i))
            counts = sinks.counts["script"]
            assert counts.given == i + 1 == counts.written + counts.dropped + counts.failed + counts.waiting
            assert counts.waiting <= capacity + 1
    counts = sinks.counts["script"]
    assert counts.waiting == 0
    assert counts.given == len(fates) == counts.written + counts.dropped + counts.failed
    assert len(sink.seen) == counts.written + counts.failed
    assert sink.seen == sorted(sink.seen)
    assert sink.seen[-1] == len(fates) - 1
    assert sum("loop goes on" in sentence for sentence in told) == (counts.failed > 0)


def test_a_sink_that_always_fails_is_told_of_once_and_the_others_get_everything() -> None:
    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    told: list[str] = []
    bad, good = Script(fail), Script()
    bad.name = "bad"
    with Sinks([(bad, EVERY), (good, EVERY)], tell=told.append) as sinks:
        for i in range(30):
            sinks.put(empty_result(i))
    assert sinks.counts["bad"].failed == 30
    assert sinks.counts["script"].written == 30
    assert [s for s in told if "No space left" in s] == [told[0]]
    assert told[1:] == ["bad: of 30 results 0 written, 0 passed over for newer ones, 30 failed"]
    assert bad.closings == 1


def test_a_sink_that_hangs_costs_the_loop_nothing_and_is_left_behind_in_bounded_time() -> None:
    release = threading.Event()
    hanging, good = Script(lambda _: release.wait(30)), Script()
    hanging.name = "hanging"
    told: list[str] = []
    sinks = Sinks([(hanging, NEWEST), (good, EVERY)], tell=told.append, close_s=0.3)
    with sinks:
        for i in range(30):
            sinks.put(empty_result(i))
        begin = time.monotonic()
    assert time.monotonic() - begin < 5
    release.set()
    assert good.closings == 1
    assert any("hanging: did not close within 0.3 s" in sentence for sentence in told)


def test_results_after_the_end_are_counted_and_go_nowhere() -> None:
    sink = Script()
    with Sinks([(sink, EVERY)]) as sinks:
        pass
    sinks.put(empty_result(0))
    assert sink.seen == []
    assert sinks.counts["script"].dropped == 1


def test_a_reader_that_goes_away_is_told_once_and_the_loop_goes_on() -> None:
    reading, writing = os.pipe()
    told: list[str] = []
    sink = LineSink(writing, name="lines pipe")
    with Sinks([(sink, 100)], tell=told.append, close_s=20) as sinks:
        sinks.put(empty_result(0))
        assert os.read(reading, 1)
        os.close(reading)
        for i in range(50):
            sinks.put(empty_result(i))
    counts = sinks.counts["lines pipe"]
    assert counts.written + counts.failed == 51
    assert counts.failed >= 49
    assert sum("Broken pipe" in sentence for sentence in told) == 1


def test_a_reader_whose_end_is_wanted_ends_the_loop_without_a_word() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    told: list[str] = []
    gone = threading.Event()
    with Sinks([(LineSink(writing, name="pipe"), EVERY)], tell=told.append, reader_gone=gone.set) as sinks:
        sinks.put(empty_result(0))
        assert gone.wait(10)
    assert told == []
    assert sinks.counts["pipe"].failed == 1


def test_a_loop_that_can_wait_loses_no_result_to_a_slow_record_and_none_waits_for_the_newest() -> None:
    record, present = Script(lambda _: time.sleep(0.002)), Script(lambda _: time.sleep(0.002))
    present.name = "present"
    with Sinks([(record, 3), (present, NEWEST)], waits=lambda: True, close_s=20) as sinks:
        for i in range(50):
            sinks.put(empty_result(i))
        sinks.drain()
        assert sinks.counts["script"].waiting <= 1
    assert record.seen == list(range(50))
    assert sinks.counts["script"].dropped == 0
    counts = sinks.counts["present"]
    assert counts.written + counts.dropped == 50


def test_a_loop_that_waits_for_a_sink_that_hangs_can_be_ended() -> None:
    ending, go_on = threading.Event(), threading.Event()
    sink = Script(lambda _: go_on.wait(20))
    threading.Timer(0.2, ending.set).start()
    began_s = time.monotonic()
    with Sinks([(sink, 2)], waits=lambda: not ending.is_set(), close_s=0.2) as sinks:
        for i in range(10):
            sinks.put(empty_result(i))
        assert ending.is_set()
        sinks.drain()
    assert time.monotonic() - began_s < 5.0
    go_on.set()
