"""page-train: make scenes, look at them, train on them, record test splits."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np

from page_training import dataset_commands
from page_training.categories import category_named, known_categories
from page_training.config import Fusion, TrainingConfig
from page_training.keypoints import METHODS, read_keypoints, write_keypoints
from page_training.own import commands as own_commands
from page_training.records import SHARD_SIZE, SPLITS
from page_training.terminal import progress_bar, say

if TYPE_CHECKING:
    from page_training.events import EventLog
    from page_training.train import Report

MAX_COUNT = 7
DEFAULT_CACHE = Path("export/cache")
DEFAULT_RUNS = Path("export/checkpoints")


def main(arguments: list[str] | None = None) -> int:
    """Run page-train; returns the exit code: 0 done, 1 the doctor found errors, 2 bad input, 130 interrupted."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        code = options.run_command(options)
    except ImportError as error:
        print(f"page-train: {error}; training needs the extra: pip install 'page-edge[export]'", file=sys.stderr)
        return 2
    except (ValueError, OSError) as error:
        print(f"page-train: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("page-train: interrupted; the same command goes on from here", file=sys.stderr)
        return 130
    return code or 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="page-train", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run, description: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=description, description=description)
        sub.add_argument("category", choices=known_categories())
        sub.set_defaults(run_command=run)
        return sub

    scenes = command("scenes", _scenes, "make the missing training frames of a category")
    scenes.add_argument("--frames", type=int, default=12_000, help="training frames in all (default: %(default)s)")
    scenes.add_argument("--validation-frames", type=int, default=SHARD_SIZE)
    scenes.add_argument("--cache", type=Path, default=DEFAULT_CACHE, help="about 0.25 MB a frame")
    scenes.add_argument("--processes", type=int, metavar="N", help="make N shards at once (default: one a core)")
    defaults = TrainingConfig(category="")
    pose = command("pose", _pose, "train the pose network, or go on with it")
    pose.add_argument("--samples", type=int, default=defaults.samples, help="frames seen (default: %(default)s)")
    pose.add_argument("--batch-size", type=int, default=defaults.batch_size)
    pose.add_argument("--learning-rate", type=float, default=defaults.learning_rate)
    pose.add_argument("--threads", type=int, default=defaults.threads)
    pose.add_argument("--seed", type=int, default=defaults.seed)
    pose.add_argument("--fusion", choices=get_args(Fusion), default=defaults.fusion, help="default: %(default)s")
    pose.add_argument("--keypoints", type=Path, metavar="FILE", help="of page-train keypoints --out, all of them voted")
    pose.add_argument(
        "--tau",
        type=float,
        nargs=2,
        metavar=("SEGMENTATION", "RADIUS"),
        default=(defaults.segmentation_weight, defaults.radius_weight),
        help="weights of the two losses of Eq. 19 (default: %(default)s)",
    )
    pose.add_argument("--cache", type=Path, default=DEFAULT_CACHE)
    pose.add_argument("--run", type=Path, help="folder of the run (default: export/checkpoints/CATEGORY)")
    pose.add_argument(
        "--from",
        type=Path,
        dest="start_from",
        help="begin a new run with this checkpoint's network, also another category's",
    )
    pose.add_argument(
        "--also", type=Path, metavar="CACHE", help="draw samples from this cache of page-train import, too"
    )
    pose.add_argument("--halve-every", type=int, metavar="SAMPLES", help="halve the learning rate so, no cosine")
    pose.add_argument("--skip-corrupt", action="store_true", help="name corrupt frames and go on (default: stop)")
    pose.add_argument("--patience", type=int, metavar="N", help="end after N validations without a better one")
    pose.add_argument("--tensorboard", action="store_true", help="write TensorBoard events into the run's folder")
    pose.add_argument(
        "--also-share", type=float, default=defaults.also_share, help="of the samples (default: %(default)s)"
    )
    keypoints = command("keypoints", _keypoints, "learn keypoints of the parts, and compare them with others")
    keypoints.add_argument("--count", type=int, default=3, help="keypoints of a part, 3 to 7 (default: %(default)s)")
    keypoints.add_argument("--steps", type=int, default=400, help="of the KP-Estimator (default: %(default)s)")
    keypoints.add_argument("--instances", type=int, default=96, help="objects learned from (default: %(default)s)")
    keypoints.add_argument("--picture", type=Path, help="a .png file of all of them on several instances")
    keypoints.add_argument("--json", type=Path, metavar="FILE", help="keypoints and figures")
    keypoints.add_argument("--out", type=Path, metavar="FILE", help="the keypoints of --method, for page-train pose")
    keypoints.add_argument("--method", choices=METHODS, default=METHODS[0], help="default: %(default)s")
    keep = command("keep", _keep, "keep the averaged network of a run: small enough to commit")
    keep.add_argument("--run", type=Path, help="folder of the run (default: export/checkpoints/CATEGORY)")
    keep.add_argument("--out", type=Path, required=True, help="a .pt file")
    preview = command("preview", _preview, "write a contact sheet of scenes: colour, depth, part axes")
    preview.add_argument("--out", type=Path, required=True, help="a .png file")
    preview.add_argument("--rows", type=int, default=4)
    preview.add_argument("--columns", type=int, default=8)
    preview.add_argument("--seed", type=int, default=0)
    record = command("record", _record, "write a recording with truth of whole frames of unseen instances")
    record.add_argument("--out", type=Path, required=True, help="a folder that does not exist yet")
    record.add_argument("--frames", type=int, default=200)
    record.add_argument("--split", choices=SPLITS[1:], default="test")
    record.add_argument("--seed", type=int, default=0)
    record.add_argument("--width", type=int, help="px (default: each scene's own camera)")
    record.add_argument("--jpeg", action="store_true", help="colour as .jpg, a tenth of the size")
    dataset_commands.add_to(commands)
    own_commands.add_to(commands)
    return parser


