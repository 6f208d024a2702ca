"""The state of a running loop in a file: always whole, never what the loop waits for."""

from __future__ import annotations

import itertools
import json
import threading
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from benchmarks.paced import Idle, PacedSource

import live_sources
from page_runtime import open_source
from page_runtime.capture.supervision import SupervisedSource
from page_runtime.cli import main
from page_runtime.commands import sources, status_file
from page_runtime.commands.outputs import write_json
from page_runtime.live.loop import LiveLoop
from page_runtime.sinks.queue import Sinks

ROOT = Path(__file__).resolve().parents[1]
BOXES = ROOT / "tests" / "data" / "box"
BUNDLE = ROOT / "runtime" / "bundles" / "box.onnx"


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_the_status_goes_on_and_tells_the_silence_of_a_camera_that_gives_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "starts").mkdir()
    stall = partial(live_sources.stall, folder=str(tmp_path / "starts"), frames=2)
    cameras: list[SupervisedSource] = []

    def camera(name: str, **_: object) -> SupervisedSource:
        cameras.append(SupervisedSource(stall, name=name))
        return cameras[0]

    monkeypatch.setattr(sources, "open_oak", camera)
    monkeypatch.setattr(status_file, "PERIOD_S", 0.05)
    status, codes = tmp_path / "s.json", list[int]()
    arguments = ["live", "oak", "--bundle", str(BUNDLE), "--out", str(tmp_path / "o.jsonl"), "--status", str(status)]
    running = threading.Thread(target=lambda: codes.append(main([*arguments, "--quiet"])))
    running.start()
    seen: dict[str, Any] = {}
    end_s = time.monotonic() + 30.0
    while not (seen.get("frame") is not None and seen["silent_s"] > 0.5) and time.monotonic() < end_s:
        time.sleep(0.05)
        seen = json.loads(status.read_text()) if status.exists() else {}
    cameras[0].stop()
    running.join(20.0)
    assert seen["running"]
    assert seen["silent_s"] > 0.5
    assert codes == [0]
    assert json.loads(status.read_text())["running"] is False


def test_a_loop_that_never_began_leaves_the_status_of_another_alone(tmp_path: Path) -> None:
    out, status = tmp_path / "o.jsonl", tmp_path / "s.json"
    out.touch()
    status.write_text("another's")
    arguments = ["live", str(BOXES), "--bundle", str(BUNDLE), "--out", str(out), "--status", str(status)]
    assert main(arguments) == 2
    assert status.read_text() == "another's"


def test_a_status_that_cannot_be_written_is_told_once_and_the_loop_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(status_file, "write_json", full)
    monkeypatch.setattr(status_file, "PERIOD_S", 0.01)
    out, status = tmp_path / "o.jsonl", tmp_path / "s.json"
    arguments = ["live", str(BOXES), "--bundle", str(BUNDLE), "--out", str(out), "--status", str(status), "--quiet"]
    assert main(arguments) == 0
    assert capsys.readouterr().err.count("No space left on device") == 1
    assert len(lines_of(out)) == len(open_source(BOXES).entries)


def test_a_disk_that_hangs_under_the_status_holds_up_neither_the_loop_nor_its_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    release, began = threading.Event(), threading.Event()

    def hang(*_: object) -> None:
        began.set()
        release.wait(60.0)

    monkeypatch.setattr(status_file, "write_json", hang)
    monkeypatch.setattr(status_file, "PERIOD_S", 0.01)
    out, status = tmp_path / "o.jsonl", tmp_path / "s.json"
    arguments = ["live", str(BOXES), "--bundle", str(BUNDLE), "--out", str(out), "--status", str(status), "--quiet"]
    codes = list[int]()
    running = threading.Thread(target=lambda: codes.append(main(arguments)))
    running.start()
    running.join(60.0)
    has_hung = began.is_set() and not release.is_set()
    release.set()
    assert has_hung
    assert codes == [0]
    assert len(lines_of(out)) == len(open_source(BOXES).entries)
    assert f"status {status}: did not close within" in capsys.readouterr().err


def test_a_status_says_what_became_of_the_ones_before_it_and_comes_back_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = itertools.count()

    def full_at_first(path: Path, document: dict[str, Any]) -> None:
        if next(count) < 3:
            raise OSError(28, "No space left on device")
        write_json(path, document)

    monkeypatch.setattr(status_file, "write_json", full_at_first)
    told, path = list[str](), tmp_path / "s.json"
    with (
        LiveLoop(PacedSource(100, 0.01), Idle()) as loop,
        status_file.status_file(path, loop, tell=told.append) as state,
        Sinks([]) as sinks,
    ):
        assert state is not None
        monkeypatch.setattr(status_file, "PERIOD_S", 0.02)
        state.start(sinks)
        for result in loop:
            state.report(result)
    document = json.loads(path.read_text())
    assert document["running"] is False
    assert document["counts"] == asdict(loop.counts)
    own = document["status"]
    assert own["failed"] == 3
    assert own["given"] == own["written"] + own["dropped"] + own["failed"] + own["waiting"]
    assert [sentence for sentence in told if "No space left" in sentence] == told
    assert len(told) == 1
