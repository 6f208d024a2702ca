"""The OAK path on real depthai pipelines that need no device: everything except the device itself."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from page_runtime.capture import oak
from page_runtime.capture.events import SourceDied, SourceEnded, SourceStalled
from page_runtime.capture.pairing import NO_PARTNER, NeverInSync
from page_runtime.capture.patience import Patience
from page_runtime.capture.supervision import SupervisedSource
from page_runtime.image_files import SourceError

if importlib.util.find_spec("depthai") is None:
    pytest.skip("depthai is not installed: pip install 'page-edge[oak]'", allow_module_level=True)

import host_pipelines

HASTY = Patience(stalled_s=0.5, restart_s=1.0, first_pause_s=0.05)


def open_host(script: dict[str, Any], **options: Any) -> SupervisedSource:
    factory = partial(host_pipelines.host_frames, script=script, **options)
    return SupervisedSource(factory, name="host", patience=HASTY, environment=oak.ENVIRONMENT)


@pytest.mark.parametrize("bgr", [False, True])
def test_frames_of_a_depthai_pipeline_arrive_bit_for_bit_with_camera_and_time(bgr: bool) -> None:
    with open_host({"bgr": bgr}) as source:
        taken = [recorded.frame for recorded, _ in zip(source, range(10), strict=False)]
        calibration = source.calibration
    assert calibration == host_pipelines.CALIBRATION
    for frame in taken:
        number = round(float(frame.depth_m[0, 0]) * 1e3) - 1000
        np.testing.assert_array_equal(frame.color, host_pipelines.color_pixels(number))
        np.testing.assert_array_equal(frame.depth_m, np.float32((1000 + number) * 1e-3))
        np.testing.assert_allclose(frame.camera.K, host_pipelines.K)
        assert (frame.camera.width, frame.camera.height) == (host_pipelines.WIDTH, host_pipelines.HEIGHT)
        assert abs(frame.timestamp_s - time.monotonic()) < 60
    steps = np.diff([frame.timestamp_s for frame in taken]) * host_pipelines.FPS
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    assert source.counts.color == source.counts.depth == source.counts.paired


def test_our_pairing_makes_the_pairs_that_depthai_itself_makes() -> None:
    script = {"depth_every": 2, "skew_s": 0.004, "frames": 40, "sleep_s": 0.004, "stops": True}
    theirs = host_pipelines.synced_numbers(script, threshold_s=0.01, groups=10)
    with open_host(script | {"sleep_s": 1 / 30, "stops": False, "window_s": 0.01}) as source:
        ours = [recorded.frame for recorded, _ in zip(source, range(10), strict=False)]
        counts = source.counts
    assert [number for number, _ in theirs] == [number for _, number in theirs] == list(range(0, 20, 2))
    assert all((round(float(frame.depth_m[0, 0]) * 1e3) - 1000) % 2 == 0 for frame in ours)
    assert all(frame.skew_s == pytest.approx(0.004, abs=1e-6) for frame in ours)
    assert counts.unpaired[NO_PARTNER] >= 9
    assert counts.max_skew_s == pytest.approx(0.004, abs=1e-6)


def test_depthai_killed_by_each_signal_comes_back(tmp_path: Path) -> None:
    script = {"signal_at": 10, "signals": host_pipelines.SIGNALS}
    with open_host(script, folder=str(tmp_path)) as source:
        deadline = time.monotonic() + 20
        for _ in source:
            assert time.monotonic() < deadline
            if len(source.outages_s) == 3:
                break
    reasons = [event.reason for event in source.events if isinstance(event, SourceDied)]
    assert reasons == ["killed by SIGSEGV", "killed by SIGABRT", "killed by SIGKILL"]
    assert all(outage < 5 for outage in source.outages_s)


def test_an_exception_in_a_host_node_aborts_depthai_and_not_us(tmp_path: Path) -> None:
    with open_host({"raise_at": 5}, folder=str(tmp_path)) as source:
        for _ in source:
            if source.outages_s:
                break
    assert [event.reason for event in source.events if isinstance(event, SourceDied)] == ["killed by SIGABRT"]


def test_a_node_that_returns_early_is_a_stall_although_the_pipeline_says_it_runs(tmp_path: Path) -> None:
    with open_host({"silent_at": 5}, folder=str(tmp_path)) as source:
        for _ in source:
            if source.outages_s:
                break
    assert any(isinstance(event, SourceStalled) and event.age_s < 1.0 for event in source.events)


def test_a_pipeline_that_stops_itself_ends_the_source() -> None:
    with open_host({"frames": 8, "stops": True}) as source:
        frames = list(source)
    assert frames
    assert isinstance(source.events[-1], SourceEnded)
    assert source.counts.paired == 8


def test_streams_that_are_never_in_sync_are_an_error_where_depthai_is_silent() -> None:
    with (
        open_host({"skew_s": 0.012, "window_s": 0.005, "sleep_s": 0.002}) as source,
        pytest.raises(NeverInSync, match="nearest seen lie"),
    ):
        list(source)


def test_depth_that_is_not_aligned_is_refused() -> None:
    with open_host({"depth_shape": (24, 32)}) as source, pytest.raises(SourceError, match="uint16 of 32x24; align it"):
        list(source)


def test_without_a_camera_opening_one_says_what_to_check_and_only_the_child_loads_depthai() -> None:
    code = (
        "import sys; from page_runtime.capture import oak\n"
        "from page_runtime.capture.frame_service import DeviceUnavailable\n"
        "try: oak.open_oak('oak:14442C10D13EABCE00')\n"
        "except DeviceUnavailable as error: print('depthai' in sys.modules, error)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert re.match("False no OAK camera found; is it plugged into a USB 3 port", answer.stdout)
    assert "page-runtime devices" in answer.stdout


def test_without_depthai_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(SourceError, match=r"pip install 'page-edge\[oak\]'"):
        oak.open_oak("oak")