def _scenes(options: argparse.Namespace) -> None:
    from page_runtime.machine import available_processors
    from page_training.cache import make_shards

    category = category_named(options.category)
    processes = available_processors() if options.processes is None else options.processes
    if processes < 1:
        raise ValueError(f"--processes: expected at least 1, got {processes}")
    with progress_bar() as progress:
        for split, frames in (("validation", options.validation_frames), ("train", options.frames)):
            shards = -(-frames // SHARD_SIZE)
            if shards * SHARD_SIZE != frames:
                print(f"{split}: {shards * SHARD_SIZE} frames, as they come in shards of {SHARD_SIZE}", file=sys.stderr)
            task = progress.add_task(f"{category.name} {split}", total=shards)

            def done(path: Path, task=task) -> None:
                progress.advance(task)
                say(f"{path}")

            make_shards(category, split, range(shards), options.cache, done, processes)


def _pose(options: argparse.Namespace) -> None:
    from page_training.train import train
    from page_training.workers import join_workers, leave_workers

    config = TrainingConfig(
        category=options.category,
        fusion=options.fusion,
        segmentation_weight=options.tau[0],
        radius_weight=options.tau[1],
        samples=options.samples,
        batch_size=options.batch_size,
        learning_rate=options.learning_rate,
        threads=options.threads,
        seed=options.seed,
        start_from=None if options.start_from is None else str(options.start_from),
        also_from=None if options.also is None else str(options.also),
        also_share=options.also_share,
        halve_every=options.halve_every,
        patience=options.patience,
    )
    category = category_named(options.category)
    if options.keypoints is not None:
        category = read_keypoints(options.keypoints, category)
    run = options.run or DEFAULT_RUNS / options.category
    first = join_workers(config.batch_size).first
    with progress_bar() as progress, _events(run / "events" if options.tensorboard and first else None) as events:
        task = progress.add_task(options.category, total=None)

        def report(news: Report) -> None:
            shown = news.validation or news.losses
            figures = "  ".join(f"{name} {value:.3f}" for name, value in shown.items())
            kind = "validation" if news.validation else "training"
            line = f"step {news.step}/{news.steps}  {news.samples_per_s:.1f} frames/s  {kind}: {figures}"
            progress.update(task, completed=news.step, total=news.steps, description=line)
            say(line)
            if events is not None:
                events.add(news)

        checkpoint = train(
            config,
            category,
            options.cache,
            run,
            report,
            on_fault=partial(progress.console.print, "skipped", markup=False, soft_wrap=True)
            if options.skip_corrupt
            else None,
        )
    leave_workers()
    if first:
        print(checkpoint)


@contextmanager
def _events(folder: Path | None) -> Iterator[EventLog | None]:
    if folder is None:
        yield None
        return
    try:
        from page_training.events import EventLog
    except ImportError as error:
        raise ValueError(f"--tensorboard: {error}; install 'page-edge[tensorboard]'") from error
    log = EventLog(folder)
    try:
        yield log
    finally:
        log.close()


def _keypoints(options: argparse.Namespace) -> None:
    import cv2

    from page_training.keypoint_estimator import EstimatorConfig, estimate_keypoints, part_clouds
    from page_training.keypoint_report import figures_of, heuristics, picture_of

    if not 3 <= options.count <= MAX_COUNT:
        raise ValueError(f"--count: expected 3 to {MAX_COUNT}, got {options.count}")
    if options.instances < 1 or options.steps < 1:
        raise ValueError(f"--instances, --steps: expected at least 1, got {options.instances} and {options.steps}")
    if options.picture is not None and (options.picture.suffix != ".png" or not options.picture.parent.is_dir()):
        raise ValueError(f"--picture: expected a .png file in a folder that exists, got {options.picture}")
    config = EstimatorConfig(keypoints=options.count, steps=options.steps, instances=options.instances)
    clouds = part_clouds(options.category, np.random.default_rng(config.seed), config.instances, config.points)
    methods: dict[str, list[np.ndarray]] = {}
    rows = []
    with progress_bar() as progress:
        for k, cloud in enumerate(clouds):
            task = progress.add_task(f"part {k}", total=config.steps)
            learned, spread = estimate_keypoints(cloud, config, lambda *_, task=task: progress.advance(task))
            say(f"part {k}: learned keypoints differ by {spread:.4f} diagonals between instances")
            for name, found in {METHODS[0]: learned, **heuristics(cloud, options.count)}.items():
                methods.setdefault(name, []).append(found)
                figures = figures_of(found, cloud)
                rows.append({"part": k, "method": name, "keypoints_unit": found.tolist(), **asdict(figures)})
                deviation = " ".join(f"{value:.3f}" for value in figures.radius_std)
                print(
                    f"part {k}  {name:13s} radius std {deviation}, apart {figures.apart:.3f}; "
                    f"pose {figures.rotation_deg:.2f} deg, {100 * figures.translation:.2f} %"
                )
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")
    if options.out is not None:
        write_keypoints(options.out, category_named(options.category), methods[options.method])
        print(options.out)
    if options.picture is not None:
        drawn = cv2.cvtColor(picture_of(methods, clouds), cv2.COLOR_RGB2BGR)
        if not cv2.imwrite(str(options.picture), drawn):
            raise OSError(f"cannot write {options.picture}")
        print(options.picture)


def _keep(options: argparse.Namespace) -> None:
    from page_training.checkpoint import keep_weights

    keep_weights((options.run or DEFAULT_RUNS / options.category) / "checkpoint.pt", options.out)
    print(options.out)


def _preview(options: argparse.Namespace) -> None:
    import cv2

    from page_training.scenes.preview import contact_sheet

    sheet = contact_sheet(options.category, np.random.default_rng(options.seed), options.rows, options.columns)
    if not cv2.imwrite(str(options.out), cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR)):
        raise OSError(f"cannot write {options.out}")
    print(options.out)


def _record(options: argparse.Namespace) -> None:
    from page_training.record import record_split

    with progress_bar() as progress:
        task = progress.add_task(f"{options.category} {options.split}", total=options.frames)
        record_split(
            options.category,
            options.out,
            split=options.split,
            frames=options.frames,
            seed=options.seed,
            width=options.width,
            color_suffix=".jpg" if options.jpeg else ".png",
            on_frame=lambda: progress.advance(task),
        )
    print(options.out)


if __name__ == "__main__":
    sys.exit(main())
