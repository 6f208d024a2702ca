"""Validation as a whole: the same document however the work is shared out, interrupted or killed."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import toy
from page_runtime.cli import main
from page_runtime.content_hash import sha256_of
from page_runtime.recording import RecordingWriter
from page_runtime.validation import work
from page_runtime.validation.cluster import ClusterUnavailable, by_cluster, do_as_here
from page_runtime.validation.comparison import Comparison, comparison_document, comparison_from
from page_runtime.validation.processes import by_processes, one_after_the_other
from page_runtime.validation.results import ResultsFolder
from page_runtime.validation.work import Task, do, split

FRAMES = 36


@pytest.fixture(scope="module")
def long_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pieces of work: frames of the toy that differ in their noise, some of them blind. Read only."""
    rng = np.random.default_rng(0)
    recorded, masks = toy.toy_frame(toy.toy_camera(160, 120))
    path = tmp_path_factory.mktemp("long") / "toy"
    with RecordingWriter(path, category="box", part_names=("base", "lid"), depth_unit_mm=0.1) as writer:
        for index in range(FRAMES):
            depth_m = recorded.frame.depth_m + rng.normal(0, 0.001, recorded.frame.depth_m.shape).astype(np.float32)
            if index % 20 == 7:
                depth_m[:] = 0
            frame = type(recorded.frame)(recorded.frame.color, depth_m, recorded.frame.camera, index / 30, index)
            writer.write(type(recorded)(frame, recorded.instances), masks=[masks])
    return path


def tasks_of(recording: Path, bundle: Path) -> list[Task]:
    hashes = sha256_of(recording), sha256_of(bundle)
    return [
        Task(str(recording), hashes[0], str(bundle), hashes[1], first, last, looks=1, window_s=0.02, threads=1)
        for first, last in split(FRAMES, 5)
    ]


@pytest.fixture(scope="module")
def expected(long_recording: Path, oracle_bundle: Path) -> dict[Task, tuple[Comparison, ...]]:
    """The results of this process. Read only."""
    return dict(one_after_the_other(tasks_of(long_recording, oracle_bundle), lambda: None))


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
    assert [(task.first, task.last) for task in done] == [(0, 20), (20, FRAMES)]
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
    assert document["frames"] == FRAMES + 3
    names = [one["recording"] for one in document["recordings"]]
    assert len(set(names)) == 2, "both folders are called toy"
    assert [one["frames"] for one in document["recordings"]] == [FRAMES, 3]
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


def test_comparisons_survive_json_unchanged(expected: dict[Task, tuple[Comparison, ...]]) -> None:
    for one in (one for found in expected.values() for one in found):
        assert comparison_from(json.loads(json.dumps(comparison_document(one)))) == one


def test_results_are_of_one_bundle_and_setting(
    expected: dict[Task, tuple[Comparison, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = ResultsFolder(tmp_path)
    task, found = next(iter(expected.items()))
    assert folder.kept(task) is None
    folder.keep(task, found)
    assert folder.kept(task) == found
    from dataclasses import replace

    assert folder.kept(replace(task, recording="/elsewhere/toy")) == found
    assert folder.kept(replace(task, threads=7)) is None
    assert folder.kept(replace(task, looks=2)) is None
    assert folder.kept(replace(task, bundle_sha256="0" * 64)) is None
    monkeypatch.setattr("page_runtime.validation.results.own_code_sha256", lambda: "other code")
    assert folder.kept(task) is None


def test_a_process_that_is_killed_loses_no_result(expected: dict[Task, tuple[Comparison, ...]]) -> None:
    found: dict[Task, tuple[Comparison, ...]] = {}
    for task, result in by_processes(list(expected), 2):
        if not found:
            victims = multiprocessing.active_children()
            assert victims
            victims[0].kill()
        assert task not in found
        found[task] = result
    assert found == expected


def test_a_worker_of_a_cluster_that_is_killed_loses_no_result(
    expected: dict[Task, tuple[Comparison, ...]],
) -> None:
    distributed = pytest.importorskip("distributed", reason="the cluster needs the extra cluster")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        workers = list(client.run(os.getpid).values())
        assert len(set(workers)) == 2
        found: dict[Task, tuple[Comparison, ...]] = {}
        for task, result in by_cluster(list(expected), cluster.scheduler_address):
            if not found:
                os.kill(workers[0], signal.SIGKILL)
            found[task] = result
    assert found == expected


def test_a_worker_that_runs_other_code_gives_no_result(expected: dict[Task, tuple[Comparison, ...]]) -> None:
    with pytest.raises(ClusterUnavailable, match="runs another version of page_runtime"):
        do_as_here(next(iter(expected)), "of other code")


def test_a_cluster_that_does_not_answer_is_a_sentence(
    long_recording: Path, oracle_bundle: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("page_runtime.validation.cluster.CONNECT_TIMEOUT_S", 1)
    call = ["validate", str(long_recording), "--bundle", str(oracle_bundle), "--cluster", "tcp://127.0.0.1:1"]
    assert main([*call, "--quiet"]) == 2
    assert "no Dask scheduler answers at tcp://127.0.0.1:1" in capsys.readouterr().err
    with pytest.raises(ClusterUnavailable):
        list(by_cluster([], "tcp://127.0.0.1:1"))


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
    assert f"frame {FRAMES - 20} of {FRAMES - 20}" in again.stderr


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
        FRAMES,
    ]


def test_pieces_of_work_cover_every_frame_once() -> None:
    for frames in (0, 1, 19, 20, 21, 40, 47):
        pieces: list[Any] = list(split(frames))
        assert [i for first, last in pieces for i in range(first, last)] == list(range(frames))
        assert all(0 < last - first <= work.FRAMES_PER_TASK for first, last in pieces)
