"""Whether the confidence of a bundle means what it says, on recordings it was not calibrated on.

    python benchmarks/reliability.py BUNDLE RECORDING [RECORDING ...] [--json FILE] [--picture FILE.png]

Draws the share of right poses (5 degrees, 5 cm) over the confidence they came with. Needs the extras export and bench.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path

from page_runtime.commands.outputs import require_file_place, write_json
from page_runtime.commands.usage import UsageError

ROOT = Path(__file__).resolve().parents[1]
EXIT_BAD_INPUT = 2


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(prog="reliability.py", description="Confidence against the share of right poses.")
    parser.add_argument("bundle", type=Path)
    parser.add_argument("recordings", type=Path, nargs="+", metavar="RECORDING", help="with truth, of the test split")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    try:
        _run(options)
    except ImportError as error:
        print(f"reliability: {error}; it needs the extras: pip install 'page-edge[export,bench]'", file=sys.stderr)
        return EXIT_BAD_INPUT
    except (UsageError, ValueError, OSError) as error:
        print(f"reliability: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    return 0


def _run(options: argparse.Namespace) -> None:
    from page_export.calibration import examples_from, joined
    from page_runtime.network import Network
    from page_runtime.validation.reliability import calibration_error, reliability

    require_file_place(options.json, option="--json")
    require_file_place(options.picture, option="--picture")
    network = Network(options.bundle)
    frames = []
    for recording in options.recordings:
        print(f"reliability: {recording}", file=sys.stderr)
        frames += list(examples_from(network, recording))
    examples = joined(frames)
    bins = reliability(examples.confidence, examples.right)
    document = {
        "bundle": options.bundle.name,
        "recordings": [recording.name for recording in options.recordings],
        "parts": len(examples.right),
        "right": float(examples.right.mean()),
        "calibration_error": calibration_error(bins),
        "bins": [asdict(one) for one in bins],
    }
    if options.json is not None:
        write_json(options.json, document)
    if options.picture is not None:
        from benchmarks.plots import draw_reliability

        draw_reliability(document, options.picture)
    print("confidence   parts  mean   right")
    for one in bins:
        print(f"{one.low:.2f} - {one.high:.2f}  {one.count:5d}  {one.confidence:.3f}  {one.right:.3f}")
    print(
        f"{document['parts']} parts, {document['right']:.3f} right, off by {document['calibration_error']:.3f} in mean"
    )


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.reliability` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
