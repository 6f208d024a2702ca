"""What was recorded is there, also when the process was killed; the commands that record, convert and repair."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import recorded_toy
import toy
from page_runtime import recording
from page_runtime.capture.conversion import frame_writer, partial_of
from page_runtime.capture.layouts import LAYOUTS
from page_runtime.capture.mcap_file import McapFile
from page_runtime.capture.playback import open_source
from page_runtime.capture.repair import repair
from page_runtime.cli import main
from page_runtime.image_files import SourceError
from page_runtime.recorded import RecordedFrame
from page_runtime.recording import RecordingWriter
from recorded_toy import ENVIRONMENT

TESTS = Path(__file__).parent


@pytest.fixture(scope="module")
def recorder() -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, str(TESTS / "recording_child.py")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    )
    yield process
    process.communicate()


def record_until_killed(recorder: subprocess.Popen[str], target: Path, moment: random.Random) -> int:
    """Frames that were said to be written before the process was killed at a random moment."""
    assert recorder.stdin is not None
    assert recorder.stdout is not None
    recorder.stdin.write(f"{target}\n")
    recorder.stdin.flush()
    process = int(recorder.stdout.readline())
    recorder.stdout.readline()
    time.sleep(moment.uniform(0, 0.1))
    os.kill(process, signal.SIGKILL)
    return 1 + sum(1 for _ in iter(recorder.stdout.readline, "dead\n"))


def same_frames(path: Path, *, upto: int) -> None:
    for _, expected, recorded in zip(range(upto), recorded_toy.endless(), open_source(path), strict=False):
        np.testing.assert_array_equal(recorded.frame.color, expected.frame.color)
        np.testing.assert_array_equal(recorded.frame.depth_m, expected.frame.depth_m)
        assert recorded.frame.timestamp_s == expected.frame.timestamp_s


def test_repair_recovers_all_but_the_last_chunk_of_a_killed_mcap(
    recorder: subprocess.Popen[str], tmp_path: Path
) -> None:
    """Twenty times. A chunk of these small frames holds a second's worth: what the writer had not yet closed."""
    moment = random.Random(0)
    for attempt in range(20):
        target = tmp_path / f"{attempt}.mcap"
        said = record_until_killed(recorder, target, moment)
        chunk = frames_a_chunk()
        try:
            result = repair(target)
        except SourceError:
            assert said <= chunk
            continue
        assert said - chunk <= result.frames
        same_frames(result.path, upto=40)
        repaired = open_source(result.path)
        assert repaired.calibration == '{"serial": 1}'
        assert repaired.counts.missed == {}


def frames_a_chunk() -> int:
    """The most frames a chunk of 1 MiB takes at this size, and the one that crosses its end."""
    frame_bytes = 160 * 120 * 5
    return (1 << 20) // frame_bytes + 2


def test_repair_recovers_every_finished_frame_of_a_killed_folder(
    recorder: subprocess.Popen[str], tmp_path: Path
) -> None:
    moment = random.Random(1)
    for attempt in range(5):
        target = tmp_path / f"{attempt}"
        said = record_until_killed(recorder, target, moment)
        assert not target.exists()
        result = repair(partial_of(target), tmp_path / f"{attempt}-repaired")
        assert result.frames >= said
        same_frames(result.path, upto=result.frames)
        assert open_source(result.path).calibration == '{"serial": 1}'


def test_a_frame_that_fills_a_chunk_is_safe_as_soon_as_it_is_written(tmp_path: Path) -> None:
    """At a camera's usual size a chunk is one frame, so that a kill costs the frame being written and no other."""
    recorded, _ = toy.toy_frame(toy.toy_camera(640, 480))
    noisy = np.random.default_rng(0).integers(0, 255, (480, 640, 3)).astype(np.uint8)
    with frame_writer(tmp_path / "a.mcap") as writer:
        for index in range(3):
            frame = type(recorded.frame)(noisy, recorded.frame.depth_m, recorded.frame.camera, index / 30, index)
            writer.write(RecordedFrame(frame))
            shutil.copy(tmp_path / "a.mcap", tmp_path / f"copy{index}.mcap")
            assert len(open_source(tmp_path / f"copy{index}.mcap")) == index + 1


