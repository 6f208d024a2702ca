"""Sinks behind their queues: nothing slows the loop, every result is counted, a fault is told once."""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import toy
from live_results import empty_result, noisy_result, results_of, unseen_result
from page_runtime.capture.mcap_file import McapFile
from page_runtime.capture.playback import open_source
from page_runtime.capture.repair import repair
from page_runtime.capture.ros_results import part_frame
from page_runtime.geometry import rotation_about
from page_runtime.live.result import LiveResult
from page_runtime.pose import PartPose
from page_runtime.schema import pose_record, result_record
from page_runtime.similarity import unit_quaternions
from page_runtime.sinks.json_lines import LineSink, UdpSink, line_file, line_stdout
from page_runtime.sinks.mcap import McapSink
from page_runtime.sinks.picture import picture_of
from page_runtime.sinks.queue import EVERY, NEWEST, Sinks
from page_runtime.sinks.sink import Sink
from page_runtime.sinks.video import FPS, LONGEST_STILL, VideoSink


@pytest.fixture(scope="module")
def results(toy_recording: Path, oracle_bundle: Path) -> list[LiveResult]:
    """Three frames; the second has no depth."""
    return list(results_of(toy_recording, oracle_bundle))


def keep(sink: Sink, results: list[LiveResult]) -> None:
    """All results into one sink, however busy the computer is."""
    with Sinks([(sink, len(results))], close_s=60) as sinks:
        for result in results:
            sinks.put(result)
    assert sinks.counts[sink.name].written == len(results)


class Script:
    """A sink that does as it is told: `act` is called with the number of each write."""

    name = "script"

    def __init__(self, act: Callable[[int], object] = lambda _: None) -> None:
        self.act, self.seen, self.closings, self.threads = act, [], 0, set[int]()

    def write(self, result: LiveResult) -> None:
        self.threads.add(threading.get_ident())
        self.seen.append(result.frame.index)
        self.act(len(self.seen))

    def close(self) -> None:
        self.closings += 1


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


def test_a_line_holds_the_poses_as_run_writes_them_and_what_the_loop_adds(
    results: list[LiveResult], tmp_path: Path
) -> None:
    path = tmp_path / "out.jsonl"
    keep(line_file(path), results)
    records = [json.loads(line) for line in path.read_text().splitlines()]
    assert records == [result_record(result) for result in results]
    for record, result in zip(records, results, strict=True):
        (found,) = result.objects
        as_run = pose_record(found.pose, frame=result.frame.index, timestamp_s=result.frame.timestamp_s)
        (written,) = record["objects"]
        assert {name: as_run[name] for name in ("frame", "timestamp_s")}.items() <= record.items()
        assert {name: as_run[name] for name in ("parts", "joints", "looks", "stage_ms")}.items() <= written.items()
    assert records[0]["counts"] == {
        "received": 1, "processed": 1, "dropped": 0, "waiting": 0, "late": 0, "searched": 1, "tracked": 0, "lost": 0,
    }  # fmt: skip
    with pytest.raises(FileExistsError):
        line_file(path)


def test_lines_go_to_standard_output_as_they_come(results: list[LiveResult], capfd: pytest.CaptureFixture[str]) -> None:
    keep(line_stdout(), results)
    assert [json.loads(line)["frame"] for line in capfd.readouterr().out.splitlines()] == [0, 1, 2]


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


