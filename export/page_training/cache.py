"""Making training samples: scenes rendered, sampled as the runtime samples, written to shards.

Making a frame costs about as much as learning from it once, so frames are made ahead and used a few times. A shard
depends on (the scenes' version, category, split, shard number) alone, for a category of the user's own on its files as
well: any process may make any of them, in any order, and an interrupted run goes on with the shards that are missing.
The bound on disk is the number of shards asked for.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from page_runtime.category import Category
from page_runtime.geometry import Array
from page_runtime.neighbours import LEVELS, find_neighbours
from page_runtime.sampling import RegionSample
from page_training.focusing import samples_of_region
from page_training.records import IMAGE_SIZE, NEIGHBOUR_TABLES, SHARD_SIZE, SPLITS, record_type, shard_path
from page_training.scenes import SceneView, sample_scene, training_view


class Truth(Protocol):
    """What a record keeps of a part's truth, of a scene's view or of a recording."""

    @property
    def T_camera_part(self) -> Array: ...
    @property
    def extents_m(self) -> Array: ...
    @property
    def visible_share(self) -> float | None: ...


def shard_generator(category: str, split: str, shard: int) -> np.random.Generator:
    """The random stream of one shard; streams of different splits never meet, so no instance is in two of them."""
    return np.random.default_rng([zlib.crc32(category.encode()), SPLITS.index(split), shard])


def fill_record(
    record: Any,
    sample: RegionSample,
    *,
    labels: NDArray[np.int64],
    normals_camera: NDArray[np.float32],
    truths: Sequence[Truth],
) -> None:
    """Write the sampled points of a view into a record of `record_type`.

    labels: (N,) part of each point, the number of parts for background. normals_camera: (H,W,3) of the view.
    """
    record["image"] = sample.image
    record["points"] = sample.points_camera - sample.center_camera
    record["pixels"] = sample.pixels
    record["normals"] = np.round(normals_camera.reshape(-1, 3)[sample.source_index] * 127)
    record["labels"] = labels
    neighbours = find_neighbours(record["points"], answered=LEVELS[0])
    for name in NEIGHBOUR_TABLES:
        record[name] = getattr(neighbours, name)
    for k, truth in enumerate(truths):
        record["T_center_part"][k] = truth.T_camera_part
        record["T_center_part"][k, :3, 3] -= sample.center_camera
        record["extents_m"][k] = truth.extents_m
        record["visible_share"][k] = 1.0 if truth.visible_share is None else truth.visible_share


def make_shard(category: Category, split: str, shard: int, path: Path, size: int = SHARD_SIZE) -> None:
    """Make one shard of `size` records and write it whole or not at all."""
    rng = shard_generator(category.name, split, shard)
    records = np.zeros(size, record_type(len(category.parts)))
    whole, filled = (0, 0, IMAGE_SIZE, IMAGE_SIZE), 0
    while filled < size:
        view = training_view(sample_scene(category.name, rng, split), rng, IMAGE_SIZE)

        def labels_of(sample: RegionSample, view: SceneView = view) -> NDArray[np.int64]:
            labels = view.part_mask.ravel()[sample.source_index].astype(np.int64) - 1
            return np.where(labels < 0, len(category.parts), labels)

        for sample in samples_of_region(category, view.frame, whole, 0.0, labels_of, rng)[: size - filled]:
            fill_record(
                records[filled],
                sample,
                labels=labels_of(sample),
                normals_camera=view.normals_camera,
                truths=view.truths,
            )
            filled += 1
    write_shard(path, records)


def write_shard(path: Path, records: NDArray[Any]) -> None:
    """Write records as a shard, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    with partial.open("wb") as file:
        np.save(file, records)
    partial.rename(path)


def make_shards(
    category: Category,
    split: str,
    shards: range,
    root: Path,
    on_shard: Callable[[Path], None] = lambda _: None,
    processes: int = 1,
    size: int = SHARD_SIZE,
) -> None:
    """Make the missing ones of `shards`, of `size` records, so many at once; `on_shard` hears of each that is there.

    A shard is the same whichever process makes it. ChildProcessError where one was killed; the shards made stay.
    """
    paths = [shard_path(root, category.name, split, shard) for shard in shards]
    missing = [(shard, path) for shard, path in zip(shards, paths, strict=True) if not path.exists()]
    for path in sorted(set(paths) - {path for _, path in missing}):
        on_shard(path)
    if processes == 1 or len(missing) < 2:
        for shard, path in missing:
            make_shard(category, split, shard, path, size)
            on_shard(path)
        return
    others = set(multiprocessing.active_children())
    # Fresh interpreters: OpenCV's threads do not survive a fork.
    with ProcessPoolExecutor(min(processes, len(missing)), multiprocessing.get_context("spawn")) as pool:
        try:
            with _interrupts_held():
                running = {pool.submit(make_shard, category, split, shard, path, size): path for shard, path in missing}
            for future in as_completed(running):
                future.result()
                on_shard(running[future])
        except BaseException as error:
            for child in set(multiprocessing.active_children()) - others:
                child.terminate()
            if isinstance(error, BrokenProcessPool):
                raise ChildProcessError(
                    f"a process that makes scenes of {category.name!r} was killed; is there memory for {processes}? "
                    "The shards made are whole, and the same command with fewer --processes makes the others"
                ) from error
            raise


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C within comes at the end. Processes started within never hear it: it goes to the whole group, and is for
    the one that started them to answer."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
