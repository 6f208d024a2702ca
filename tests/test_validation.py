"""Validation as a whole: the same document however the work is shared out, interrupted or killed."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from page_runtime.cli import main
from page_runtime.validation.work import Task, do
from toy import LONG


def validate(recordings: list[Path], bundle: Path, out: Path, *more: str) -> bytes:
    given = [str(path) for path in recordings]
    assert main(["validate", *given, "--bundle", str(bundle), "--json", str(out), "--quiet", *more]) == 0
    return out.read_bytes()


def test_the_document_is_the_same_to_the_byte_again_by_two_processes_and_from_kept_results(
    long_recording: Path, oracle_bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recordings, results = [long_recording], tmp_path / "results"
    first = validate(recordings, oracle_bundle, tmp_path / "1.json")
    assert validate(recordings, oracle_bundle, tmp_path / "2.json") == first
    kept = ["--processes", "2", "--results", str(results)]
    assert validate(recordings, oracle_bundle, tmp_path / "3.json", *kept) == first
    (folder,) = results.iterdir()
    assert len(list(folder.iterdir())) == 2
    files = sorted(folder.iterdir())
    files[0].unlink()
    files[1].write_text(files[1].read_text()[:100])
    done: list[Task] = []
    monkeypatch.setattr(
        "page_runtime.validation.processes.do", lambda task, on_frame: (done.append(task), do(task, on_frame))[1]
    )
    assert validate(recordings, oracle_bundle, tmp_path / "4.json", "--results", str(results)) == first
    assert [(task.first, task.last) for task in done] == [(0, 20), (20, LONG)]
    assert validate(recordings, oracle_bundle, tmp_path / "5.json", "--results", str(results)) == first
    assert len(done) == 2
    # Another setting is other work.
    validate(recordings, oracle_bundle, tmp_path / "6.json", "--results", str(results), "--symmetry", "lid=z:2")
    assert len(done) == 4


def test_the_seed_is_of_the_intervals_alone(long_recording: Path, oracle_bundle: Path, tmp_path: Path) -> None:
    results = ["--results", str(tmp_path / "results")]
    one, other = (
        json.loads(validate([long_recording], oracle_bundle, tmp_path / f"{seed}.json", *results, "--seed", seed))
        for seed in ("0", "1")
    )
    assert one["parts"][0]["rotation_deg"]["mean"] == other["parts"][0]["rotation_deg"]["mean"]
    assert one["parts"][0]["rotation_deg"]["ci95"] != other["parts"][0]["rotation_deg"]["ci95"]


def test_several_recordings_are_summed_up_together_and_one_by_one(
    long_recording: Path, toy_recording: Path, oracle_bundle: Path, tmp_path: Path
) -> None:
    document = json.loads(validate([long_recording, toy_recording], oracle_bundle, tmp_path / "v.json"))
    assert document["frames"] == LONG + 3
    names = [one["recording"] for one in document["recordings"]]
    assert len(set(names)) == 2, "both folders are called toy"
    assert [one["frames"] for one in document["recordings"]] == [LONG, 3]
    (category,) = document["categories"]
    assert category["frames"] == document["frames"]
    for k, part in enumerate(document["parts"]):
        assert part["visible"] == sum(one["parts"][k]["visible"] for one in document["recordings"])
        missing = sum(one["parts"][k]["missing"] for one in document["recordings"])
        assert part["missing"] == missing > 0
        assert part["failure_rate"] == pytest.approx(missing / part["visible"])
        low, high = part["rotation_deg"]["ci95"]["mean"]
        assert low <= part["rotation_deg"]["mean"] <= high
        assert part["radius_m"]["median"] < 2e-3
        assert part["segmentation_accuracy"] > 0.9
    assert category["segmentation"]["accuracy"] > 0.9


def test_masks_of_other_parts_are_found_out(oracle_bundle: Path, toy_recording: Path, tmp_path: Path) -> None:
    shutil.copytree(toy_recording, tmp_path / "swapped")
    masks = tmp_path / "swapped" / "mask_visib"
    for frame in (0, 2):
        one, other = masks / f"{frame:06d}_000000.png", masks / f"{frame:06d}_000001.png"
        one.rename(masks / "kept")
        other.rename(one)
        (masks / "kept").rename(other)
    figures = json.loads(validate([tmp_path / "swapped"], oracle_bundle, tmp_path / "v.json"))["categories"][0]
    assert figures["segmentation"]["accuracy_on_object"] < 0.05
    shutil.rmtree(masks)
    figures = json.loads(validate([tmp_path / "swapped"], oracle_bundle, tmp_path / "v.json"))["categories"][0]
    assert figures["segmentation"] == {"points": 0, "accuracy": None, "accuracy_on_object": None}


def test_an_interrupted_validation_goes_on_where_it_was(
    long_recording: Path, oracle_bundle: Path, tmp_path: Path
) -> None:
    results = tmp_path / "results"
    command = [sys.executable, "-m", "page_runtime", "validate", str(long_recording), "--bundle", str(oracle_bundle)]
    process = subprocess.Popen(
        [*command, "--results", str(results)],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        # A shell's background jobs ignore this signal, and so would what is started from there.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stderr is not None
    for line in process.stderr:
        if "frame 21" in line:
            process.send_signal(signal.SIGINT)
            break
    process.communicate(timeout=60)
    assert process.returncode == 130
    assert [path.name for path in results.rglob("*.json")] == ["000000-000020.json"]
    again = subprocess.run([*command, "--results", str(results)], capture_output=True, text=True, check=True)
    assert "20 frames were done before" in again.stderr
    assert f"frame {LONG - 20} of {LONG - 20}" in again.stderr


BAD_CALLS: dict[str, tuple[list[str], str]] = {
    "no process": (["R", "--bundle", "B", "--processes", "0"], "--processes: expected at least 1, got 0"),
    "two ways to share": (
        ["R", "--bundle", "B", "--processes", "2", "--cluster", "tcp://h:1"],
        "--cluster: it has",
    ),
    "a symmetry in words": (["R", "--bundle", "B", "--symmetry", "round"], "--symmetry: expected none, or PART="),
    "a symmetry of no part": (["R", "--bundle", "B", "--symmetry", "door=z:2"], "no part 'door' in box"),
    "the same twice": (["R", "R", "--bundle", "B"], "the same recording was given twice"),
    "two bundles of a category": (["R", "--bundle", "B", "--bundle", "B"], "expected one --bundle for each"),
    "results in a file": (["R", "--bundle", "B", "--results", "B"], "--results: expected a folder, got the file"),
    "a page in no folder": (["R", "--bundle", "B", "--report", "/nowhere/at/all.html"], "--report: no folder"),
}


@pytest.mark.parametrize("case", BAD_CALLS)
def test_a_validation_that_cannot_be_is_refused_in_a_sentence(
    case: str, toy_recording: Path, oracle_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, sentence = BAD_CALLS[case]
    known = {"R": str(toy_recording), "B": str(oracle_bundle)}
    assert main(["validate", *(known.get(one, one) for one in arguments), "--quiet"]) == 2
    out, err = capsys.readouterr()
    assert (sentence in err, err.count("\n"), out) == (True, 1, ""), err


class Page(HTMLParser):
    """Tags that are opened and closed in order, and everything a page would fetch."""

    VOID = frozenset({"meta", "img", "br", "path", "rect", "circle"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.fetched: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        self.fetched += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "data")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def test_the_page_fetches_nothing_and_shows_the_worst_objects(
    long_recording: Path, oracle_bundle: Path, tmp_path: Path
) -> None:
    strange = tmp_path / "<b>toy & co"
    shutil.copytree(long_recording, strange)
    document = json.loads(validate([strange], oracle_bundle, tmp_path / "v.json", "--report", str(tmp_path / "v.html")))
    text = (tmp_path / "v.html").read_text(encoding="utf-8")
    read = Page(text)
    assert read.open == []
    pictures = [one for one in read.fetched if one.startswith("data:image/jpeg;base64,")]
    assert len(pictures) == len(read.fetched) == 12
    words = "".join(read.words)
    assert "Validation: <b>toy & co" in words
    assert "not seen" in words, "the blind frames are the worst"
    assert f"{document['parts'][0]['rotation_deg']['median']:.2f}" in words


def test_pictures_of_several_recordings_lie_in_folders_of_their_own(
    long_recording: Path, toy_recording: Path, oracle_bundle: Path, tmp_path: Path
) -> None:
    validate([toy_recording], oracle_bundle, tmp_path / "1", "--overlay", str(tmp_path / "one"))
    assert len(list((tmp_path / "one").glob("*.jpg"))) == 3
    both = tmp_path / "both"
    validate([toy_recording, long_recording], oracle_bundle, tmp_path / "2", "--overlay", str(both), "--processes", "2")
    assert sorted(len(list(folder.glob("*.jpg"))) for folder in {path.parent for path in both.rglob("*.jpg")}) == [
        3,
        LONG,
    ]
