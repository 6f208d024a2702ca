"""Training on CPU: resumable to the step, with an averaged copy of the weights that is what gets exported."""

from __future__ import annotations

import copy
import ctypes
import ctypes.util
import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from page_runtime.category import Category
from page_runtime.category_document import category_document
from page_training.approach import SCORING, Approach
from page_training.batches import Batch, make_batch
from page_training.checkpoint import keep_weights, load_checkpoint, load_start, save_checkpoint
from page_training.config import TrainingConfig
from page_training.optimization import optimizers_for, set_learning_rate, update_average
from page_training.records import fault_of, open_shards, other_frames
from page_training.run_folder import add_report, begin, require_same_run, validation_totals
from page_training.targets import settled_targets
from page_training.validation import validation_losses, validation_picture
from page_training.workers import Workers, join_workers

# Of corrupt frames in a row before a cache is given up.
MAX_DRAWS = 20
HISTORY = ("step", "steps", "samples_per_s", "losses", "validation")
M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_THRESHOLD = -1, -2, -3


@dataclass(frozen=True, slots=True)
class Report:
    """What a training step tells its watcher. losses: mean since the last report; validation, and its picture (H,W,3)
    RGB: None between rounds."""

    step: int
    steps: int
    samples_per_s: float
    losses: dict[str, float]
    validation: dict[str, float] | None
    picture: NDArray[np.uint8] | None = None


def keep_freed_memory() -> None:
    """Let glibc keep freed blocks instead of returning them to the kernel after every tensor.

    Without this a step spends much of its time in page faults (16 against 23 frames/s on one core, batches of 16). A
    batch of 12 keeps the largest tensor under glibc's 32 MiB limit for blocks it will keep. Off glibc it does nothing.
    """
    name = ctypes.util.find_library("c")
    if sys.platform != "linux" or name is None:
        return
    libc = ctypes.CDLL(name)
    if hasattr(libc, "mallopt"):
        libc.mallopt(M_MMAP_THRESHOLD, 32 << 20)
        libc.mallopt(M_TRIM_THRESHOLD, 2**31 - 1)
        libc.mallopt(M_TOP_PAD, 256 << 20)


def _draw(
    shards: list[NDArray[Any]], rng: np.random.Generator, count: int, on_fault: Callable[[str], None] | None
) -> list[Any]:
    """`count` sound records at random from all shards. on_fault: told of each that is not, for which another is drawn;
    None: ValueError."""
    drawn: list[Any] = []
    told = ""
    for number in rng.integers(len(shards), size=count) if count else ():
        for _ in range(MAX_DRAWS):
            shard = shards[number]
            row = rng.integers(len(shard))
            fault = fault_of(shard[row])
            if fault is None:
                drawn.append(shard[row])
                break
            told = f"frame {row} of {getattr(shard, 'filename', 'a shard')}: {fault}"
            if on_fault is None:
                raise ValueError(f"{told}; delete that file and make it anew, or skip such frames")
            on_fault(told)
            number = rng.integers(len(shards))
        else:
            raise ValueError(f"{MAX_DRAWS} corrupt frames in a row, the last {told}; delete the cache and make it anew")
    return drawn


def _shards_for(cache: Path, category: Category, maker: str = "scenes") -> list[NDArray[Any]]:
    shards = open_shards(cache, category.name, "train")
    if not shards:
        others = ", ".join(path.name for path in other_frames(cache, category.name))
        old = f" ({others}: of another make of it, not used, may be deleted)" if others else ""
        raise FileNotFoundError(
            f"no training shards of {category.name!r} in {cache}{old}; run page-train {maker} first"
        )
    return shards


def _batches(
    config: TrainingConfig,
    category: Category,
    cache: Path,
    also: list[NDArray[Any]],
    steps: range,
    workers: Workers,
    on_fault: Callable[[str], None] | None,
) -> Iterator[tuple[int, Batch]]:
    """This worker's rows of batch number `step`, which depend only on the seed, the step, the number of workers and the
    cached frames, so a resumed run repeats them."""
    shards = _shards_for(cache, category)
    for step in steps:
        if step % 200 == 0:
            shards = _shards_for(cache, category)
        rng = np.random.default_rng([config.seed, step])
        others = int(rng.binomial(config.batch_size, config.also_share)) if also else 0
        # Mixed, because the workers take rows in turn.
        records = np.stack(
            _draw(shards, rng, config.batch_size - others, on_fault) + _draw(also, rng, others, on_fault)
        )
        records = rng.permutation(records) if also else records
        generator = torch.Generator().manual_seed((config.seed * 1_000_003 + step) * workers.count + workers.rank)
        yield (
            step,
            make_batch(
                workers.rows(records),
                category,
                dense_points=config.dense_points,
                generator=generator,
                augmentation=config.augmentation,
            ),
        )


