"""page-export: from a checkpoint to the bundle the runtime loads."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from page_export.parity import Parity

# Above these a bundle is another network than its checkpoint (float32 reordering gives a tenth of them).
MAX_OUTPUT_DIFFERENCE = 1e-3
MAX_ROTATION_DEG = 0.1
MAX_TRANSLATION_MM = 0.5


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
    onnx.add_argument("--note", default="", help="a line for the bundle's provenance")
    onnx.set_defaults(run_command=_onnx)
    verify = commands.add_parser("verify", help="compare a bundle with its checkpoint on a recording")
    verify.add_argument("bundle", type=Path)
    verify.add_argument("--against", type=Path, required=True, metavar="CHECKPOINT")
    verify.add_argument("--data", type=Path, required=True, metavar="RECORDING")
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
    for name, difference in parity.outputs.items():
        print(f"{name:12s} max difference {difference:.2e}")
    print(f"{'poses':12s} max {parity.rotation_deg:.4f} deg, {parity.translation_mm:.4f} mm")
    print(f"{parity.samples} samples, {parity.disagreements} parts with a pose from only one of the two")
    same = (
        max(parity.outputs.values()) <= MAX_OUTPUT_DIFFERENCE
        and parity.rotation_deg <= MAX_ROTATION_DEG
        and parity.translation_mm <= MAX_TRANSLATION_MM
        and parity.disagreements == 0
    )
    print("same network" if same else "NOT the same network")
    return 0 if same else 1


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
    from page_export.onnx_export import graph_of, write_bundle
    from page_export.parity import compare_on
    from page_runtime.network import Network
    from page_training.templates import with_templates
    from page_training.trained import load_trained

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
    category = with_templates(trained.category)
    model = graph_of(trained.network)
    with TemporaryDirectory() as folder:
        trial = Path(folder) / "trial.onnx"
        write_bundle(model, category, trial, mirrored=mirrored, provenance=provenance)
        parity = compare_on(Network(trial), trained.network, options.compare_on)
    code = _report(parity)
    if code == 0:
        provenance["parity"] = asdict(parity)
        write_bundle(model, category, options.output, mirrored=mirrored, provenance=provenance)
        print(f"{options.output}: {options.output.stat().st_size / 1e6:.2f} MB")
    return code


def _verify(options: argparse.Namespace) -> int:
    from page_export.parity import compare_on
    from page_runtime.network import Network
    from page_training.trained import load_trained

    network = load_trained(options.against).network
    return _report(compare_on(Network(options.bundle), network, options.data))


def _scorer(options: argparse.Namespace) -> int:
    import onnx

    from page_export.scorer_cost import measure_scorer
    from page_export.scorer_graph import BEAM, with_scorer
    from page_runtime.network import Network

    beam = BEAM if options.beam is None else options.beam
    if beam < 1 or options.threads < 1:
        raise ValueError(f"--beam, --threads: expected at least 1, got {beam} and {options.threads}")
    bundle = Network(options.bundle, threads=options.threads)
    model = with_scorer(onnx.load(options.bundle), bundle.metadata, beam)
    graph = model.SerializeToString()
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
