"""Bad input gets a sentence and exit code 2, and nothing is written."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import onnx
import pytest

import toy
from broken_recordings import BROKEN_RECORDINGS
from page_export.bundle_writer import bundle_bytes
from page_runtime.bundle import METADATA_KEY
from page_runtime.cli import main
from page_runtime.onnx_file import sealed
from page_runtime.recorded import Instance, RecordedFrame
from page_runtime.recording import RecordingWriter


def tree(folder: Path) -> dict[str, bytes | None]:
    return {str(path): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def refused(arguments: list[str], sentence: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command ends with 2, one line on standard error with the sentence in it, and nothing new in the folder."""
    before = tree(folder)
    capsys.readouterr()
    assert main([*arguments, "--quiet"] if arguments[0] in ("run", "validate", "bench") else arguments) == 2
    out, err = capsys.readouterr()
    assert err.startswith("page-runtime: ")
    assert err.count("\n") == 1
    assert re.search(sentence, err), err
    assert "Traceback" not in err
    assert out == ""
    assert tree(folder) == before


@pytest.mark.parametrize("case", BROKEN_RECORDINGS)
@pytest.mark.parametrize("command", ["run", "validate", "bench"])
def test_a_broken_recording_is_refused_in_a_sentence(
    command: str,
    case: str,
    toy_recording: Path,
    oracle_bundle: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    damage, sentence = BROKEN_RECORDINGS[case]
    shutil.copytree(toy_recording, tmp_path / "recording")
    damage(tmp_path / "recording")
    arguments = [command, str(tmp_path / "recording"), "--bundle", str(oracle_bundle)]
    outputs = ["--out" if command == "run" else "--json", str(tmp_path / "out")]
    if command != "bench":
        outputs += ["--overlay", str(tmp_path / "pictures")]
    refused([*arguments, *outputs], sentence, tmp_path, capsys)


def model_without_metadata(path: Path, good: Path) -> None:
    model = onnx.load(good)
    path.write_bytes(bundle_bytes(model, None))


def model_with_metadata(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path, Path], None]:
    def apply(path: Path, good: Path) -> None:
        model = onnx.load(good)
        (entry,) = [entry for entry in model.metadata_props if entry.key == METADATA_KEY]
        document = json.loads(entry.value)
        change(document)
        entry.value = json.dumps(document)
        path.write_bytes(sealed(model.SerializeToString()))

    return apply


