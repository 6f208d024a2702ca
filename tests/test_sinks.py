"""Lines and datagrams, and what holds for every sink."""

from __future__ import annotations

import json
import socket
import threading
import time
from pathlib import Path

import pytest

from live_results import empty_result, results_of, unseen_result
from page_runtime.live.result import LiveResult
from page_runtime.schema import pose_record, result_record
from page_runtime.sinks.json_lines import UdpSink, line_file, line_stdout
from page_runtime.sinks.mcap import McapSink
from page_runtime.sinks.queue import NEWEST, Sinks
from page_runtime.sinks.sink import Sink
from page_runtime.sinks.video import VideoSink
from sink_trials import keep, largest_file, read_ros2


@pytest.fixture(scope="module")
def results(toy_recording: Path, oracle_bundle: Path) -> list[LiveResult]:
    """Three frames; the second has no depth."""
    return list(results_of(toy_recording, oracle_bundle))


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
        "failed": 0,
    }  # fmt: skip
    with pytest.raises(FileExistsError):
        line_file(path)


def test_lines_go_to_standard_output_as_they_come(results: list[LiveResult], capfd: pytest.CaptureFixture[str]) -> None:
    keep(line_stdout(), results)
    assert [json.loads(line)["frame"] for line in capfd.readouterr().out.splitlines()] == [0, 1, 2]


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
