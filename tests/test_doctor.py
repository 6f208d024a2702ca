"""page-runtime doctor: what it finds on computers and recordings that have known faults."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import toy
from page_runtime import findings
from page_runtime.camera import Camera
from page_runtime.capture.frame_service import DeviceUnavailable
from page_runtime.capture.oak import OakDevice
from page_runtime.cli import main
from page_runtime.commands import doctor as command
from page_runtime.findings import Finding
from page_runtime.image_files import SourceError
from page_runtime.network import Network
from page_runtime.recorded import RecordedFrame
from page_runtime.recording import RecordingWriter


@pytest.fixture(autouse=True)
def no_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search for cameras has tests of its own, and takes a child process."""
    monkeypatch.setattr(command, "connected_devices", tuple)


def diagnosed(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any]]:
    code = main(["doctor", *map(str, arguments), "--json", "--seconds", "0.2"])
    return code, json.loads(capsys.readouterr().out)


def test_a_sound_recording_is_timed_and_has_no_problem(
    toy_recording: Path, oracle_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, document = diagnosed(capsys, toy_recording, "--bundle", oracle_bundle)
    levels = {finding["topic"]: finding["level"] for finding in document["findings"]}
    assert code == 0
    assert {"versions", "onnxruntime", "processor", "memory", "cameras", "calibration", "depth", "speed"} <= set(levels)
    assert "problem" not in levels.values()
    assert document["speed"]["what"] == "estimate"
    assert all(run["p95_ms"] >= run["p50_ms"] > 0 and run["measurements"] >= 1 for run in document["speed"]["runs"])


def test_without_a_recording_a_shipped_network_is_timed_alone(capsys: pytest.CaptureFixture[str]) -> None:
    code, document = diagnosed(capsys)
    assert code in (0, 1)
    assert (document["speed"]["what"], document["speed"]["bundle"]) == ("network alone", "box.onnx")
    assert main(["doctor", "--seconds", "0.1"]) == code
    last = capsys.readouterr().out.splitlines()[-1]
    assert "to improve" in last


def test_depth_in_the_wrong_unit_is_a_problem_and_the_exit_code_says_so(
    oracle_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded, _ = toy.toy_frame()
    frame = recorded.frame
    tenth = type(frame)(frame.color, frame.depth_m * np.float32(0.05), frame.camera)
    with RecordingWriter(tmp_path / "r", category="box", part_names=("base", "lid")) as writer:
        writer.write(RecordedFrame(tenth, recorded.instances))
    code, document = diagnosed(capsys, tmp_path / "r", "--bundle", oracle_bundle)
    assert code == 1
    problems = {finding["topic"] for finding in document["findings"] if finding["level"] == "problem"}
    assert problems == {"depth", "size"}


@pytest.mark.parametrize("arguments", [["nowhere"], ["--bundle", "none.onnx"], ["--seconds", "0"], ["oak"]])
def test_what_cannot_be_looked_at_is_a_sentence_and_exit_code_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("page-runtime: ")
    assert captured.err.count("\n") == 1


def test_a_search_for_cameras_that_fails_is_a_problem_and_a_missing_extra_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(error: Exception) -> list[Finding]:
        def search() -> tuple[OakDevice, ...]:
            raise error

        monkeypatch.setattr(command, "connected_devices", search)
        return list(command._devices())

    assert fails(DeviceUnavailable("the search failed: crashed"))[0].level == "problem"
    (finding,) = fails(SourceError("pip install 'page-edge[oak]'"))
    assert (finding.level, finding.advice) == ("ok", "pip install 'page-edge[oak]'")


def write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root


def by_topic(found: Any) -> dict[str, Finding]:
    return {finding.topic: finding for finding in found}


def test_a_saving_governor_and_a_quota_are_told(tmp_path: Path) -> None:
    governor = "sys/devices/system/cpu/cpu{}/cpufreq/scaling_governor"
    slow = write(
        tmp_path / "a",
        {
            governor.format(0): "powersave\n",
            governor.format(1): "performance\n",
            "sys/fs/cgroup/cpu.max": "50000 100000",
        },
    )
    found = by_topic(findings.check_processor(slow))
    assert found["governor"].level == "advice"
    assert "cpupower frequency-set -g performance" in found["governor"].advice
    assert found["quota"].advice.startswith("--threads 1")
    fast = write(tmp_path / "b", {governor.format(0): "performance\n", "sys/fs/cgroup/cpu.max": "max 100000"})
    found = by_topic(findings.check_processor(fast))
    assert found["governor"].level == "ok"
    assert "quota" not in found
    assert by_topic(findings.check_processor(tmp_path))["governor"].level == "ok"


@pytest.mark.parametrize(
    ("available_mb", "limit_mb", "level"),
    [(4000, None, "ok"), (500, None, "advice"), (200, None, "problem"), (4000, 250, "problem"), (4000, 4000, "ok")],
)
def test_memory_is_what_the_system_and_the_container_leave(
    available_mb: int, limit_mb: int | None, level: str, tmp_path: Path
) -> None:
    write(tmp_path, {"proc/meminfo": f"MemTotal: 8000000 kB\nMemAvailable: {available_mb * 1000} kB\nHugePages: 0\n"})
    if limit_mb is not None:
        write(tmp_path, {"sys/fs/cgroup/memory.max": f"{limit_mb}000000", "sys/fs/cgroup/memory.current": "1000000"})
    assert findings.check_memory(tmp_path).level == level


def test_two_wheels_of_opencv_and_a_missing_provider_are_problems() -> None:
    (found,) = findings.check_opencv(["numpy", "opencv-python", "opencv-python-headless", None])
    assert found.level == "problem"
    assert found.advice.startswith("pip uninstall opencv-python opencv-python-headless;")
    assert list(findings.check_opencv(["opencv-python-headless"])) == []
    assert findings.check_providers(["CUDAExecutionProvider"]).level == "problem"
    assert findings.check_providers(["CUDAExecutionProvider", "CPUExecutionProvider"]).level == "ok"


def test_a_load_is_measured_against_the_cores() -> None:
    assert findings.check_load(0.4, 2).level == "ok"
    assert findings.check_load(1.5, 2).level == "advice"


@pytest.mark.parametrize(
    ("fx", "fy", "level"), [(600, 600, "ok"), (600, 700, "problem"), (6000, 6000, "problem"), (60, 60, "problem")]
)
def test_focal_lengths_that_no_such_camera_has_are_a_problem(fx: float, fy: float, level: str) -> None:
    (found,) = findings.check_camera(Camera(np.array([[fx, 0, 320.0], [0, fy, 240], [0, 0, 1]]), 640, 480))
    assert found.level == level


@pytest.mark.parametrize(
    ("depth_m", "level"),
    [([1.0] * 9 + [0.0], "ok"), ([1.0] * 2 + [0.0] * 8, "advice"), ([0.0] * 10, "problem"), ([1000.0] * 10, "problem")],
)
def test_depth_that_is_missing_or_in_millimetres_is_told(depth_m: list[float], level: str) -> None:
    assert findings.check_depth(np.array(depth_m, np.float32)).level == level


def test_times_that_stand_or_skip_and_skewed_sensors_are_told() -> None:
    times_s = [i / 30 for i in range(30)]
    assert [finding.level for finding in findings.check_times(times_s, [0.0] * 30)] == ["ok"]
    assert "1 gaps" in next(findings.check_times([*times_s, 1.5], [0.0] * 31)).what
    assert by_topic(findings.check_times(times_s, [0.02] * 30))["skew"].level == "advice"
    assert [finding.level for finding in findings.check_times([0.0] * 5, [0.0] * 5)] == ["advice"]
    assert list(findings.check_times([0.0], [0.0])) == []


def test_advice_on_threads_and_speed_follows_from_the_times(oracle_bundle: Path) -> None:
    def runs(*p50_ms: float) -> dict[str, Any]:
        times = [{"threads": n, "p50_ms": p, "p95_ms": 1.1 * p} for n, p in zip((2, 1), p50_ms, strict=True)]
        return {"what": "estimate", "bundle": "b", "runs": times}

    assert "threads" not in by_topic(command.speed_findings(runs(40.0, 60.0)))
    assert by_topic(command.speed_findings(runs(60.0, 40.0)))["threads"].level == "advice"
    assert next(command.speed_findings(runs(200.0, 300.0))).level == "advice"
    assert next(command.speed_findings(runs(40.0, 60.0))).level == "ok"
    measured = command.measure(Network(oracle_bundle, threads=1), None, [], 0.05)
    assert measured["what"] == "network alone"