BROKEN_BUNDLES: dict[str, tuple[Callable[[Path, Path], Any], str]] = {
    "absent": (lambda _path, _good: None, "no file"),
    "a folder": (lambda path, _: path.mkdir(), "no file"),
    "empty": (lambda path, _: path.touch(), "got 0"),
    "text": (lambda path, _: path.write_text("weights"), "is it a complete .onnx file"),
    "truncated": (lambda path, good: path.write_bytes(good.read_bytes()[:-200]), "bundle .*broken.onnx"),
    "half": (lambda path, good: path.write_bytes(good.read_bytes()[: good.stat().st_size // 2]), "bundle .*broken"),
    "a model of something else": (model_without_metadata, "no 'page.bundle' in the metadata"),
    "of a newer version": (model_with_metadata(lambda d: d.update(version=99)), r"broken\.onnx: .*version 5, got 99"),
    "lacking a field": (model_with_metadata(lambda d: d.pop("voxel_m")), r"broken\.onnx: .*missing \['voxel_m'\]"),
    "of other shapes": (model_with_metadata(lambda d: d.update(image_size=128)), "image .* 128, 128] by .*got .*224"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN_BUNDLES)
@pytest.mark.parametrize("command", ["run", "validate", "bench", "inspect"])
def test_a_broken_bundle_is_refused_in_a_sentence(
    command: str,
    case: str,
    toy_recording: Path,
    oracle_bundle: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    damage, sentence = BROKEN_BUNDLES[case]
    path = tmp_path / "broken.onnx"
    damage(path, oracle_bundle)
    if command == "inspect":
        refused(["inspect", str(path)], sentence, tmp_path, capsys)
    else:
        option = "--out" if command == "run" else "--json"
        arguments = [command, str(toy_recording), "--bundle", str(path), option, str(tmp_path / "out")]
        refused(arguments, sentence, tmp_path, capsys)


# {} stands for a folder with an empty folder, a folder of something else, a file, and a plain recording without boxes.
BAD_CALLS: dict[str, tuple[list[str], str]] = {
    "an empty folder": (["run", "{}/empty", "--bundle", "B"], "the folder is empty"),
    "no such folder": (["run", "{}/nowhere", "--bundle", "B"], "no such folder"),
    "a file": (["run", "{}/file", "--bundle", "B"], "found a file of another kind"),
    "a folder of something else": (["run", "{}/else", "--bundle", "B"], "found notes.txt"),
    "nothing says where the object is": (["run", "{}/plain", "--bundle", "B"], "pass --region x,y,w,h"),
    "nothing says where to look": (["bench", "{}/plain", "--bundle", "B"], "pass --region x,y,w,h"),
    "timed outside": (["bench", "R", "--bundle", "B", "--region", "320,0,10,10"], "320,0,10,10 lies outside"),
    "no regions": (["validate", "{}/plain", "--bundle", "B"], "object is; validate needs regions and true poses"),
    "no truth": (["validate", "{}/plain", "--bundle", "B"], "does not say where|no true poses"),
    "a region outside": (["run", "R", "--bundle", "B", "--region", "320,0,10,10"], "320,0,10,10 lies outside"),
    "a region of no size": (["run", "R", "--bundle", "B", "--region", "5,5,0,10"], "expected a positive size"),
    "a region of three numbers": (["run", "R", "--bundle", "B", "--region", "5,5,10"], "four whole numbers x,y,w,h"),
    "a region in words": (["run", "R", "--bundle", "B", "--region", "left"], "four whole numbers x,y,w,h"),
    "no bundle named": (["run", "R"], "--bundle"),
    "no command": ([], "COMMAND"),
    "an unknown command": (["estimate"], "estimate"),
    "fewer than no threads": (["run", "R", "--bundle", "B", "--threads", "-1"], "--threads"),
    "no look at all": (["run", "R", "--bundle", "B", "--looks", "0"], "--looks: expected at least 1, got 0"),
    "an output in no folder": (["run", "R", "--bundle", "B", "--out", "{}/nowhere/o"], "no folder"),
    "an output that is a folder": (["run", "R", "--bundle", "B", "--out", "{}/empty"], "got the folder"),
    "pictures into a file": (["run", "R", "--bundle", "B", "--overlay", "{}/file"], "got the file"),
    "pictures in no folder": (["run", "R", "--bundle", "B", "--overlay", "{}/nowhere/o"], "no folder"),
    "an output that is a device": (["run", "R", "--bundle", "B", "--out", "/dev/null"], "expected the name of a file"),
    "an output in a folder that takes none": (["run", "R", "--bundle", "B", "--out", "/proc/o"], "cannot write into"),
    "pictures in a folder that takes none": (["run", "R", "--bundle", "B", "--overlay", "/proc"], "cannot write into"),
    "figures in a folder that takes none": (["bench", "R", "--bundle", "B", "--json", "/proc/o"], "cannot write into"),
    "figures in no folder": (["bench", "R", "--bundle", "B", "--json", "{}/nowhere/o"], "no folder"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_CALLS)
def test_a_call_that_cannot_be_served_is_refused_in_a_sentence(
    case: str, toy_recording: Path, oracle_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, sentence = BAD_CALLS[case]
    (tmp_path / "empty").mkdir()
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "notes.txt").touch()
    (tmp_path / "file").touch()
    plain = tmp_path / "plain"
    recorded, _ = toy.toy_frame()
    with RecordingWriter(plain, category="box", part_names=("base", "lid")) as writer:
        writer.write(RecordedFrame(recorded.frame))
    known = {"R": str(toy_recording), "B": str(oracle_bundle)}
    filled = [known.get(argument, argument.replace("{}", str(tmp_path))) for argument in arguments]
    if not filled:
        assert main([]) == 2
        assert "page-runtime: " in capsys.readouterr().err
    else:
        refused(filled, sentence, tmp_path, capsys)


def test_a_recording_with_truth_in_no_frame_cannot_be_validated(
    oracle_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded, _ = toy.toy_frame()
    with RecordingWriter(tmp_path / "r", category="box", part_names=("base", "lid")) as writer:
        writer.write(RecordedFrame(recorded.frame, (Instance(recorded.instances[0].region),)))
    refused(["validate", str(tmp_path / "r"), "--bundle", str(oracle_bundle)], "no true poses", tmp_path, capsys)


def test_a_recording_of_blind_frames_cannot_be_timed(
    oracle_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = toy.write_toy_recording(tmp_path / "r", frames=1, blind=(0,))
    refused(["bench", str(recording), "--bundle", str(oracle_bundle)], "nothing to time", tmp_path, capsys)
