"""page-export: from a checkpoint to the bundle the runtime loads."""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from page_export.parity import Parity


def main(arguments: list[str] | None = None) -> int:
    """Run page-export; returns the exit code: 0 done, 1 the bundle differs from the checkpoint, 2 bad input."""
    parser = argparse.ArgumentParser(prog="page-export", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    onnx = commands.add_parser("onnx", help="export a checkpoint and compare it with the bundle written")
    onnx.add_argument("checkpoint", type=Path)
    onnx.add_argument("-o", "--output", type=Path, required=True, help="the .onnx bundle to write")
    onnx.add_argument(
        "--compare-on",
        type=Path,
        metavar="RECORDING",
        required=True,
        help="regions to compare bundle and checkpoint on; nothing is written when they differ",
    )
    onnx.add_argument(
        "--batch",
        default="1",
        metavar="N|dynamic",
        help="objects in a run; other than 1 for accelerators and programs of your own: page-runtime loads 1 only",
    )
    onnx.add_argument("--note", default="", help="a line for the bundle's provenance")
    onnx.set_defaults(run_command=_onnx)
    verify = commands.add_parser(
        "verify", help="compare a bundle with its checkpoint on a recording; kept in the bundle"
    )
    verify.add_argument("bundle", type=Path)
    verify.add_argument("--against", type=Path, required=True, metavar="CHECKPOINT")
    verify.add_argument("--data", type=Path, required=True, metavar="RECORDING")
    verify.add_argument("--json", type=Path, metavar="FILE", help="write the differences here")
    verify.add_argument("--frames", type=int, default=50, help="regions compared (default: 50)")
    verify.set_defaults(run_command=_verify)
    scorer = commands.add_parser(
        "scorer", help="network and scorer as one graph, for accelerators; compared with the numpy scorer"
    )
    scorer.add_argument("bundle", type=Path)
    scorer.add_argument("-o", "--output", type=Path, required=True, help="the .onnx file to write")
    scorer.add_argument("--measure-on", type=Path, required=True, metavar="RECORDING")
    scorer.add_argument("--beam", type=int, help="cells kept on each level (default: 384)")
    scorer.add_argument("--threads", type=int, default=2)
    scorer.set_defaults(run_command=_scorer)
    optimise = commands.add_parser("optimise", help="smaller and quicker forms of a bundle, measured; recommends one")
    optimise.add_argument("bundle", type=Path)
    optimise.add_argument("--data", type=Path, required=True, metavar="RECORDING", help="with truth, of validation")
    optimise.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="where the forms are written")
    optimise.add_argument(
        "--frames", type=int, default=50, help="regions measured on; the others calibrate (default: 50)"
    )
    optimise.add_argument("--max-pose-error", type=float, default=1.1, help="of the original's (default: 1.1)")
    optimise.add_argument("--json", type=Path, metavar="FILE", help="write the table here")
    optimise.set_defaults(run_command=_optimise)
    profile = commands.add_parser("profile", help="where a forward pass takes its time, operator by operator")
    profile.add_argument("bundle", type=Path)
    profile.add_argument("--data", type=Path, required=True, metavar="RECORDING")
    profile.add_argument("--threads", type=int, default=1)
    profile.add_argument("--top", type=int, default=25, help="single operators shown (default: 25)")
    profile.set_defaults(run_command=_profile)
    calibrate = commands.add_parser("calibrate", help="fit the bundle's confidence on validation recordings")
    calibrate.add_argument("bundle", type=Path)
    calibrate.add_argument(
        "--on", type=Path, nargs="+", required=True, metavar="RECORDING", help="with truth, of the validation split"
    )
    calibrate.set_defaults(run_command=_calibrate)
    card = commands.add_parser("card", help="write a bundle's model card")
    card.add_argument("bundle", type=Path)
    card.add_argument("-o", "--output", type=Path, required=True, help="the .md file to write")
    card.add_argument(
        "--figures",
        nargs=2,
        action="append",
        default=[],
        metavar=("LABEL", "FILE"),
        help="what `page-runtime validate --json` wrote, and of what; may be given several times",
    )
    card.set_defaults(run_command=_card)
    options = parser.parse_args(arguments)
    try:
        return options.run_command(options)
    except ImportError as error:
        print(f"page-export: {error}; export needs the extra: pip install 'page-edge[export]'", file=sys.stderr)
        return 2
    except (ValueError, OSError) as error:
        print(f"page-export: {error}", file=sys.stderr)
        return 2


