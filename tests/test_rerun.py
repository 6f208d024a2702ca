"""What Rerun is given, read back by Rerun; and what happens when its file or its viewer goes away."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from live_results import empty_result, noisy_result, results_of
from page_runtime.geometry import apply
from page_runtime.image_files import SourceError
from page_runtime.live.result import LiveResult
from page_runtime.pose import PartPose
from page_runtime.sinks.queue import NEWEST, Sinks
from page_runtime.sinks.rerun_log import MAX_POINTS, RerunViewer, RrdSink, require_rerun
from test_sinks import keep, largest_file

rerun = pytest.importorskip("rerun")


@pytest.fixture(scope="module")
def results(toy_recording: Path, oracle_bundle: Path) -> list[LiveResult]:
    """Three frames; the second has no depth."""
    return list(results_of(toy_recording, oracle_bundle))


def rows_of(path: Path) -> dict[str, dict[int, dict[str, Any]]]:
    """Components by entity, frame and name, as Rerun's own reader finds them."""
    found: dict[str, dict[int, dict[str, Any]]] = {}
    for chunk in rerun.chunk.RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        if "frame" not in batch.schema.names:
            continue
        frames = batch.column("frame").to_pylist()
        for name in batch.schema.names:
            if ":" in name:
                for frame, values in zip(frames, batch.column(name).to_pylist(), strict=True):
                    if values is not None:
                        found.setdefault(chunk.entity_path, {}).setdefault(frame, {})[name.split(":", 1)[-1]] = values
    return found


def test_a_recording_holds_poses_boxes_keypoints_points_and_curves(results: list[LiveResult], tmp_path: Path) -> None:
    keep(RrdSink(tmp_path / "a.rrd"), results)
    rows = rows_of(tmp_path / "a.rrd")
    for result in results:
        frame, pose = result.frame.index, result.objects[0].pose
        assert rows["/plots/latency_ms"][frame]["scalars"] == [pytest.approx(result.latency_ms)]
        for part in pose.parts:
            path = f"/objects/0/{part.name}"
            if not isinstance(part, PartPose):
                assert rows["/plots/confidence/0/" + part.name][frame]["scalars"] == [0.0]
                assert rows[path][frame]["is_recursive"] == [True]
                continue
            T = np.asarray(part.T_camera_part)
            np.testing.assert_allclose(rows[path][frame]["translation"][0], T[:3, 3], atol=1e-6)
            columns = np.reshape(rows[path][frame]["mat3x3"][0], (3, 3))
            np.testing.assert_allclose(columns.T, T[:3, :3], atol=1e-6)
            np.testing.assert_allclose(2 * np.array(rows[f"{path}/box"][frame]["half_sizes"][0]), part.extents_m, 1e-5)
            keypoints_part = np.array(rows[f"{path}/keypoints"][frame]["positions"])
            np.testing.assert_allclose(apply(T, keypoints_part), part.keypoints_camera, atol=1e-6)
            np.testing.assert_allclose(rows[f"/plots/votes/0/{part.name}"][frame]["scalars"], part.scores)
        for joint in pose.joints:
            if joint.value is not None:
                shown = rows[f"/plots/joints/0/{joint.name}"][frame]["scalars"]
                assert shown == [pytest.approx(np.degrees(joint.value))]


def test_the_points_are_depth_readings_where_they_were_seen(results: list[LiveResult], tmp_path: Path) -> None:
    keep(RrdSink(tmp_path / "a.rrd"), results[:1])
    frame = results[0].frame
    points_camera = np.array(rows_of(tmp_path / "a.rrd")["/points"][frame.index]["positions"])
    assert MAX_POINTS / 4 < len(points_camera) < 1.5 * MAX_POINTS
    pixels = np.rint(frame.camera.project(points_camera)).astype(int)
    np.testing.assert_allclose(points_camera[:, 2], frame.depth_m[pixels[:, 1], pixels[:, 0]], rtol=1e-6)


def test_rerun_itself_finds_the_file_whole(results: list[LiveResult], tmp_path: Path) -> None:
    keep(RrdSink(tmp_path / "a.rrd"), [*results, empty_result(7)])
    program = Path(sys.executable).parent / "rerun"
    # With the table of its chunks, which is left out while it is written.
    for command in (["optimize", tmp_path / "a.rrd", "-o", tmp_path / "b.rrd"], ["verify", tmp_path / "b.rrd"]):
        done = subprocess.run([program, "rrd", *command], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    with pytest.raises(FileExistsError):
        RrdSink(tmp_path / "a.rrd")


def test_a_full_disk_is_told_once_and_rerun_does_not_wait_for_it(tmp_path: Path) -> None:
    told: list[str] = []
    sink = RrdSink(tmp_path / "a.rrd")
    with largest_file(400_000), Sinks([(sink, 60)], tell=told.append, close_s=60) as sinks:
        for i in range(60):
            sinks.put(noisy_result(i))
    counts = sinks.counts[sink.name]
    assert counts.written >= 1
    assert counts.failed == 60 - counts.written >= 1
    assert (tmp_path / "a.rrd").stat().st_size <= 400_000
    assert sum("File too large" in sentence for sentence in told) == 1


def test_a_viewer_that_is_closed_is_told_once_and_the_loop_goes_on() -> None:
    told: list[str] = []
    # Rerun's own server, which needs no display, in the place of its window.
    viewer = RerunViewer(arguments=("--serve-grpc",))
    with Sinks([(viewer, NEWEST)], tell=told.append, close_s=20) as sinks:
        sinks.put(empty_result(0))
        deadline = time.monotonic() + 20
        while sinks.counts[viewer.name].written == 0 and time.monotonic() < deadline:
            time.sleep(0.01)
        # With what it started: the program beside Python only starts another.
        os.killpg(viewer.process, signal.SIGKILL)
        os.waitid(os.P_PID, viewer.process, os.WEXITED | os.WNOWAIT)
        for i in range(100):
            sinks.put(empty_result(i))
    counts = sinks.counts[viewer.name]
    assert (counts.written, counts.closed) == (1, True)
    assert counts.failed + counts.dropped == 100
    assert sum("the viewer was closed" in sentence for sentence in told) == 1


def test_a_viewer_that_does_not_start_names_the_other_ways_to_look(tmp_path: Path) -> None:
    program = tmp_path / "rerun"
    program.write_text("#!/bin/sh\nexit 3\n")
    program.chmod(0o755)
    with pytest.raises(SourceError, match=r"did not start \(exit code 3\); it needs a display: --rrd FILE"):
        RerunViewer(executable=program)


def test_without_rerun_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(SourceError, match=r"pip install 'page-edge\[view\]'"):
        require_rerun()
    with pytest.raises(SourceError, match="view"):
        RrdSink(tmp_path / "a.rrd")
    assert not (tmp_path / "a.rrd").exists()
