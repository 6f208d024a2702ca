"""Commands with a camera: none there, recorded, interrupted, unplugged; and which of them open a socket."""

from __future__ import annotations

import importlib.util
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import recorded_toy
from page_runtime.capture import oak
from page_runtime.capture.playback import open_source
from page_runtime.cli import EXIT_NO_CAMERA, main
from recorded_toy import ENVIRONMENT


@pytest.mark.parametrize("arguments", [["bench", "oak"], ["validate", "oak"], ["convert", "oak", "out.mcap"]])
def test_commands_that_need_a_recording_refuse_a_camera(arguments: list[str], oracle_bundle: Path, capsys) -> None:
    bundle = [] if arguments[0] == "convert" else ["--bundle", str(oracle_bundle)]
    assert main([*arguments, *bundle]) == 2
    assert "expected a recording, got the camera 'oak'" in capsys.readouterr().err


def test_run_and_live_with_a_camera_need_no_region_but_a_camera(oracle_bundle: Path, capsys) -> None:
    for command in ("run", "live"):
        assert main([command, "oak", "--bundle", str(oracle_bundle)]) == EXIT_NO_CAMERA
        assert "no OAK camera found" in capsys.readouterr().err
    assert main(["live", "oak", "--bundle", str(oracle_bundle), "--mask", "."]) == 2
    assert "--mask: the frames of oak are not known before they come" in capsys.readouterr().err


def test_a_folder_called_oak_can_still_be_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded_toy.writer_of("recording", "oak")(tmp_path, recorded_toy.frames(2))
    monkeypatch.chdir(tmp_path)
    assert main(["convert", "./oak", "out.mcap", "--quiet"]) == 0
    assert len(open_source(tmp_path / "out.mcap")) == 2


@pytest.mark.skipif(importlib.util.find_spec("depthai") is None, reason="depthai is not installed")
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
@pytest.mark.parametrize("command", ["devices", "run"])
def test_without_a_camera_the_exit_code_is_3_and_no_connection_is_tried(
    command: str, oracle_bundle: Path, tmp_path: Path
) -> None:
    trace = tmp_path / "trace"
    options = (
        ["devices"] if command == "devices" else ["run", "oak", "--region", "1,1,9,9", "--bundle", str(oracle_bundle)]
    )
    answer = subprocess.run(
        ["strace", "-f", "-qq", "-e", "trace=network", "-o", trace, sys.executable, "-m", "page_runtime", *options],
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
        timeout=60,
    )
    assert answer.returncode == EXIT_NO_CAMERA
    assert answer.stderr.count("\n") == 1
    assert "no OAK camera found; is it plugged into a USB 3 port" in answer.stderr
    calls = trace.read_text().splitlines()
    assert not [call for call in calls if "connect(" in call and "AF_INET" in call]
    # The search for cameras in the local network is a broadcast to Luxonis' port; nothing else is sent.
    sent = [call for call in calls if re.search(r"send(to|msg)\(", call) and "AF_INET" in call]
    assert all("htons(11491)" in call and '.255")' in call for call in sent)


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
def test_playing_recording_and_estimating_open_no_socket(tmp_path: Path, oracle_bundle: Path) -> None:
    trace = tmp_path / "trace"
    path = recorded_toy.writer_of("mcap", "a.mcap")(tmp_path, recorded_toy.frames(2))
    code = (
        "import sys; from page_runtime.cli import main\n"
        f"assert main(['record', {str(path)!r}, {str(tmp_path / 'r')!r}, '--quiet']) == 0\n"
        f"assert main(['run', {str(tmp_path / 'r')!r}, '--bundle', {str(oracle_bundle)!r}, '--quiet']) == 0\n"
    )
    subprocess.run(
        ["strace", "-f", "-qq", "-e", "trace=socket,connect,sendto", "-o", trace, sys.executable, "-c", code],
        capture_output=True,
        check=True,
        env=ENVIRONMENT,
        timeout=60,
    )
    assert not [call for call in trace.read_text().splitlines() if "AF_INET" in call]


def start_recording(target: Path, factory: str) -> subprocess.Popen[str]:
    """`page-runtime record oak` with another camera in a child process of its own."""
    code = (
        "import sys; from functools import partial; import live_sources\n"
        "from page_runtime.cli import main\n"
        "from page_runtime.capture.supervision import SupervisedSource\n"
        "import page_runtime.commands.sources as sources\n"
        "sources.open_oak = lambda name, window_s, on_event: SupervisedSource(\n"
        f"    {factory}, name=name, on_event=on_event)\n"
        f"sys.exit(main(['record', 'oak', {str(target)!r}]))\n"
    )
    return subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, env=ENVIRONMENT, text=True)


@pytest.mark.parametrize(("number", "name"), [(signal.SIGINT, "folder"), (signal.SIGTERM, "file.mcap")])
def test_ctrl_c_and_sigterm_end_a_recording_of_a_camera_with_all_its_frames(
    number: signal.Signals, name: str, tmp_path: Path
) -> None:
    process = start_recording(tmp_path / name, "live_sources.count_up")
    assert process.stderr is not None
    while "frames arrive" not in process.stderr.readline():
        assert process.poll() is None
    time.sleep(0.4)
    process.send_signal(number)
    rest = process.stderr.read()
    assert process.wait() == 0, rest
    said = re.search(r"(\d+) frames in", rest)
    assert said is not None
    source = open_source(tmp_path / name)
    assert len(source) == int(said[1]) > 0
    assert source.counts.complete
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["folder", "file.mcap"])
def test_what_a_camera_gave_before_it_was_lost_is_kept(name: str, tmp_path: Path) -> None:
    process = start_recording(tmp_path / name, "partial(live_sources.fail, kind='lost')")
    _, error = process.communicate()
    assert process.returncode == 2
    assert error.rstrip().endswith("page-runtime: the camera was unplugged")
    assert len(open_source(tmp_path / name)) == 1


def test_oak_is_the_only_word_for_a_camera() -> None:
    assert [name for name in ("oak", "oak:1", "./oak", "oak/", "oaks", "Oak") if oak.is_oak(name)] == ["oak", "oak:1"]