def _report(parity: Parity) -> int:
    document = parity.document()
    print(f"{'':14s} {'max':>9s} {'mean':>9s} {'bound':>9s}")
    rows = [*document["outputs"].items(), *((name, document[name]) for name in ("rotation_deg", "translation_mm"))]
    for name, row in rows:
        print(f"{name:14s} {row['max']:9.2e} {row['mean']:9.2e} {row['bound']:9.2e}")
    print(
        f"{parity.samples} samples, {parity.parts} parts: {parity.disagreements} with a pose from only one of the two, "
        f"{parity.undecided} left out as the checkpoint's own pose jumps as far at so small a change"
    )
    print("same network" if parity.holds else "NOT the same network")
    return 0 if parity.holds else 1


def _commit() -> str:
    """The commit exported from, "-dirty" with changes, or why it is not known."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=True, timeout=10
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown: not exported from a git work tree"
    return described.stdout.strip()


def _onnx(options: argparse.Namespace) -> int:
    from page_export.batched import Batch, batched_run
    from page_export.onnx_export import graph_of, write_bundle
    from page_export.parity import checkpoint_run, compare, samples_of
    from page_runtime.capture.playback import open_source
    from page_runtime.network import Network
    from page_training.templates import with_templates
    from page_training.trained import load_trained

    batch = None if options.batch == "1" else Batch.parsed(options.batch)
    trained = load_trained(options.checkpoint)
    training = trained.config
    mirrored = trained.category.joints_mirror and training["augmentation"]["flip_probability"] > 0.0
    provenance: dict[str, Any] = {
        "trained_on": "procedural scenes only",
        "commit": _commit(),
        "frames_seen": trained.samples,
        "training": training,
        "note": options.note,
    }
    if batch is not None:
        provenance["batch"] = str(batch)
    category = with_templates(trained.category)
    model = graph_of(trained.network) if batch is None else batch.graph_of(trained.network)
    with TemporaryDirectory() as folder:
        trial = Path(folder) / "trial.onnx"
        metadata = write_bundle(model, category, trial, mirrored=mirrored, provenance=provenance)
        ours = Network(trial, threads=1).run_raw if batch is None else batched_run(trial.read_bytes(), metadata, batch)
        samples = samples_of(metadata, open_source(options.compare_on))
        parity = compare(metadata, ours, checkpoint_run(metadata, trained.network), samples)
    code = _report(parity)
    if code == 0:
        provenance["parity"] = _kept(parity, options.checkpoint, options.compare_on)
        write_bundle(model, category, options.output, mirrored=mirrored, provenance=provenance)
        print(f"{options.output}: {options.output.stat().st_size / 1e6:.2f} MB")
    return code


def _verify(options: argparse.Namespace) -> int:
    import onnx

    from page_export.bundle_writer import bundle_bytes, write_file
    from page_export.parity import checkpoint_run, compare, samples_of
    from page_runtime.capture.playback import open_source
    from page_runtime.network import Network
    from page_training.trained import load_trained

    if options.frames < 1:
        raise ValueError(f"--frames: expected at least 1, got {options.frames}")
    bundle = Network(options.bundle, threads=1)
    metadata, trained = bundle.metadata, load_trained(options.against)
    if trained.category.name != metadata.category.name:
        raise ValueError(
            f"{options.bundle} is for {metadata.category.name!r}, {options.against} for {trained.category.name!r}"
        )
    samples = samples_of(metadata, open_source(options.data), options.frames)
    parity = compare(metadata, bundle.run_raw, checkpoint_run(metadata, trained.network), samples)
    code = _report(parity)
    kept = _kept(parity, options.against, options.data)
    if options.json is not None:
        write_file((json.dumps(kept, indent=1) + "\n").encode(), options.json)
    if code == 0:
        stated = replace(metadata, provenance={**metadata.provenance, "parity": kept})
        write_file(bundle_bytes(onnx.load(options.bundle), stated), options.bundle)
    return code


def _kept(parity: Parity, checkpoint: Path, data: Path) -> dict[str, Any]:
    """What a bundle keeps of a comparison: of what with what, too."""
    digest = hashlib.sha256(checkpoint.read_bytes()).hexdigest()
    return {"checkpoint_sha256": digest, "data": data.resolve().name, **parity.document()}


def _optimise(options: argparse.Namespace) -> int:
    from page_export import optimise_command

    return optimise_command.run(options)


def _profile(options: argparse.Namespace) -> int:
    from page_export.parity import samples_of
    from page_export.profile import profiled
    from page_runtime.bundle_file import read_bundle
    from page_runtime.capture.playback import open_source

    if options.threads < 1 or options.top < 0:
        raise ValueError(f"--threads, --top: expected at least 1 and 0, got {options.threads} and {options.top}")
    samples = list(samples_of(read_bundle(options.bundle).metadata, open_source(options.data), 10))
    profile = profiled(options.bundle, samples, threads=options.threads)
    total = sum(kind.ms for kind in profile.kinds)
    print(f"{options.threads} threads: {profile.pass_ms:.2f} ms a pass, {total:.2f} ms of it in operators (medians)")
    for kind in profile.kinds:
        print(f"{kind.ms:8.3f} ms  {100 * kind.ms / total:5.1f} %  {kind.count:4d}  {kind.name}")
    for one in profile.operators[: options.top]:
        print(f"{one.ms:8.3f} ms  {one.name}  {one.shapes}")
    return 0


def _scorer(options: argparse.Namespace) -> int:
    import onnx

    from page_export.bundle_writer import bundle_bytes
    from page_export.scorer_cost import measure_scorer
    from page_export.scorer_graph import BEAM, with_scorer
    from page_runtime.network import Network

    beam = BEAM if options.beam is None else options.beam
    if beam < 1 or options.threads < 1:
        raise ValueError(f"--beam, --threads: expected at least 1, got {beam} and {options.threads}")
    bundle = Network(options.bundle, threads=options.threads)
    model = with_scorer(onnx.load(options.bundle), bundle.metadata, beam)
    graph = bundle_bytes(model, bundle.metadata)
    cost = measure_scorer(bundle, graph, options.measure_on, threads=options.threads)
    print(f"{cost.keypoints} keypoints of {cost.regions} regions, {options.threads} threads of the CPU")
    print(f"within a voxel of the numpy scorer's  {cost.within_voxel:.3f}, fewest of its votes {cost.least_share:.3f}")
    print(f"network, then numpy scorer            {cost.network_ms:.1f} + {cost.numpy_scoring_ms:.1f} ms")
    print(f"one graph                             {cost.graph_ms:.1f} ms")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    partial = options.output.with_suffix(".partial")
    partial.write_bytes(graph)
    partial.rename(options.output)
    print(f"{options.output}: {options.output.stat().st_size / 1e6:.2f} MB")
    return 0


def _card(options: argparse.Namespace) -> int:
    from page_export.card import card, read_figures
    from page_runtime.network import Network

    metadata = Network(options.bundle, threads=1).metadata
    figures = [read_figures(label, Path(file), metadata.category.name) for label, file in options.figures]
    options.output.write_text(card(options.bundle.name, metadata, options.bundle.stat().st_size, figures))
    print(options.output)
    return 0


def _calibrate(options: argparse.Namespace) -> int:
    from rich.progress import track

    from page_export.calibration import cross_fitted, examples_from, fitted, joined, write_confidence
    from page_runtime.capture.playback import open_source
    from page_runtime.network import Network
    from page_runtime.validation.reliability import calibration_error, reliability

    metadata = Network(options.bundle).metadata
    # Confidence decides which frames get a second opinion: the first round finds the confidence of first answers, the
    # second that of what an estimate then is.
    rounds = ("first answers", "with second opinions") if metadata.mirrored else ("estimating",)
    model, collected = None, []
    with TemporaryDirectory() as folder:
        trial = Path(folder) / options.bundle.name
        shutil.copyfile(options.bundle, trial)
        for what in rounds:
            write_confidence(trial, metadata, model)
            network = Network(trial)
            collected = [
                frame
                for recording in options.on
                for frame in track(
                    examples_from(network, recording), f"{recording.name}, {what}", total=len(open_source(recording))
                )
            ]
            model = fitted(joined(collected))
    examples = joined(collected)
    bins = reliability(cross_fitted(examples), examples.right)
    print("confidence  parts  mean  right   (each part by a fit without its fifth of the frames)")
    for one in bins:
        print(f"{one.low:.2f}-{one.high:.2f}  {one.count:5d}  {one.confidence:.3f}  {one.right:.3f}")
    print(
        f"{len(examples.right)} parts, {examples.right.mean():.3f} right, off by {calibration_error(bins):.3f} in mean"
    )
    write_confidence(options.bundle, metadata, model)
    return 0


if __name__ == "__main__":
    sys.exit(main())