def test_datagrams_arrive_and_a_listener_that_is_away_is_no_fault(results: list[LiveResult]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(5)
        port = listener.getsockname()[1]
        sink = UdpSink("127.0.0.1", port)
        sink.write(results[0])
        assert json.loads(listener.recv(65536)) == result_record(results[0])
    for _ in range(5):
        sink.write(results[0])
    sink.close()


def read_ros2(path: Path) -> dict[str, list[object]]:
    """Messages by topic, read by Foxglove's library."""
    from mcap_ros2.reader import read_ros2_messages

    found: dict[str, list[object]] = {}
    for message in read_ros2_messages(path):
        found.setdefault(message.channel.topic, []).append(message.ros_msg)
    return found


def test_an_mcap_file_plays_as_a_recording_of_the_same_frames(results: list[LiveResult], tmp_path: Path) -> None:
    keep(McapSink(tmp_path / "a.mcap", category=toy.CATEGORY), results)
    source = open_source(tmp_path / "a.mcap")
    assert (source.category, source.part_names) == ("box", ("base", "lid"))
    for recorded, result in zip(source, results, strict=True):
        np.testing.assert_array_equal(recorded.frame.color, result.frame.color)
        np.testing.assert_array_equal(recorded.frame.depth_m, result.frame.depth_m)
        assert recorded.frame.timestamp_s == result.frame.timestamp_s
        assert [instance.region for instance in recorded.instances] == [found.region for found in result.objects]


def test_another_reader_finds_each_pose_as_a_transform_and_a_marker(results: list[LiveResult], tmp_path: Path) -> None:
    keep(McapSink(tmp_path / "a.mcap"), results)
    by_topic = read_ros2(tmp_path / "a.mcap")
    for k, result in enumerate(results):
        parts = [part for part in result.objects[0].pose.parts if isinstance(part, PartPose)]
        transforms = by_topic["/tf"][k].transforms  # type: ignore[attr-defined]
        assert [t.child_frame_id for t in transforms] == [f"object_0/{part.name}" for part in parts]
        delete, *markers = by_topic["/page_edge/markers"][k].markers  # type: ignore[attr-defined]
        assert delete.action == 3
        for transform, box, part in zip(transforms, markers[::2], parts, strict=True):
            assert transform.header.frame_id == "camera_color_optical_frame"
            T = np.asarray(part.T_camera_part)
            np.testing.assert_allclose(vector(transform.transform.translation), T[:3, 3], atol=1e-12)
            np.testing.assert_allclose(turn(transform.transform.rotation), T[:3, :3], atol=1e-9)
            np.testing.assert_allclose(vector(box.pose.position), T[:3, 3], atol=1e-12)
            np.testing.assert_allclose(vector(box.scale), part.extents_m, atol=1e-12)
        states = by_topic["/page_edge/joint_states"][k]
        values = [joint.value for joint in result.objects[0].pose.joints if joint.value is not None]
        assert list(states.position) == values  # type: ignore[attr-defined]
        assert json.loads(by_topic["/page_edge/result"][k].data) == result_record(result)  # type: ignore[attr-defined]


def vector(message: object) -> list[float]:
    return [message.x, message.y, message.z]  # type: ignore[attr-defined]


def turn(q: object) -> np.ndarray:
    """The rotation of a quaternion, from its axis and angle: not the way the runtime made it."""
    w, axis = q.w, np.array(vector(q))  # type: ignore[attr-defined]
    length = float(np.linalg.norm(axis))
    return np.eye(3) if length == 0 else rotation_about(axis, 2 * np.arctan2(length, w))


@settings(deadline=None)
@given(
    st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda a: np.linalg.norm(a) > 0.1), st.floats(0, np.pi)
)
def test_a_quaternion_is_the_half_turn_about_the_axis(axis: list[float], angle_rad: float) -> None:
    unit = np.array(axis) / np.linalg.norm(axis)
    (found,) = unit_quaternions(np.asarray(rotation_about(unit, angle_rad)[None], np.float64))
    expected = np.array([np.cos(angle_rad / 2), *(np.sin(angle_rad / 2) * unit)])
    # q and -q are the same turn.
    assert min(np.abs(found - expected).max(), np.abs(found + expected).max()) < 1e-7


def test_frames_of_parts_have_no_spaces() -> None:
    assert part_frame(3, "top drawer") == "object_3/top_drawer"


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file of this process may grow above `size` bytes, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_ends_the_recording_after_its_last_whole_chunk_and_repair_closes_it(tmp_path: Path) -> None:
    path, told = tmp_path / "a.mcap", list[str]()
    other = Script()
    sinks = Sinks([(McapSink(path), 40), (other, 40)], tell=told.append, close_s=60)
    with largest_file(3 << 20), sinks:
        for i in range(40):
            sinks.put(noisy_result(i))
    counts = sinks.counts[f"mcap {path}"]
    assert counts.written >= 3
    assert counts.failed == 40 - counts.written >= 3
    assert len(other.seen) == 40
    assert sum("File too large" in sentence for sentence in told) == 1
    file = McapFile(path)
    assert set(file.missed) == {"end of a file that was never closed"}
    file.close()
    repaired = repair(path, None)
    frames = list(open_source(repaired.path))
    assert len(frames) == repaired.frames <= counts.written
    # What waited for its chunk to be full, 1 MB of some 540 kB a frame, is what the disk has cost.
    assert repaired.frames >= counts.written - 2
    for recorded in frames:
        np.testing.assert_array_equal(recorded.frame.color, noisy_result(recorded.frame.index).frame.color)


