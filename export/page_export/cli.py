"""page-export: from a checkpoint to the bundle the runtime loads."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from page_runtime.providers import NetworkError, ProviderError

# Bounds of `parity`, which is not imported before it is needed; a test holds them together.
_PARITY = """The two are the same network where every output agrees to 1e-4 (above 1: of its value), or to twice what
rounding to float32 does to the checkpoint itself, every pose to 0.02 deg and 0.1 mm, and both give poses for the same
parts. Parts whose pose is a toss-up are "undecided" and left out, at most 5 % of all: where two fits are as good as
each other, the last digits decide which is taken, and the checkpoint's own pose moves by more than these bounds when
its outputs are changed by no more than the two networks differ. Exit code 1 where they are not the same."""


def main(arguments: list[str] | None = None) -> int:
    """Run page-export; returns the exit code: 0 done, 1 the bundle differs from the checkpoint, 2 bad input, 130
    interrupted."""
    parser = argparse.ArgumentParser(prog="page-export", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    onnx = commands.add_parser(
        "onnx", help="export a checkpoint and compare it with the bundle written", description=_PARITY
    )
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
    onnx.add_argument(
        "--points",
        type=int,
        default=2048,
        metavar="N",
        help="of an object that the network is given: fewer are quicker and less exact; a multiple of 64 from 256 on "
        "(default: 2048, which the weights were trained with; validate any other)",
    )
    onnx.add_argument("--note", default="", help="a line for the bundle's provenance")
    onnx.set_defaults(run_command=_onnx)
    verify = commands.add_parser(
        "verify", help="compare a bundle with its checkpoint on a recording; kept in the bundle", description=_PARITY
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
        "--frames", type=int, default=50, help="regions measured on, at least 20; the others calibrate (default: 50)"
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
    figures = commands.add_parser("figures", help="keep test figures in a bundle")
    figures.add_argument("bundle", type=Path)
    figures.add_argument(
        "--of",
        nargs=2,
        action="append",
        required=True,
        metavar=("LABEL", "FILE"),
        help="what `page-runtime validate --json` wrote, and of what; may be given several times",
    )
    figures.set_defaults(run_command=_figures)
    options = parser.parse_args(arguments)
    try:
        return options.run_command(options)
    except ImportError as error:
        print(f"page-export: {error}; export needs the extra: pip install 'page-edge[export]'", file=sys.stderr)
        return 2
    except (ValueError, OSError, NetworkError, ProviderError) as error:
        print(f"page-export: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("page-export: interrupted; every file is as it was, or whole", file=sys.stderr)
        return 130


def _onnx(options: argparse.Namespace) -> int:
    from page_export import parity_commands

    return parity_commands.onnx(options)


def _verify(options: argparse.Namespace) -> int:
    from page_export import parity_commands

    return parity_commands.verify(options)


def _optimise(options: argparse.Namespace) -> int:
    from page_export import optimise_command

    return optimise_command.run(options)


def _profile(options: argparse.Namespace) -> int:
    from page_export.given import open_fitting
    from page_export.parity import samples_of
    from page_export.profile import profiled
    from page_runtime.bundle_file import read_bundle

    if options.threads < 1 or options.top < 0:
        raise ValueError(f"--threads, --top: expected at least 1 and 0, got {options.threads} and {options.top}")
    metadata = read_bundle(options.bundle).metadata
    samples = list(samples_of(metadata, open_fitting(options.bundle, metadata.category, options.data), 10))
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

    from page_export.bundle_writer import bundle_bytes, write_file
    from page_export.given import open_fitting
    from page_export.scorer_cost import measure_scorer
    from page_export.scorer_graph import BEAM, with_scorer
    from page_runtime.commands.outputs import require_file_place
    from page_runtime.network import Network

    beam = BEAM if options.beam is None else options.beam
    if beam < 1 or options.threads < 1:
        raise ValueError(f"--beam, --threads: expected at least 1, got {beam} and {options.threads}")
    require_file_place(options.output, option="--output")
    bundle = Network(options.bundle, threads=options.threads)
    open_fitting(options.bundle, bundle.metadata.category, options.measure_on)
    model = with_scorer(onnx.load(options.bundle), bundle.metadata, beam)
    graph = bundle_bytes(model, bundle.metadata)
    cost = measure_scorer(bundle, graph, options.measure_on, threads=options.threads)
    print(f"{cost.keypoints} keypoints of {cost.regions} regions, {options.threads} threads of the CPU")
    print(f"within a voxel of the numpy scorer's  {cost.within_voxel:.3f}, fewest of its votes {cost.least_share:.3f}")
    print(f"network, then numpy scorer            {cost.network_ms:.1f} + {cost.numpy_scoring_ms:.1f} ms")
    print(f"one graph                             {cost.graph_ms:.1f} ms")
    write_file(graph, options.output)
    print(f"{options.output}: {options.output.stat().st_size / 1e6:.2f} MB")
    return 0


def _card(options: argparse.Namespace) -> int:
    from page_export.bundle_writer import write_file
    from page_export.card import card, read_figures
    from page_runtime.bundle_file import read_metadata
    from page_runtime.commands.outputs import require_file_place

    require_file_place(options.output, option="--output")
    metadata = read_metadata(options.bundle)
    figures = [read_figures(label, Path(file), metadata.category.name) for label, file in options.figures]
    text = card(options.bundle.name, metadata, options.bundle.stat().st_size, figures)
    write_file(text.encode(), options.output)
    print(options.output)
    return 0


def _figures(options: argparse.Namespace) -> int:
    from dataclasses import replace

    import onnx

    from page_export.bundle_writer import bundle_bytes, write_file
    from page_export.card import part_figures, read_figures
    from page_runtime.bundle_file import read_metadata

    metadata = read_metadata(options.bundle)
    figures = [read_figures(label, Path(file), metadata.category.name) for label, file in options.of]
    kept = replace(metadata, figures=part_figures(figures))
    write_file(bundle_bytes(onnx.load(options.bundle), kept), options.bundle)
    print(f"{options.bundle}: figures of {', '.join(one.label for one in figures)}")
    return 0


def _calibrate(options: argparse.Namespace) -> int:
    from page_export import calibrate_command

    return calibrate_command.run(options)


if __name__ == "__main__":
    sys.exit(main())
