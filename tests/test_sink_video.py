"""Results as a video: at the pace of the camera, and playable after a kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from live_results import empty_result, noisy_result, results_of
from page_runtime.live.result import LiveResult
from page_runtime.sinks.picture import picture_of
from page_runtime.sinks.video import FPS, LONGEST_STILL, VideoSink
from sink_trials import largest_file


@pytest.fixture(scope="module")
def results(toy_recording: Path, oracle_bundle: Path) -> list[LiveResult]:
    """Three frames; the second has no depth."""
    return list(results_of(toy_recording, oracle_bundle))


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