def test_lines_are_whole_after_a_full_disk_has_room_again(results: list[LiveResult], tmp_path: Path) -> None:
    sink = line_file(tmp_path / "a.jsonl")
    size, outcomes = len(json.dumps(result_record(results[0]))), []
    with largest_file(2 * size + size // 2):
        for _ in range(5):
            try:
                sink.write(results[0])
                outcomes.append("written")
            except OSError:
                outcomes.append("failed")
    sink.write(results[2])
    sink.close()
    lines = (tmp_path / "a.jsonl").read_text().splitlines()
    assert outcomes == ["written", "written", "failed", "failed", "failed"]
    assert [json.loads(line)["frame"] for line in lines] == [0, 0, 0, 2]


def test_a_video_without_room_says_how_much_it_holds(tmp_path: Path) -> None:
    sink = VideoSink(tmp_path / "a.mkv")
    with largest_file(1 << 20):
        for i in range(60):
            sink.write(noisy_result(i))
        with pytest.raises(OSError, match=r"of 60 pictures can be played; was the disk full\?"):
            sink.close()


def pictures_in(path: Path) -> list[np.ndarray]:
    video = cv2.VideoCapture(str(path))
    found = []
    while True:
        is_there, picture = video.read()
        if not is_there:
            video.release()
            return found
        found.append(picture[..., ::-1])


@pytest.mark.parametrize(
    ("times_s", "expected"),
    [
        ([i / FPS for i in range(10)], 10),
        ([i / 10 for i in range(10)], 28),  # each picture stands for three, but the last
        ([i / 60 for i in range(60)], 30),
        ([0.0] * 7, 7),  # a source without times
        ([0.0, 60.0, 60.1], 1 + LONGEST_STILL + 1 + 3),
        ([5.0, 5.1, 0.0, 0.1], 8),  # a clock that was set back
    ],
)
def test_a_video_runs_at_the_pace_of_the_camera(times_s: list[float], expected: int, tmp_path: Path) -> None:
    sink = VideoSink(tmp_path / "a.mkv")
    for i, time_s in enumerate(times_s):
        result = empty_result(i)
        sink.write(replace(result, frame=replace(result.frame, timestamp_s=time_s)))
    sink.close()
    assert abs(len(pictures_in(tmp_path / "a.mkv")) - expected) <= 1


def test_a_video_shows_the_overlay(results: list[LiveResult], tmp_path: Path) -> None:
    for suffix in (".mkv", ".mp4"):
        sink = VideoSink(tmp_path / f"a{suffix}")
        for result in results:
            sink.write(result)
        sink.close()
        first = pictures_in(tmp_path / f"a{suffix}")[0].astype(float)
        assert np.abs(first - picture_of(results[0])).mean() < 6
        assert np.abs(first - results[0].frame.color).mean() > np.abs(first - picture_of(results[0])).mean()


def test_a_killed_process_leaves_a_video_that_plays(tmp_path: Path) -> None:
    code = (
        "import sys, os, signal\nfrom pathlib import Path\n"
        "from live_results import noisy_result\nfrom page_runtime.sinks.video import VideoSink\n"
        "sink = VideoSink(Path(sys.argv[1]))\n"
        "for i in range(90):\n    sink.write(noisy_result(i))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    path = tmp_path / "a.mkv"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    process = subprocess.run([sys.executable, "-c", code, str(path)], env=environment, check=False)
    assert process.returncode == -signal.SIGKILL
    assert 60 <= len(pictures_in(path)) <= 90


def test_an_empty_recording_of_a_video_leaves_no_file(tmp_path: Path) -> None:
    VideoSink(tmp_path / "a.mkv").close()
    assert not (tmp_path / "a.mkv").exists()
    with pytest.raises(ValueError, match=r"NAME\.mkv or NAME\.mp4"):
        VideoSink(tmp_path / "a.webm")


def all_sinks(folder: Path) -> list[Sink]:
    from page_runtime.sinks.rerun_log import RrdSink
    from page_runtime.sinks.web import WebSink

    return [
        line_file(folder / "a.jsonl"),
        UdpSink("127.0.0.1", 9),
        McapSink(folder / "a.mcap"),
        RrdSink(folder / "a.rrd"),
        VideoSink(folder / "a.mkv"),
        WebSink(0),
    ]


def test_every_sink_takes_a_hundred_empty_frames_and_parts_without_a_pose(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    told: list[str] = []
    sinks = Sinks([(sink, 200) for sink in all_sinks(tmp_path)], tell=told.append, close_s=60)
    with sinks:
        for i in range(100):
            sinks.put(empty_result(i))
            sinks.put(unseen_result(i))
    assert told == []
    assert {counts.written for counts in sinks.counts.values()} == {200}
    assert len((tmp_path / "a.jsonl").read_text().splitlines()) == 200
    assert {len(found) for found in read_ros2(tmp_path / "a.mcap").values()} == {200}


def test_starting_and_closing_sinks_leaves_neither_threads_nor_descriptors(tmp_path: Path) -> None:
    pytest.importorskip("rerun")

    def once(number: int) -> None:
        folder = tmp_path / str(number)
        folder.mkdir()
        with Sinks([(sink, NEWEST) for sink in all_sinks(folder)], close_s=20) as sinks:
            sinks.put(empty_result(0))

    def kept() -> tuple[int, int]:
        return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))

    once(0)
    before = kept()
    for number in range(1, 6):
        once(number)
    deadline = time.monotonic() + 5
    while kept() > before and time.monotonic() < deadline:
        time.sleep(0.05)
    threads, descriptors = kept()
    assert threads <= before[0]
    assert descriptors <= before[1] + 1
