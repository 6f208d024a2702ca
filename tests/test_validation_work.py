"""Validation's pieces of work: the same results in this process, in others and on a cluster, whoever is killed."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from page_runtime.cli import main
from page_runtime.content_hash import sha256_of
from page_runtime.validation import work
from page_runtime.validation.cluster import ClusterUnavailable, by_cluster, do_as_here
from page_runtime.validation.comparison import Comparison, comparison_document, comparison_from
from page_runtime.validation.processes import by_processes, one_after_the_other
from page_runtime.validation.results import ResultsFolder
from page_runtime.validation.work import Task, split
from toy import LONG


def tasks_of(recording: Path, bundle: Path) -> list[Task]:
    hashes = sha256_of(recording), sha256_of(bundle)
    return [
        Task(str(recording), hashes[0], str(bundle), hashes[1], first, last, looks=1, window_s=0.02, threads=1)
        for first, last in split(LONG, 5)
    ]


@pytest.fixture(scope="module")
def expected(long_recording: Path, oracle_bundle: Path) -> dict[Task, tuple[Comparison, ...]]:
    """The results of this process. Read only."""
    return dict(one_after_the_other(tasks_of(long_recording, oracle_bundle), lambda: None))


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


def test_pieces_of_work_cover_every_frame_once() -> None:
    for frames in (0, 1, 19, 20, 21, 40, 47):
        pieces: list[Any] = list(split(frames))
        assert [i for first, last in pieces for i in range(first, last)] == list(range(frames))
        assert all(0 < last - first <= work.FRAMES_PER_TASK for first, last in pieces)