def train(
    config: TrainingConfig,
    category: Category,
    cache: Path,
    run: Path,
    on_report: Callable[[Report], None],
    on_fault: Callable[[str], None] | None = None,
    approach: Approach = SCORING,
) -> Path:
    """Train, or go on with the run in folder `run`; returns its checkpoint.

    `run_folder` says what the folder holds. Interrupt it at any time; at most `save_every` steps are repeated. A run
    may go on with another number of samples, threads or patience, and is then on another learning rate's curve;
    ValueError when anything else differs from what it was begun with. It ends early after `patience` validations
    without a better total. Under torchrun its processes share every batch, and the first one writes the folder.
    on_fault: told of corrupt frames, which are skipped; without it the first one ends the run with a ValueError.
    OSError when the disk is full; the last checkpoint is whole then.
    """
    keep_freed_memory()
    workers = join_workers(config.batch_size)
    torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    network = approach.network(category, config.fusion)
    network.image_branch.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    earlier_samples, first_step = 0, 0
    checkpoint = run / "checkpoint.pt"
    state = load_checkpoint(checkpoint, category) if checkpoint.exists() else None
    if state is not None:
        require_same_run(run, json.loads(state["config"]), config)
        network.load_state_dict(state["network"])
        first_step = state["step"]
        earlier_samples = state["samples"] - first_step * config.batch_size
    elif config.start_from is not None:
        earlier_samples = load_start(network, category, Path(config.start_from))
    average = copy.deepcopy(network)
    optimizers = optimizers_for(network, config)
    if state is not None:
        average.load_state_dict(state["average"])
        for optimizer, saved in zip(optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(saved)
    steps = math.ceil(config.samples / config.batch_size)
    _shards_for(cache, category)
    also = [] if config.also_from is None else _shards_for(Path(config.also_from), category, "import")
    if workers.first:
        begin(run, config, first_step)
    totals = validation_totals(run, first_step)
    if _ended(totals, config.patience):
        return checkpoint
    module = workers.joined(network, all_used=config.fusion != "depth")
    validation = open_shards(cache, category.name, "validation")
    sums: dict[str, float] = {}
    counted, since = 0, time.perf_counter()
    for step, batch in _batches(config, category, cache, also, range(first_step, steps), workers, on_fault):
        set_learning_rate(optimizers, step, steps, config)
        # The gate's noise, too, depends on the step and the worker alone.
        torch.manual_seed(hash((config.seed, step)) + workers.rank)
        outputs = module(batch.inputs, batch.dense)
        terms = approach.loss(
            outputs,
            settled_targets(batch.truth, batch.targets, outputs, category),
            segmentation_weight=config.segmentation_weight,
            radius_weight=config.radius_weight,
        )
        network.zero_grad(set_to_none=True)
        terms["total"].backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), config.gradient_clip)
        for optimizer in optimizers:
            optimizer.step()
        update_average(average, network, min(config.average_decay, (step + 1) / (step + 10)))
        for name, value in terms.items():
            sums[name] = sums.get(name, 0.0) + float(value.detach())
        counted += 1
        done = step + 1
        if done % config.save_every == 0 or done == steps:
            means = workers.means({name: value / counted for name, value in sums.items()})
            if workers.first:
                speed = counted * config.batch_size / (time.perf_counter() - since)
                due = bool(validation) and (done % config.validate_every == 0 or done == steps)
                report = Report(
                    step=done,
                    steps=steps,
                    samples_per_s=speed,
                    losses=means,
                    validation=validation_losses(average, validation, category, approach.loss) if due else None,
                    picture=validation_picture(average, validation, category) if due else None,
                )
                save_checkpoint(
                    checkpoint,
                    network=network.state_dict(),
                    average=average.state_dict(),
                    optimizers=[optimizer.state_dict() for optimizer in optimizers],
                    step=done,
                    samples=earlier_samples + done * config.batch_size,
                    category=json.dumps(category_document(category)),
                    config=json.dumps(asdict(config)),
                )
                if report.validation is not None:
                    totals.append(report.validation["total"])
                    if totals[-1] == min(totals):
                        keep_weights(checkpoint, run / "best.pt")
                add_report(run, {name: getattr(report, name) for name in HISTORY}, report.picture)
                on_report(report)
            if workers.means({"ended": float(workers.first and _ended(totals, config.patience))})["ended"] > 0.0:
                break
            sums, counted, since = {}, 0, time.perf_counter()
    return checkpoint


def _ended(totals: list[float], patience: int | None) -> bool:
    """Whether the last `patience` validations were no better than one before them."""
    return patience is not None and len(totals) > patience and min(totals[-patience:]) > min(totals[:-patience])
