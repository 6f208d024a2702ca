"""What an export command is given is checked before anything is computed, and a refusal leaves every file as it was."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from page_export import cli, parity_commands
from page_export.bundle_writer import write_file
from page_export.cli import main
from page_export.optimise_command import MIN_OBJECTS, write_kept
from page_runtime.category_document import category_document
from page_training.categories import CATEGORIES
from page_training.checkpoint import save_checkpoint
from page_training.network import network_for

ROOT = Path(__file__).resolve().parents[1]
LAPTOPS = ROOT / "tests" / "data" / "laptop"
BOX = CATEGORIES["box"]


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of an untrained network of boxes."""
    path = tmp_path_factory.mktemp("checkpoint") / "box.pt"
    config = json.dumps({"augmentation": {"flip_probability": 0.5}})
    state = {"average": network_for(BOX).state_dict(), "category": json.dumps(category_document(BOX))}
    save_checkpoint(path, **state, config=config, step=1, samples=1)
    return path


@pytest.fixture
def command(
    oracle_bundle: Path, checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str, Path], list[str]]:
    """A command's arguments for a bundle of boxes, all it writes in `tmp_path`; nothing may be exported or compared."""

    def never(*_: object, **__: object) -> None:
        raise AssertionError("began to work before it looked at what it was given")

    for name in ("graph_of", "compare"):
        monkeypatch.setattr(parity_commands, name, never)
    bundle = str(shutil.copy(oracle_bundle, tmp_path / "box.onnx"))

    def arguments(name: str, recording: Path) -> list[str]:
        return {
            "onnx": ["onnx", str(checkpoint), "-o", str(tmp_path / "new.onnx"), "--compare-on", str(recording)],
            "verify": ["verify", bundle, "--against", str(checkpoint), "--data", str(recording)],
            "optimise": ["optimise", bundle, "-o", str(tmp_path / "forms"), "--data", str(recording)],
            "calibrate": ["calibrate", bundle, "--on", str(recording)],
            "profile": ["profile", bundle, "--data", str(recording)],
            "scorer": ["scorer", bundle, "-o", str(tmp_path / "new.onnx"), "--measure-on", str(recording)],
        }[name]

    return arguments


COMMANDS = ["onnx", "verify", "optimise", "calibrate", "profile", "scorer"]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_recording_of_another_category_is_refused_and_nothing_written(
    name: str, command: Callable[[str, Path], list[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = command(name, LAPTOPS)
    before = contents(tmp_path)
    assert main(given) == 2
    assert f"is for the category 'box', but {LAPTOPS} holds 'laptop'" in capsys.readouterr().err
    assert contents(tmp_path) == before
    assert not (tmp_path / "forms").exists()


@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_no_recording_is_refused_before_the_work(
    name: str, command: Callable[[str, Path], list[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("nothing")
    assert main(command(name, tmp_path / "other")) == 2
    assert "expected a page-edge recording" in capsys.readouterr().err


def test_the_last_of_several_recordings_is_looked_at_before_the_first_is_estimated(
    command: Callable[[str, Path], list[str]],
    toy_recording: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from page_export import calibrate_command

    monkeypatch.setattr(calibrate_command, "examples_from", lambda *_: pytest.fail("estimated"))
    assert main([*command("calibrate", toy_recording), str(LAPTOPS)]) == 2
    assert "holds 'laptop'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "option"),
    [("verify", "--json"), ("optimise", "--json"), ("onnx", "--output"), ("scorer", "--output")],
)
@pytest.mark.parametrize("place", ["folder", "missing/file"])
def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    name: str,
    option: str,
    place: str,
    command: Callable[[str, Path], list[str]],
    toy_recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "folder").mkdir()
    assert main([*command(name, toy_recording), option, str(tmp_path / place)]) == 2
    said = capsys.readouterr().err
    assert f"{option}: " in said
    assert str(tmp_path / place.split("/", maxsplit=1)[0]) in said


def test_a_form_is_recommended_on_enough_objects_only(
    command: Callable[[str, Path], list[str]], toy_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = command("optimise", toy_recording)
    assert main([*given, "--frames", str(MIN_OBJECTS - 1)]) == 2
    assert f"--frames: expected at least {MIN_OBJECTS} regions to measure on" in capsys.readouterr().err
    assert main([*given, "--frames", str(MIN_OBJECTS)]) == 2
    assert f"more than --frames {MIN_OBJECTS}" in capsys.readouterr().err
    assert not (tmp_path / "forms").exists()
    with pytest.raises(SystemExit):
        main(["optimise", "--help"])
    assert f"at least {MIN_OBJECTS};" in " ".join(capsys.readouterr().out.split())


def test_forms_that_are_refused_are_not_written_over_what_is_there(tmp_path: Path) -> None:
    made, kept = tmp_path / "made", tmp_path / "kept"
    made.mkdir()
    forms = {name: made / f"box.{name}.onnx" for name in ("good", "poor", "poorer")}
    for name, path in forms.items():
        path.write_text(f"new {name}")
    kept.mkdir()
    (kept / "box.poor.onnx").write_text("of before")
    said = write_kept(forms, {"poor", "poorer"}, kept)
    assert {path.name: path.read_text() for path in kept.iterdir()} == {
        "box.good.onnx": "new good",
        "box.poor.onnx": "of before",
    }
    assert f"{kept / 'box.poor.onnx'}: of an earlier run" in said
    assert "poorer" not in said


@pytest.mark.parametrize("points", ["0", "192", "2000", "8192"])
def test_points_that_no_network_is_exported_for_are_refused(
    points: str,
    command: Callable[[str, Path], list[str]],
    toy_recording: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([*command("onnx", toy_recording), "--points", points]) == 2
    assert f"--points: expected a multiple of 64 from 256 to 4096, got {points}" in capsys.readouterr().err


def test_an_interrupted_command_says_so_in_a_sentence(
    command: Callable[[str, Path], list[str]],
    toy_recording: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def interrupted(_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "_profile", interrupted)
    assert main(command("profile", toy_recording)) == 130
    assert capsys.readouterr().err.startswith("page-export: interrupted")


def test_a_file_is_replaced_without_touching_what_lies_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "box.onnx"
    (tmp_path / "box.partial").write_text("mine")
    for text in (b"first", b"second"):
        write_file(text, path)
        assert path.read_bytes() == text
    assert {one.name for one in tmp_path.iterdir()} == {"box.onnx", "box.partial"}
    assert (tmp_path / "box.partial").read_text() == "mine"


def test_a_link_stays_a_link_and_permissions_stay(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    target, link = tmp_path / "store" / "box-3.onnx", tmp_path / "box.onnx"
    target.write_bytes(b"first")
    target.chmod(0o640)
    link.symlink_to(target)
    write_file(b"second", link)
    assert link.is_symlink()
    assert target.read_bytes() == b"second"
    assert target.stat().st_mode & 0o777 == 0o640
    assert list((tmp_path / "store").iterdir()) == [target]


def test_a_write_that_fails_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError, match="taken"):
        write_file(b"bytes", tmp_path / "taken")
    assert [one.name for one in tmp_path.iterdir()] == ["taken"]
