"""What can go wrong while training: corrupt frames, broken shards, a full disk. Nothing that was learned is lost."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from page_training.cache import make_shard
from page_training.categories import CATEGORIES
from page_training.checkpoint import load_checkpoint
from page_training.cli import main
from page_training.config import TrainingConfig
from page_training.records import fault_of, open_shards, record_type, shard_path
from page_training.train import train

BOX = CATEGORIES["box"]


@pytest.fixture(scope="module")
def shard(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    path = tmp_path_factory.mktemp("cache") / "shard.npy"
    make_shard(BOX, "train", 0, path, size=4)
    return np.load(path)


def cache_of(root: Path, records: np.ndarray) -> Path:
    path = shard_path(root, "box", "train", 0)
    path.parent.mkdir(parents=True)
    np.save(path, records)
    return path


def _set(name: str, value: Any) -> Callable[[Any], None]:
    def change(record: Any) -> None:
        record[name].flat[0] = value

    return change


CORRUPTIONS = {
    "points are not finite": _set("points", np.nan),
    "pixels are not finite": _set("pixels", np.inf),
    "T_center_part are not finite": _set("T_center_part", np.nan),
    "extents_m are": _set("extents_m", -0.1),
    "a label is 77, of 2 parts": _set("labels", 77),
    "group1 names points beyond the 2048": _set("group1", 2048),
    "up1 names points beyond the 512": _set("up1", -1),
    "up3 names points beyond the 32": _set("up3", 32),
}


@pytest.mark.parametrize("sentence", CORRUPTIONS)
def test_a_corrupt_frame_is_named(sentence: str, shard: np.ndarray, tmp_path: Path) -> None:
    records = shard.copy()
    assert all(fault_of(record) is None for record in records)
    CORRUPTIONS[sentence](records[2])
    fault = fault_of(records[2])
    assert fault is not None
    assert sentence in fault
    path = cache_of(tmp_path, records)
    config = TrainingConfig("box", samples=40, batch_size=4, dense_points=64)
    with pytest.raises(ValueError, match=f"frame 2 of {path}: {sentence}"):
        train(config, BOX, tmp_path, tmp_path / "run", lambda _: None)


def test_corrupt_frames_are_skipped_when_told_to(
    shard: np.ndarray, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The run then learns from the others alone: whatever the corrupt frame held, the weights are the same."""
    weights = []
    for value in (np.nan, np.inf):
        records = shard.copy()
        records["points"][1] = value
        cache, run = tmp_path / f"cache{value}", tmp_path / f"run{value}"
        path = cache_of(cache, records)
        budget = ["--samples", "8", "--batch-size", "4", "--cache", str(cache), "--run", str(run)]
        assert main(["pose", "box", *budget]) == 2
        assert f"frame 1 of {path}" in capfd.readouterr().err
        assert main(["pose", "box", *budget, "--skip-corrupt"]) == 0
        assert f"skipped frame 1 of {path}: points are not finite" in capfd.readouterr().err
        weights.append(load_checkpoint(run / "checkpoint.pt")["network"])
    assert all(np.array_equal(weights[0][name], weights[1][name]) for name in weights[0])


def test_a_cache_of_nothing_but_corrupt_frames_ends_the_run(shard: np.ndarray, tmp_path: Path) -> None:
    records = shard.copy()
    records["points"] = np.nan
    cache_of(tmp_path, records)
    config = TrainingConfig("box", samples=4, batch_size=4, dense_points=64)
    with pytest.raises(ValueError, match="corrupt frames in a row"):
        train(config, BOX, tmp_path, tmp_path / "run", lambda _: None, on_fault=lambda _: None)


@pytest.mark.parametrize("broken", ["cut", "empty", "text", "other"])
def test_a_broken_shard_is_named(broken: str, shard: np.ndarray, tmp_path: Path) -> None:
    path = cache_of(tmp_path, shard)
    whole = path.read_bytes()
    contents = {"cut": whole[: len(whole) // 2], "empty": b"", "text": b"no array"}
    if broken == "other":
        np.save(path, np.zeros(5))
    else:
        path.write_bytes(contents[broken])
    with pytest.raises(ValueError, match=f"shard {path}"):
        open_shards(tmp_path, "box", "train")


def test_records_of_any_number_of_parts_are_shards(tmp_path: Path) -> None:
    path = shard_path(tmp_path, "arm", "train", 0)
    path.parent.mkdir(parents=True)
    np.save(path, np.zeros(2, record_type(7)))
    assert len(open_shards(tmp_path, "arm", "train")[0]) == 2


def test_a_full_disk_leaves_the_last_checkpoint_to_go_on_from(shard: np.ndarray, tmp_path: Path) -> None:
    """No file may grow beyond a megabyte in the process that goes on: less than a checkpoint."""
    cache, run = tmp_path / "cache", tmp_path / "run"
    cache_of(cache, shard)
    budget = ["--batch-size", "2", "--cache", str(cache), "--run", str(run)]
    assert main(["pose", "box", "--samples", "4", *budget]) == 0
    before = (run / "checkpoint.pt").read_bytes()
    limit = 1 << 20
    done = subprocess.run(
        [sys.executable, "-m", "page_training.cli", "pose", "box", "--samples", "8", *budget],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        capture_output=True,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        timeout=120,
    )
    assert done.returncode == 2, done.stderr
    assert "is the disk full?" in done.stderr
    assert "Traceback" not in done.stderr
    assert (run / "checkpoint.pt").read_bytes() == before
    assert not list(run.glob("*.partial"))
    assert main(["pose", "box", "--samples", "8", *budget]) == 0
    assert load_checkpoint(run / "checkpoint.pt")["step"] == 4
