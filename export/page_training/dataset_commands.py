"""The commands of `page-train` that read data sets: doctor, import, evaluate."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from page_training.categories import category_named, known_categories
from page_training.terminal import progress_bar

if TYPE_CHECKING:
    from page_runtime.category import Category
    from page_training.datasets.labelled import Labelled


_LAYOUTS = "artimage, bop, reartmix, robotarm or a file of your own; only reartmix was checked on real data"
_WITHOUT_LAYOUT = "without --layout a recording of this project"


def add_to(commands: Any) -> None:
    """Their parsers, on what argparse's add_subparsers gave."""
    doctor = _command(commands, "doctor", _doctor, "say what is wrong with a data set, and where; exit code 1 if it is")
    doctor.add_argument("dataset", type=Path, help=f"a folder; {_WITHOUT_LAYOUT}, BOP or ReArtMix")
    doctor.add_argument("--layout", metavar="NAME|FILE.toml", help=_LAYOUTS)
    doctor.add_argument("--frames", type=int, default=40, help="whose pictures are read, evenly (default: %(default)s)")
    doctor.add_argument("--json", type=Path, metavar="FILE", help="write the findings there, too")
    imported = _command(
        commands, "import", _import, "make training samples of a data set or recording with true poses and masks"
    )
    imported.add_argument("category", choices=known_categories())
    _dataset(imported)
    imported.add_argument("--cache", type=Path, required=True, help="of its own: pose --also draws from it")
    imported.add_argument(
        "--repeats",
        type=int,
        default=8,
        help="cuts of each instance (default: %(default)s)",
    )
    imported.add_argument("--seed", type=int, default=0)
    evaluate = _command(commands, "evaluate", _evaluate, "compare a checkpoint's poses with true ones")
    evaluate.add_argument("checkpoint", type=Path, help="of page-train pose or keep")
    _dataset(evaluate)
    evaluate.add_argument(
        "--regressed", action="store_true", help="poses from the keypoints regressed for each part, not from scoring"
    )
    evaluate.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")


def _command(commands: Any, name: str, run: Any, description: str) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=description, description=description)
    parser.set_defaults(run_command=run)
    return parser


def _dataset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dataset", type=Path, help=f"a folder; {_WITHOUT_LAYOUT}")
    parser.add_argument("--layout", metavar="NAME|FILE.toml", help=f"{_LAYOUTS}; needed for --objects")
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--objects", type=int, nargs="+", metavar="ID", help="only these objects of the data set")
    chosen.add_argument("--without", type=int, nargs="+", metavar="ID", help="all its objects but these")


def _doctor(options: argparse.Namespace) -> int:
    from page_runtime.commands.outputs import require_file_place
    from page_training.datasets.doctor import examine

    require_file_place(options.json, option="--json")
    if options.frames < 1:
        raise ValueError(f"--frames: expected at least 1, got {options.frames}")
    with progress_bar() as progress:
        task = progress.add_task(str(options.dataset), total=None)
        findings = examine(options.dataset, options.layout, lambda: progress.advance(task), options.frames)
    for one in findings:
        print(
            f"{one.severity:8s} {one.check:9s} {one.what}" + (f"\n{'':18s} first at {one.where}" if one.where else "")
        )
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(one) for one in findings], indent=2) + "\n")
    return int(any(one.severity == "error" for one in findings))


def _import(options: argparse.Namespace) -> None:
    from page_runtime.commands.outputs import require_folder_place
    from page_training.cache import write_shard
    from page_training.datasets.samples import import_samples
    from page_training.records import SHARD_SIZE, shard_path

    if options.repeats < 1:
        raise ValueError(f"--repeats: expected at least 1, got {options.repeats}")
    require_folder_place(options.cache, option="--cache")
    category = category_named(options.category)
    if list(shard_path(options.cache, category.name, "train", 0).parent.glob("train-*.npy")):
        raise ValueError(f"--cache: expected a folder without samples of {category.name!r}, got {options.cache}")
    labelled = _labelled(options, category)
    instances = labelled.instances()
    with progress_bar() as progress:
        task = progress.add_task("importing", total=labelled.count)
        records = import_samples(
            instances, category, options.repeats, options.seed, on_instance=lambda: progress.advance(task)
        )
    for shard, start in enumerate(range(0, len(records), SHARD_SIZE)):
        write_shard(shard_path(options.cache, category.name, "train", shard), records[start : start + SHARD_SIZE])
    print(f"{options.cache}: {len(records)} samples of {labelled.count} instances")


def _labelled(options: argparse.Namespace, category: Category) -> Labelled:
    """The data set asked for; what the user should know of it is said."""
    from page_training.datasets.labelled import open_labelled

    labelled = open_labelled(
        options.dataset, options.layout, category, objects=options.objects or (), without=options.without or ()
    )
    for note in labelled.notes:
        print(f"page-train: {note}", file=sys.stderr)
    return labelled


def _evaluate(options: argparse.Namespace) -> None:
    from page_runtime.commands.outputs import require_file_place
    from page_runtime.commands.validation_tables import readable
    from page_training.evaluate import evaluate, scored_pose
    from page_training.regressed import regressed_pose
    from page_training.templates import with_templates
    from page_training.trained import load_trained

    require_file_place(options.json, option="--json")
    trained = load_trained(options.checkpoint)
    source = _labelled(options, trained.category).source
    with progress_bar() as progress:
        task = progress.add_task("evaluating", total=len(source))
        document = evaluate(
            trained.network,
            with_templates(trained.category),
            source,
            lambda: progress.advance(task),
            pose_of=regressed_pose if options.regressed else scored_pose,
        )
    document |= {"bundle": options.checkpoint.name, "samples": trained.samples}
    if options.json is not None:
        options.json.write_text(json.dumps(document, indent=2) + "\n")
    print(readable(document), end="")
