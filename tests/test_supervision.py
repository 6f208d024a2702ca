"""A camera library in a child process: whatever it dies of, the application gets frames, or a reason."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import psutil
import pytest

import live_sources
from page_runtime.capture.child_process import ChildEnd, ChildProcess, pickled
from page_runtime.capture.events import SourceDied, SourceEnded, SourceRunning, SourceStalled, SourceStarted
from page_runtime.capture.frame_ring import SLOTS, RingReader, RingWriter
from page_runtime.capture.frame_service import DeviceUnavailable
from page_runtime.capture.patience import Patience
from page_runtime.capture.supervision import SUPERSEDED, SourceLost, SupervisedSource
from page_runtime.image_files import SourceError
from page_runtime.recorded import RecordedFrame

HASTY = Patience(stalled_s=0.4, restart_s=1.0, first_pause_s=0.05, give_up_s=30.0)
TESTS = Path(__file__).parent


def check_pixels(recorded: RecordedFrame) -> int:
    """The number of the frame, after a look whether all of it is of one frame."""
    frame = recorded.frame
    number = round(frame.timestamp_s / live_sources.PERIOD_S)
    assert (frame.color == number % 251).all()
    np.testing.assert_array_equal(frame.depth_m, np.float32((1000 + number) * 1e-3))
    return number


def take(source: SupervisedSource, frames: int) -> list[int]:
    numbers = []
    for recorded in source:
        numbers.append(check_pixels(recorded))
        if len(numbers) == frames:
            break
    return numbers


def open_shared_memory() -> set[str]:
    """What is in the machine's shared memory, but for what processes have open that are not of this test: others run
    beside it. What nobody has open was left behind."""
    folder = Path("/dev/shm")
    if not folder.is_dir():
        return set()
    mine = {os.getpid(), *(child.pid for child in psutil.Process().children(recursive=True))}
    others = set[str]()
    entries = {entry.name for entry in folder.iterdir()}
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.pid not in mine:
                others |= {
                    Path(mapped.path).name for mapped in process.memory_maps() if mapped.path.startswith(str(folder))
                }
    return {name for name in entries - others if (folder / name).exists()}


def children() -> list[psutil.Process]:
    return [child for child in psutil.Process().children() if child.status() != psutil.STATUS_ZOMBIE]


def test_frames_arrive_whole_in_order_and_all_are_accounted_for() -> None:
    with SupervisedSource(live_sources.count_up, name="test") as source:
        numbers = take(source, 20)
        time.sleep(0.2)
        numbers += take(source, 5)
    assert numbers == sorted(set(numbers))
    counts = source.counts
    assert counts.dropped[SUPERSEDED] >= 5
    assert counts.color == counts.depth == counts.paired
    assert counts.paired - sum(counts.dropped.values()) - 25 in (0, 1)  # the newest may still have waited
    assert [type(event) for event in source.events] == [SourceStarted, SourceRunning]


def test_a_slow_consumer_gets_the_newest_frame_not_the_oldest() -> None:
    with SupervisedSource(live_sources.count_up, name="test") as source:
        (first,) = take(source, 1)
        time.sleep(0.5)
        (second,) = take(source, 1)
    assert second - first > 15


def test_a_source_that_ends_ends_the_iteration() -> None:
    with SupervisedSource(partial(live_sources.count_up, frames=7), name="test") as source:
        numbers = [check_pixels(recorded) for recorded in source]
        assert numbers[-1] == 6
        assert isinstance(source.events[-1], SourceEnded)
        assert list(source) == []


def test_three_deaths_by_signal_are_three_counted_outages_under_five_seconds(tmp_path: Path) -> None:
    signals = (signal.SIGSEGV, signal.SIGABRT, signal.SIGKILL)
    factory = partial(live_sources.kill_itself, folder=str(tmp_path), signals=signals, after=10)
    before = open_shared_memory()
    with SupervisedSource(factory, name="test", patience=HASTY) as source:
        deadline = time.monotonic() + 20
        for recorded in source:
            check_pixels(recorded)
            assert time.monotonic() < deadline
            if len(source.outages_s) == 3:
                break
    deaths = [event.reason for event in source.events if isinstance(event, SourceDied)]
    assert deaths == [f"killed by {number.name}" for number in signals]
    assert all(0 < outage < 5 for outage in source.outages_s)
    assert [event.attempt for event in source.events if isinstance(event, SourceStarted)] == [1, 2, 3, 4]
    assert open_shared_memory() <= before


def test_a_real_segmentation_fault_is_survived() -> None:
    with SupervisedSource(live_sources.read_null_pointer, name="test", patience=HASTY) as source:
        take(source, 5)
        assert any(isinstance(event, SourceDied) and event.reason == "killed by SIGSEGV" for event in source.events)


def test_a_stall_is_reported_within_a_second_and_the_process_replaced(tmp_path: Path) -> None:
    told: list[tuple[float, object]] = []
    factory = partial(live_sources.stall, folder=str(tmp_path), frames=5)
    with SupervisedSource(
        factory, name="test", patience=HASTY, on_event=lambda event: told.append((time.monotonic(), event))
    ) as source:
        last_s = 0.0
        for number, _ in enumerate(source):
            if number and not source.outages_s:
                last_s = time.monotonic()
            if source.outages_s:
                break
    stalled_s, event = next((at, event) for at, event in told if isinstance(event, SourceStalled))
    assert stalled_s - last_s < 1.0
    assert isinstance(event, SourceStalled)
    assert event.age_s > HASTY.stalled_s
    assert any(isinstance(event, SourceDied) and "stalled for" in event.reason for _, event in told)


@pytest.mark.parametrize(
    ("kind", "error", "match"),
    [
        ("absent", DeviceUnavailable, "plug one in"),
        ("wrong", SourceError, "never in sync"),
        ("crash", SourceLost, r"lost after \d starts.*RuntimeError: X_LINK_ERROR; it wrote: the library's last words"),
    ],
)
def test_an_error_that_a_new_start_cannot_mend_is_raised(kind: str, error: type[SourceError], match: str) -> None:
    with (
        SupervisedSource(partial(live_sources.fail, kind=kind), name="test", patience=HASTY) as source,
        pytest.raises(error, match=match),
    ):
        next(iter(source))


def test_a_callback_that_fails_is_an_error_of_the_source_and_leaves_no_child() -> None:
    def fail(_: object) -> None:
        raise RuntimeError("the application's own fault")

    before = len(children())
    with SupervisedSource(live_sources.count_up, name="test", on_event=fail) as source:
        with pytest.raises(SourceLost, match="RuntimeError: the application's own fault"):
            next(iter(source))
        assert len(children()) == before


def test_a_frame_larger_than_the_first_is_a_failure_not_a_corruption() -> None:
    with SupervisedSource(live_sources.grow, name="test", patience=HASTY) as source:
        seen = [recorded.frame.camera.width for recorded, _ in zip(source, range(2), strict=False)]
        assert set(seen) == {live_sources.WIDTH}
        assert any("no larger than the first" in str(event) for event in source.events)


def test_a_source_that_a_child_could_not_import_is_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="expected a function of a module"):
        SupervisedSource(lambda _: iter(()), name="test")
    monkeypatch.setattr(live_sources.count_up, "__module__", "__main__")
    monkeypatch.setattr(sys.modules["__main__"], "count_up", live_sources.count_up, raising=False)
    with pytest.raises(ValueError, match="move it into a module that can be imported"):
        SupervisedSource(live_sources.count_up, name="test")


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="descriptors are counted in /proc")
def test_starting_and_stopping_again_and_again_leaves_nothing_behind() -> None:
    def cycle() -> None:
        with SupervisedSource(live_sources.count_up, name="test") as source:
            take(source, 2)

    def state() -> tuple[int, int, int]:
        return len(list(Path("/proc/self/fd").iterdir())), threading.active_count(), len(children())

    for _ in range(2):
        cycle()
    before, memory, shared = state(), psutil.Process().memory_info().rss, open_shared_memory()
    for _ in range(10):
        cycle()
    assert state() == before
    assert open_shared_memory() <= shared
    assert psutil.Process().memory_info().rss - memory < 20e6


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_an_application_that_dies_takes_its_child_and_the_memory_with_it(number: signal.Signals) -> None:
    code = (
        "import sys, live_sources\nfrom page_runtime.capture.supervision import SupervisedSource\n"
        "source = SupervisedSource(live_sources.count_up, name='test')\n"
        "next(iter(source))\nprint(source.events[0].pid, flush=True)\nsys.stdin.read()"
    )
    before = open_shared_memory()
    application = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS), *sys.path])},
    )
    assert application.stdout is not None
    child = psutil.Process(int(application.stdout.readline()))
    application.send_signal(number)
    application.wait()
    wait_until(lambda: not child.is_running() or child.status() == psutil.STATUS_ZOMBIE)
    # The application's resource tracker clears up after it, and takes a moment.
    wait_until(lambda: open_shared_memory() <= before, seconds=20)
    application.stdout.close()
    assert application.stdin is not None
    application.stdin.close()


def wait_until(condition: Callable[[], bool], *, seconds: float = 5.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def memory_of_ring() -> tuple[RingWriter, RingReader, int]:
    memory = os.memfd_create("test")
    return RingWriter(memory), RingReader(memory), memory


@pytest.mark.parametrize("metres_per_unit", [1e-3, 1e-4, None])
def test_the_ring_gives_back_what_was_written(metres_per_unit: float | None) -> None:
    writer, reader, memory = memory_of_ring()
    rng = np.random.default_rng(0)
    for _ in range(3 * SLOTS):
        color = rng.integers(0, 256, (37, 53, 3), dtype=np.uint8)
        units = rng.integers(0, 65536, (37, 53), dtype=np.uint16)
        depth = units if metres_per_unit is not None else rng.random((37, 53)).astype(np.float32)
        read = reader.read(writer.write(color, depth, metres_per_unit=metres_per_unit))
        assert read is not None
        np.testing.assert_array_equal(read[0], color)
        expected = depth if metres_per_unit is None else (units * metres_per_unit).astype(np.float32)
        np.testing.assert_array_equal(read[1], expected)
    reader.close()
    os.close(memory)


def test_a_slot_that_was_taken_for_a_newer_frame_is_known() -> None:
    writer, reader, memory = memory_of_ring()
    color, depth = np.zeros((4, 6, 3), np.uint8), np.zeros((4, 6), np.uint16)
    first = writer.write(color, depth, metres_per_unit=1e-3)
    for _ in range(SLOTS - 1):
        writer.write(color, depth, metres_per_unit=1e-3)
    assert reader.read(first) is not None
    writer.write(color, depth, metres_per_unit=1e-3)
    assert reader.read(first) is None
    reader.close()
    os.close(memory)


def greet(end: ChildEnd) -> None:
    end.send(os.getpid())
    end.stopping.wait()


def test_a_child_that_is_asked_to_stop_stops() -> None:
    child = ChildProcess(pickled(greet))
    assert child.messages.recv() == child.pid
    child.stop(patience_s=5)
    assert child.manner_of_death() == "exit code 0"
