"""Sinks as a command line asks for them: all at once, or a sentence and nothing left behind."""

from __future__ import annotations

import argparse
import json
import socket
from pathlib import Path

import pytest

import toy
from live_results import results_of
from page_runtime.capture.playback import open_source
from page_runtime.commands.sink_options import STDOUT, SinkOptions, add_sink_options, open_sinks, take_sink_options
from page_runtime.commands.usage import UsageError
from page_runtime.image_files import SourceError
from page_runtime.schema import result_record


def parsed(*arguments: object) -> SinkOptions:
    parser = argparse.ArgumentParser()
    add_sink_options(parser)
    options = vars(parser.parse_args([str(argument) for argument in arguments]))
    found = take_sink_options(options)
    assert options == {}
    return found


def test_nothing_asked_for_is_no_sink() -> None:
    assert parsed() == SinkOptions()
    with open_sinks(SinkOptions(), tell=pytest.fail) as sinks:
        assert len(sinks) == 0


def test_options_are_read() -> None:
    assert parsed("--udp", "robot:9000", "--web", 8080, "--out", "-", "--view") == SinkOptions(
        out=STDOUT, udp=("robot", 9000), web=("", 8080), view=True
    )
    assert parsed("--udp", "[::1]:9000").udp == ("::1", 9000)
    assert parsed("--web", "0.0.0.0:8080").web == ("0.0.0.0", 8080)


@pytest.mark.parametrize(
    "arguments",
    [
        ("--udp", "9000"),
        ("--udp", "a:0"),
        ("--udp", "a:65536"),
        ("--web", "x"),
        ("--web", "-1"),
        ("--web", ":"),
        ("--udp", ":"),
    ],
)
def test_ports_that_are_none_are_refused(arguments: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parsed(f"{arguments[0]}={arguments[1]}")
    assert "expected" in capsys.readouterr().err


def test_all_sinks_at_once_get_the_results(toy_recording: Path, oracle_bundle: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    results = list(results_of(toy_recording, oracle_bundle))
    told: list[str] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(10)
        names = {option: tmp_path / f"a.{suffix}" for option, suffix in
                 (("--out", "jsonl"), ("--mcap", "mcap"), ("--rrd", "rrd"), ("--video", "mkv"))}  # fmt: skip
        options = parsed(
            *(text for pair in names.items() for text in pair),
            "--udp", f"127.0.0.1:{listener.getsockname()[1]}", "--web", 0,
        )  # fmt: skip
        assert set(options.new_files) == set(names)
        with open_sinks(options, tell=told.append, category=toy.CATEGORY) as sinks:
            assert len(sinks) == 6
            sinks.put(results[0])
            assert json.loads(listener.recv(1 << 16)) == result_record(results[0])
            for result in results[1:]:
                sinks.put(result)
    assert told[0].startswith("the page is at http://127.0.0.1:")
    counts = sinks.counts
    assert all(count.given == 3 and count.closed and not count.fault for count in counts.values())
    for option, path in names.items():
        assert path.stat().st_size > 0, option
    written = counts[f"lines {names['--out']}"].written
    assert len(names["--out"].read_text().splitlines()) == written
    assert open_source(names["--mcap"]).category == "box"


@pytest.mark.parametrize("option", ["--out", "--mcap", "--rrd", "--video"])
def test_what_is_there_already_is_never_overwritten(option: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("kept")
    with pytest.raises(UsageError, match=f"{option}: .* exists already"), open_sinks(parsed(option, path), tell=print):
        pass
    assert path.read_text() == "kept"


@pytest.mark.parametrize(
    ("option", "name"), [("--video", "a.webm"), ("--mcap", "a.bag"), ("--out", "no/folder/a.jsonl")]
)
def test_a_name_that_cannot_be_used_is_refused_before_anything_is_made(option: str, name: str, tmp_path: Path) -> None:
    options = parsed("--mcap", tmp_path / "b.mcap", option, tmp_path / name)
    with pytest.raises(UsageError, match=option), open_sinks(options, tell=print):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_sink_that_cannot_be_had_takes_the_others_files_with_it(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        options = parsed("--out", tmp_path / "a.jsonl", "--mcap", tmp_path / "a.mcap", "--web", taken.getsockname()[1])
        with pytest.raises(UsageError, match="--web: Address already in use"), open_sinks(options, tell=print):
            pass
    assert list(tmp_path.iterdir()) == []


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("page_runtime.sinks.rerun_log.importlib.util.find_spec", lambda _: None)
    options = parsed("--out", tmp_path / "a.jsonl", "--rrd", tmp_path / "a.rrd")
    with pytest.raises(SourceError, match=r"page-edge\[view\]"), open_sinks(options, tell=print):
        pass
    assert list(tmp_path.iterdir()) == []