def test_an_unfinished_recording_is_neither_overwritten_nor_played_by_accident(tmp_path: Path, capsys) -> None:
    (tmp_path / ".r.partial").mkdir()
    (tmp_path / ".r.partial" / "journal.jsonl").touch()
    assert main(["record", str(TESTS / "data/box"), str(tmp_path / "r")]) == 2
    assert "page-runtime repair" in capsys.readouterr().err
    assert main(["repair", str(tmp_path / ".r.partial")]) == 2
    assert "nothing to recover" in capsys.readouterr().err


@pytest.mark.parametrize("layout", LAYOUTS)
def test_convert_writes_every_layout_and_record_the_crash_safe_ones(layout: str, tmp_path: Path, capsys) -> None:
    target = tmp_path / ("out.mcap" if layout == "mcap" else "out")
    source = recorded_toy.writer_of("recording", "source")(tmp_path, recorded_toy.frames(4))
    (source / "calibration.json").write_text('{"serial": 2}')
    assert main(["convert", str(source), str(target), "--layout", layout, "--frames", "3", "--quiet"]) == 0
    played = open_source(target)
    assert len(played) == 3
    if layout in ("mcap", "recording", "ros2-mcap", "ros2-sqlite3"):
        assert played.calibration == '{"serial": 2}'
    assert main(["convert", str(source), str(target), "--layout", layout]) == 2
    assert "exists already" in capsys.readouterr().err
    if layout in ("mcap", "recording"):
        again = tmp_path / ("again.mcap" if layout == "mcap" else "again")
        assert main(["record", str(target), str(again)]) == 0
        assert "3 frames in" in capsys.readouterr().err
        assert open_source(again).category == "box"
        same_frames(again, upto=3)


def test_run_plays_an_mcap_and_says_what_a_damaged_one_has_lost(tmp_path: Path, oracle_bundle: Path, capsys) -> None:
    path = recorded_toy.writer_of("mcap", "a.mcap")(tmp_path, recorded_toy.frames(30))
    data = path.read_bytes()
    assert main(["run", str(path), "--bundle", str(oracle_bundle), "--frames", "2", "--quiet", "--looks", "1"]) == 0
    out, err = capsys.readouterr()
    assert [json.loads(line)["frame"] for line in out.splitlines()] == [0, 1]
    assert err == ""
    path.write_bytes(data[: len(data) * 2 // 3])
    assert main(["run", str(path), "--bundle", str(oracle_bundle), "--quiet", "--looks", "1"]) == 0
    out, err = capsys.readouterr()
    assert 0 < len(out.splitlines()) < 30
    assert re.search(r"left out: \d+ bytes of the file that cannot be read", err)
    assert main(["repair", str(path)]) == 0
    assert re.search(r"a\.repaired\.mcap: \d+ frames; lost: \d+ bytes", capsys.readouterr().out)
    assert McapFile(tmp_path / "a.repaired.mcap").missed == {}


def test_nonsense_windows_and_counts_are_refused(tmp_path: Path, capsys) -> None:
    for option in (["--window-ms", "-3"], ["--window-ms", "x"], ["--frames", "-1"]):
        assert main(["record", str(tmp_path), str(tmp_path / "out"), *option]) == 2
        assert "expected" in capsys.readouterr().err


def test_a_full_disk_leaves_what_repair_can_finish(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = recorded_toy.frames(4)

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    def record() -> None:
        with frame_writer(tmp_path / "r", category="box", part_names=("base", "lid")) as writer:
            for recorded in frames[:3]:
                writer.write(recorded)
            monkeypatch.setattr(recording, "write_depth", full)
            writer.write(frames[3])

    with pytest.raises(OSError, match="No space left"):
        record()
    monkeypatch.undo()
    result = repair(partial_of(tmp_path / "r"), tmp_path / "repaired")
    assert result.frames == 3
    same_frames(result.path, upto=3)


def test_the_recording_writer_still_leaves_nothing_when_it_fails(tmp_path: Path) -> None:
    def fail() -> None:
        with RecordingWriter(tmp_path / "r", category=None, part_names=()) as writer:
            writer.write(recorded_toy.frames(1)[0].__class__(recorded_toy.frames(1)[0].frame))
            raise RuntimeError("the reason")

    with pytest.raises(RuntimeError, match="the reason"):
        fail()
    assert list(tmp_path.iterdir()) == []
