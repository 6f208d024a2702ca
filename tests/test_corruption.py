"""Damaged recordings: a sentence, or what can be recovered with the loss counted; never a crash, a hang or a wrong
pixel where the format has checksums."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import recorded_toy
from page_runtime.capture.playback import open_source
from page_runtime.cli import main
from page_runtime.image_files import SourceError
from page_runtime.recorded import RecordedFrame

FRAMES = 6
CORRUPTIONS = 56
# A changed byte of a picture cannot be noticed where nothing has a checksum: sqlite3, videos, the MCAP of rosbags.
UNCHECKED = {"ROS 2 bag of sqlite3", "ROS 2 bag of MCAP", "colour video and depth pictures"}


def corrupted(data: bytes, rng: np.random.Generator) -> tuple[str, bytes | None]:
    """What happens to files: the end or a piece lost, a byte changed, a piece zeroed; None: all of it lost."""
    kind = str(rng.choice(["truncate", "flip", "zero", "remove a piece", "delete"], p=[0.25, 0.35, 0.2, 0.15, 0.05]))
    at = int(rng.integers(len(data)))
    end = min(len(data), at + int(rng.integers(1, max(2, len(data) // 4))))
    if kind == "truncate":
        return kind, data[:at]
    if kind == "flip":
        return kind, data[:at] + bytes([data[at] ^ int(rng.integers(1, 256))]) + data[at + 1 :]
    if kind == "zero":
        return kind, data[:at] + bytes(end - at) + data[end:]
    return kind, data[:at] + data[end:] if kind == "remove a piece" else None


def frames_of(path: Path) -> tuple[list[RecordedFrame], bool]:
    """The frames that can be played, and whether the source says that all are there."""
    source = open_source(path)
    return list(source), source.counts.complete


@pytest.mark.parametrize("name", list(recorded_toy.LOSSLESS))
def test_damage_gives_a_typed_error_or_the_rest_with_the_loss_counted(name: str, tmp_path: Path) -> None:
    if name == "depthai recording":
        pytest.importorskip("depthai")
    path = recorded_toy.LOSSLESS[name](tmp_path, recorded_toy.frames(FRAMES))
    originals = {round(r.frame.timestamp_s * 1e5): r.frame for r in open_source(path)}
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    rng = np.random.default_rng(sum(name.encode()))
    outcomes: Counter[str] = Counter()
    for _ in range(CORRUPTIONS):
        file = files[int(rng.integers(len(files)))]
        whole = file.read_bytes()
        kind, data = corrupted(whole, rng)
        if data is None:
            file.unlink()
        else:
            file.write_bytes(data)
        try:
            frames, complete = frames_of(path)
        except SourceError:
            outcomes["refused"] += 1
        else:
            assert len(frames) == FRAMES or not complete, f"{kind} of {file.name}: a silent loss"
            outcomes["whole" if complete else "recovered"] += 1
            for recorded in frames if name not in UNCHECKED else []:
                original = originals.get(round(recorded.frame.timestamp_s * 1e5))
                if original is not None:
                    np.testing.assert_array_equal(recorded.frame.color, original.color)
                    if file.suffix != ".json":
                        np.testing.assert_array_equal(recorded.frame.depth_m, original.depth_m)
        finally:
            file.write_bytes(whole)
    assert outcomes["refused"] + outcomes["recovered"] > CORRUPTIONS // 5, outcomes
    assert frames_of(path)[1]


@pytest.mark.parametrize("name", ["MCAP", "ROS 2 bag of sqlite3", "TUM RGB-D sequence", "page-edge recording"])
def test_the_command_line_answers_damage_in_sentences(name: str, tmp_path: Path, capsys) -> None:
    path = recorded_toy.LOSSLESS[name](tmp_path, recorded_toy.frames(3))
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    rng = np.random.default_rng(0)
    codes = set()
    for attempt in range(12):
        file = files[int(rng.integers(len(files)))]
        whole = file.read_bytes()
        _, data = corrupted(whole, rng)
        file.write_bytes(data or b"")
        code = main(["convert", str(path), str(tmp_path / f"out{attempt}.mcap"), "--quiet"])
        out, err = capsys.readouterr()
        assert out == ""
        assert code in (0, 2)
        assert all(line.startswith("page-runtime: ") for line in err.splitlines())
        assert code == 0 or err.count("\n") >= 1
        codes.add(code)
        file.write_bytes(whole)
    assert 2 in codes


def test_a_damaged_chunk_costs_its_own_frames_and_no_others(tmp_path: Path) -> None:
    path = recorded_toy.writer_of("mcap", "a.mcap")(tmp_path, recorded_toy.frames(30))
    whole = path.read_bytes()
    middle = len(whole) // 2
    path.write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    source = open_source(path)
    indices = [recorded.frame.index for recorded in source]
    assert 10 < len(indices) < 30
    assert indices[0] == 0
    assert indices[-1] == 29
    assert source.counts.missed["messages in damaged chunks"] > 0
