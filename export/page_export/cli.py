"""page-export: from a checkpoint to the bundle the runtime loads."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from page_export.onnx_export import export_bundle
from page_export.parity import Parity, compare_on
from page_runtime.network import Network
from page_training.categories import category_named
from page_training.train import load_checkpoint, network_for


def main(arguments: list[str] | None = None) -> int:
    """Run page-export; returns the exit code: 0 done, 1 the bundle differs from the checkpoint, 2 bad input."""
    parser = argparse.ArgumentParser(prog="page-export", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    onnx = commands.add_parser("onnx", help="export a checkpoint and compare it with the bundle written")
    onnx.add_argument("checkpoint", type=Path)
    onnx.add_argument("-o", "--output", type=Path, required=True, help="the .onnx bundle to write")
    onnx.add_argument("--compare-on", type=Path, metavar="RECORDING", help="also report parity on this recording")
    onnx.add_argument("--note", default="", help="a line for the bundle's provenance")
    onnx.set_defaults(run_command=_onnx)
    verify = commands.add_parser("verify", help="compare a bundle with its checkpoint on a recording")
    verify.add_argument("bundle", type=Path)
    verify.add_argument("--against", type=Path, required=True, metavar="CHECKPOINT")
    verify.add_argument("--data", type=Path, required=True, metavar="RECORDING")
    verify.set_defaults(run_command=_verify)
    options = parser.parse_args(arguments)
    try:
        return options.run_command(options)
    except (ValueError, OSError, KeyError, RuntimeError) as error:
        print(f"page-export: {error}", file=sys.stderr)
        return 2


# Above these a bundle is another network than its checkpoint (float32 reordering gives a tenth of them).
MAX_OUTPUT_DIFFERENCE = 1e-3
MAX_ROTATION_DEG = 0.1
MAX_TRANSLATION_MM = 0.5


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


def _onnx(options: argparse.Namespace) -> int:
    state = load_checkpoint(options.checkpoint)
    category = category_named(state["category"])
    network = network_for(category)
    network.load_state_dict(state["average"])
    provenance = {
        "recipe": "page-train scenes, page-train pose, page-export onnx; procedural scenes only",
        "steps": state["step"],
        "samples": state["samples"],
        "note": options.note,
    }
    export_bundle(network, category, options.output, provenance)
    print(f"{options.output}: {options.output.stat().st_size / 1e6:.2f} MB")
    if options.compare_on is None:
        return 0
    return _report(compare_on(Network(options.output), network, options.compare_on))


def _verify(options: argparse.Namespace) -> int:
    state = load_checkpoint(options.against)
    bundle = Network(options.bundle)
    network = network_for(category_named(state["category"]))
    network.load_state_dict(state["average"])
    return _report(compare_on(bundle, network, options.data))


if __name__ == "__main__":
    sys.exit(main())
