"""Training frames by several processes: the same as by one, and none lost to one that is killed or interrupted."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from page_training.cache import make_shards
from page_training.categories import CATEGORIES
from page_training.cli import main
from page_training.records import shard_path

BOX = CATEGORIES["box"]


def files_of(root: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in shard_path(root, "box", "train", 0).parent.iterdir()}


def test_a_shard_is_the_same_whichever_process_makes_it(tmp_path: Path) -> None:
    heard: list[Path] = []
    make_shards(BOX, "train", range(3), tmp_path / "one", size=2)
    make_shards(BOX, "train", range(1), tmp_path / "two", size=2)
    make_shards(BOX, "train", range(3), tmp_path / "two", heard.append, processes=2, size=2)
    assert files_of(tmp_path / "one") == files_of(tmp_path / "two")
    assert sorted(heard) == [shard_path(tmp_path / "two", "box", "train", shard) for shard in range(3)]
    make_shards(BOX, "train", range(3), tmp_path / "two", heard.append, processes=2, size=2)
    assert heard[3:] == sorted(heard[:3])


def test_a_process_that_is_killed_loses_no_shard(tmp_path: Path) -> None:
    def kill_one(_: Path) -> None:
        child = multiprocessing.active_children()[0]
        assert child.pid is not None
        os.kill(child.pid, signal.SIGKILL)

    with pytest.raises(ChildProcessError, match="is there memory for 2"):
        make_shards(BOX, "train", range(6), tmp_path / "two", kill_one, processes=2, size=2)
    made = files_of(tmp_path / "two")
    assert 1 <= len(made) < 6
    make_shards(BOX, "train", range(6), tmp_path / "one", size=2)
    whole = files_of(tmp_path / "one")
    assert all(whole[name] == content for name, content in made.items() if name.endswith(".npy"))


def workers_of(process: subprocess.Popen[str]) -> list[Path]:
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    folders = [Path(f"/proc/{child}") for child in children]
    return [folder for folder in folders if b"spawn_main" in (folder / "cmdline").read_bytes()]


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="reads /proc")
def test_ctrl_c_ends_all_processes_at_once(tmp_path: Path) -> None:
    given = f"scenes box --frames 2048 --validation-frames 0 --processes 2 --cache {tmp_path}".split()
    # Where the tests themselves run in the background, Ctrl-C is ignored, and whoever they start inherits that.
    script = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from page_training.cli import main; sys.exit(main())"
    )
    making = subprocess.Popen(
        [sys.executable, "-c", script, *given], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 60
    while len(workers_of(making)) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)
    workers = workers_of(making)
    assert len(workers) == 2
    os.killpg(making.pid, signal.SIGINT)
    _, said = making.communicate(timeout=30)
    assert making.returncode == 130
    assert said.splitlines()[-1] == "page-train: interrupted; the same command goes on from here"
    assert "Traceback" not in said
    assert not any(folder.exists() for folder in workers)


def test_no_processes_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes", "box", "--processes", "0", "--cache", str(tmp_path)]) == 2
    assert "--processes: expected at least 1, got 0" in capsys.readouterr().err
