"""page-runtime live as a user meets it."""

from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import live_sources
from page_runtime import open_source
from page_runtime.capture.supervision import SupervisedSource
from page_runtime.cli import main
from page_runtime.commands import sources
from page_runtime.estimator import estimate
from page_runtime.network import Network
from page_runtime.pose import PartPose

ROOT = Path(__file__).resolve().parents[1]
BOXES = ROOT / "tests" / "data" / "box"
BUNDLE = ROOT / "runtime" / "bundles" / "box.onnx"


# A recording without an end of the shipped one, and what `live` is then called with.
ENDLESS = """
import dataclasses, sys
import page_runtime.cli as cli
import page_runtime.commands.sources as sources
opened = sources.open_source
def endless(path, **more):
    source = opened(path, **more)
    return dataclasses.replace(source, entries=source.entries * 10000)
sources.open_source = endless
sys.exit(cli.main(sys.argv[1:]))
"""


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_live_writes_a_line_a_frame_and_a_status_that_agrees_with_them(tmp_path: Path) -> None:
    out, status, pictures = tmp_path / "o.jsonl", tmp_path / "s.json", tmp_path / "pictures"
    arguments = ["live", str(BOXES), "--bundle", str(BUNDLE), "--out", str(out), "--status", str(status)]
    assert main([*arguments, "--overlay", str(pictures), "--objects", "1", "--quiet"]) == 0
    lines = lines_of(out)
    indices = [entry.index for entry in open_source(BOXES).entries]
    assert [line["frame"] for line in lines] == indices
    document = json.loads(status.read_text())
    assert document["running"] is False
    assert document["counts"]["received"] == document["counts"]["processed"] == len(indices)
    assert document["counts"] == lines[-1]["counts"]
    assert document["state"] == lines[-1]["state"]
    assert document["latency_ms"]["p50"] > 0
    found = [line["objects"][0] for line in lines if line["objects"]]
    assert found
    assert {"number", "region", "tracked", "parts", "joints", "looks", "stage_ms"} == set(found[0])
    assert all("rate" in joint for joint in found[0]["joints"])
    assert all(line["reason"] for line in lines if not line["objects"])
    assert len(list(pictures.iterdir())) == len(indices)
    assert {name.split()[0] for name in document["sinks"]} == {"lines", "overlay"}
    for counts in document["sinks"].values():
        assert counts["given"] == counts["written"] + counts["dropped"] == len(indices)


def test_without_tracking_every_frame_is_what_estimate_says(tmp_path: Path) -> None:
    out = tmp_path / "o.jsonl"
    assert main(["live", str(BOXES), "--bundle", str(BUNDLE), "--no-track", "--out", str(out), "--frames", "2"]) == 0
    network, source = Network(BUNDLE), open_source(BOXES)
    for line, recorded in zip(lines_of(out), source, strict=False):
        region = recorded.instances[0].region
        assert region is not None
        pose = estimate(network, recorded.frame, region, max_looks=1)
        for part, expected in zip(line["objects"][0]["parts"], pose.parts, strict=True):
            assert isinstance(expected, PartPose)
            np.testing.assert_allclose(part["T_camera_part"], expected.T_camera_part, atol=1e-4)
    assert len(lines_of(out)) == 2


