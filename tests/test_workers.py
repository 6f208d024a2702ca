"""Two processes at one training learn what one learns."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from page_training.cache import make_shard
from page_training.categories import CATEGORIES
from page_training.records import shard_path
from page_training.workers import Workers, join_workers


def trained(cache: Path, run: Path, processes: int, *more: str) -> dict:
    """The last line of the history of a short training by so many processes."""
    train = ["--cache", str(cache), "--run", str(run), "--samples", "96", "--batch-size", "4", "--threads", "1"]
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={processes}"]
    done = subprocess.run(
        [*torchrun, "-m", "--", "page_training.cli", "pose", "box", *train, *more],
        capture_output=True,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("checkpoint.pt") == 1
    return json.loads((run / "history.jsonl").read_text().splitlines()[-1])


def test_two_processes_have_the_losses_of_one(tmp_path: Path) -> None:
    for split in ("train", "validation"):
        make_shard(CATEGORIES["box"], split, 0, shard_path(tmp_path, "box", split, 0), size=12)
    one, two = (trained(tmp_path, tmp_path / f"run{count}", count) for count in (1, 2))
    assert one["step"] == two["step"] == 24
    # Each worker augments its rows by itself, so the losses are alike, not equal.
    for kind in ("losses", "validation"):
        assert two[kind]["total"] == pytest.approx(one[kind]["total"], rel=0.1)
    # A network whose image branch has no gradient can be shared, too.
    assert trained(tmp_path, tmp_path / "depth", 2, "--fusion", "depth")["step"] == 24


GRADIENTS = """
import sys
import torch
from torch import nn
from page_training.workers import join_workers, leave_workers


def work():
    workers = join_workers(8)
    torch.manual_seed(0)
    network, rows = nn.Sequential(nn.Linear(5, 4), nn.Tanh(), nn.Linear(4, 1)), torch.randn(8, 5)
    module = workers.joined(network, all_used=True)
    module(torch.from_numpy(workers.rows(rows.numpy()))).square().mean().backward()
    means = workers.means({"rank": float(workers.rank)})
    torch.save(([p.grad for p in network.parameters()], means), f"{sys.argv[1]}/{workers.rank}.pt")


work()
leave_workers()
"""


def test_gradients_are_those_of_the_whole_batch_on_every_worker(tmp_path: Path) -> None:
    script = tmp_path / "gradients.py"
    script.write_text(GRADIENTS)
    for count in (1, 2):
        folder = tmp_path / str(count)
        folder.mkdir()
        torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={count}"]
        done = subprocess.run([*torchrun, str(script), str(folder)], capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
    whole, _ = torch.load(tmp_path / "1" / "0.pt")
    for rank in (0, 1):
        gradients, means = torch.load(tmp_path / "2" / f"{rank}.pt")
        assert means == {"rank": 0.5}
        for one, other in zip(whole, gradients, strict=True):
            torch.testing.assert_close(one, other)


def test_workers_share_every_batch_without_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    records = np.arange(12)
    shares = [Workers(rank, 3).rows(records) for rank in range(3)]
    assert sorted(np.concatenate(shares).tolist()) == records.tolist()
    assert {len(share) for share in shares} == {4}
    monkeypatch.setenv("WORLD_SIZE", "5")
    with pytest.raises(ValueError, match="multiple of the 5 processes, got 12"):
        join_workers(12)
    monkeypatch.delenv("WORLD_SIZE")
    assert join_workers(12) == Workers(0, 1)