def test_masks_say_where_the_objects_are(tmp_path: Path) -> None:
    out, masks = tmp_path / "o.jsonl", tmp_path / "masks"
    masks.mkdir()
    source = open_source(BOXES)
    region = source.entries[0].instances[0].region
    assert region is not None
    x, y, w, h = region
    mask = np.zeros((source.entries[0].camera.height, source.entries[0].camera.width), np.uint8)
    mask[y : y + h, x : x + w] = 1
    cv2.imwrite(str(masks / f"{source.entries[0].index:06d}.png"), mask)
    arguments = ["live", str(BOXES), "--bundle", str(BUNDLE), "--mask", str(masks), "--no-track", "--frames", "2"]
    assert main([*arguments, "--out", str(out)]) == 0
    first, second = lines_of(out)
    assert first["objects"][0]["region"] == list(region)
    assert second["objects"] == []
    assert second["reason"]


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--region", "nowhere"], "expected four whole numbers"),
        (["--region", "5000,10,20,20"], "lies outside"),
        (["--region", "auto", "--mask", "m"], "not allowed with"),
        (["--classes", "cup"], "expected with --detector"),
        (["--detector", "none.onnx"], "there is no such file"),
        (["--mask", "none"], "expected a folder of masks"),
        (["--deadline-ms", "0"], "expected milliseconds > 0"),
        (["--status", "none/status.json"], "no folder"),
        (["--looks", "0"], "expected at least 1"),
    ],
)
def test_what_cannot_be_used_is_refused_in_a_sentence(
    more: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "o.jsonl"
    assert main(["live", str(BOXES), "--bundle", str(BUNDLE), "--out", str(out), *more]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_well_within_two_seconds_and_the_lines_stand(number: int, tmp_path: Path) -> None:
    out, status = tmp_path / "o.jsonl", tmp_path / "s.json"
    words = [sys.executable, "-c", ENDLESS, "live", str(BOXES), "--bundle", str(BUNDLE), "--status", str(status)]
    with out.open("w") as file:
        process = subprocess.Popen(words, stdout=file, stderr=subprocess.PIPE)
        began_s = time.monotonic()
        while not (out.exists() and out.read_text().count("\n") >= 2):
            assert process.poll() is None, process.stderr.read() if process.stderr else ""
            assert time.monotonic() - began_s < 60.0
            time.sleep(0.05)
        process.send_signal(number)
        process.wait(timeout=10.0)
    assert process.returncode == 0
    lines = lines_of(out)
    document = json.loads(status.read_text())
    assert document["running"] is False
    assert document["counts"]["processed"] == len(lines)
    counts = document["counts"]
    assert counts["received"] == counts["processed"] + counts["dropped"] + counts["waiting"]


def test_a_region_outside_a_cameras_pictures_is_refused_when_they_come(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def camera(name: str, **_: object) -> SupervisedSource:
        return SupervisedSource(live_sources.count_up, name=name)

    monkeypatch.setattr(sources, "open_oak", camera)
    arguments = ["live", "oak", "--bundle", str(BUNDLE), "--region", "5000,10,20,20", "--quiet"]
    assert main([*arguments, "--out", str(tmp_path / "o.jsonl")]) == 2
    assert "--region: 5000,10,20,20 lies outside the 64x48 image" in capsys.readouterr().err


def test_the_end_of_the_only_reader_is_the_end_without_a_word() -> None:
    words = [sys.executable, "-c", ENDLESS, "live", str(BOXES), "--bundle", str(BUNDLE), "--quiet"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert json.loads(process.stdout.readline())["frame"] == 0
        process.stdout.close()
        assert process.wait(timeout=30.0) == 0
        assert process.stderr.read() == b""


def test_no_result_of_a_recording_is_missing_in_a_file_however_slow_that_is(tmp_path: Path) -> None:
    """A hundred frames without a reading: nothing to compute, and each file takes longer than the loop."""
    source = open_source(BOXES)
    entry = source.entries[0]
    empty = np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), np.float32)
    entries = tuple(
        dataclasses.replace(entry, index=k, timestamp_s=k / 30, decode=lambda: empty, instances=()) for k in range(100)
    )
    out, video, status = tmp_path / "o.jsonl", tmp_path / "o.mkv", tmp_path / "s.json"
    arguments = ["live", str(BOXES), "--bundle", str(BUNDLE), "--out", str(out), "--video", str(video)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sources, "open_source", lambda *_, **__: dataclasses.replace(source, entries=entries))
        assert main([*arguments, "--overlay", str(tmp_path / "p"), "--status", str(status), "--quiet"]) == 0
    assert [line["frame"] for line in lines_of(out)] == list(range(100))
    assert len(list((tmp_path / "p").iterdir())) == 100
    document = json.loads(status.read_text())
    assert document["counts"]["processed"] == 100
    assert {(counts["written"], counts["dropped"]) for counts in document["sinks"].values()} == {(100, 0)}
