"""How much worse poses become when their points are disturbed (the paper's section VI-E, Table IX).

    python benchmarks/robustness.py BUNDLE RECORDING [--json FILE]

One look at each frame, with the same points for every setting before they are disturbed (of thin objects the second
ones are taken where the disturbed first ones show them); then they are smoothed where they are noisy, as the runtime
smooths those of a noisy sensor.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.capture.playback import open_source
from page_runtime.commands.outputs import require_file_place, write_json
from page_runtime.commands.terminal import number, table
from page_runtime.commands.usage import UsageError
from page_runtime.denoising import denoised
from page_runtime.estimator import sample_for, sampled_again
from page_runtime.network import Network
from page_runtime.part_poses import members_of, pose_from_output
from page_runtime.pose import ArticulatedPose, not_seen
from page_runtime.recorded import PartTruth, Source
from page_runtime.validation.figures import figures_of

ROOT = Path(__file__).resolve().parents[1]
EXIT_BAD_INPUT = 2


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(prog="robustness.py", description="Poses from disturbed points.")
    parser.add_argument("bundle", type=Path)
    parser.add_argument("recording", type=Path, help="with truth, of the test split")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    try:
        _run(options)
    except (UsageError, ValueError, OSError) as error:
        print(f"robustness: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    return 0


def _run(options: argparse.Namespace) -> None:
    from benchmarks.perturbations import PAPER_DEG, SETTINGS

    require_file_place(options.json, option="--json")
    network, source = Network(options.bundle), open_source(options.recording)
    if not source.has_truth:
        raise UsageError(f"{options.recording}: this {source.format} has no true poses to compare with")
    figures = {}
    for name, perturbation in SETTINGS.items():
        print(f"robustness: {name}", file=sys.stderr, flush=True)
        figures[name] = _measured(network, source, perturbation)
    document = {
        "recording": options.recording.name,
        "bundle": options.bundle.name,
        "frames": len(source),
        "settings": figures,
        "paper_rotation_deg": {name: list(value) for name, value in PAPER_DEG.items()},
    }
    if options.json is not None:
        write_json(options.json, document)
    sys.stdout.write(readable(document))


def _measured(network: Network, source: Source, perturbation: Any) -> dict[str, Any]:
    """The figures of `page-runtime validate`, one look."""
    metadata = network.metadata
    compared: list[tuple[ArticulatedPose, tuple[PartTruth, ...]]] = []
    for number_of_frame, recorded in enumerate(source):
        rng = np.random.default_rng(number_of_frame)
        for instance in recorded.instances:
            if instance.region is None or instance.truths is None:
                continue
            sample = sample_for(metadata, recorded.frame, instance.region)
            if isinstance(sample, str):
                compared.append((not_seen(metadata.category, sample), instance.truths))
                continue
            sample = denoised(perturbation(sample, rng))
            output = network.run(sample, network.neighbours_of(sample))
            members = members_of(output, sample.num_distinct)
            again = sampled_again(metadata, recorded.frame, instance.region, sample, members)
            if again is not None:
                # The same sensor, with the same scale and offset.
                sample = denoised(perturbation(again, np.random.default_rng(number_of_frame)))
                output = network.run(sample, network.neighbours_of(sample))
            compared.append((pose_from_output(metadata, sample, output), instance.truths))
    return figures_of(metadata.category, compared)


def readable(document: dict[str, Any]) -> str:
    """A table for people, the paper's mean rotation (laptop of other data) beside ours."""
    header = ("points", "part", "rot mean", "median", "trans mean", "median", "5deg5cm", "failures", "paper rot")
    rows: list[tuple[str, ...]] = [("", "", "deg", "deg", "mm", "mm", "%", "%", "deg")]
    for name, figures in document["settings"].items():
        for index, part in enumerate(figures["parts"]):
            theirs = document["paper_rotation_deg"].get(name, ())
            rotation, translation = part["rotation_deg"], part["translation_m"]
            rows.append(
                (
                    name if index == 0 else "",
                    part["name"],
                    number(rotation["mean"], 2),
                    number(rotation["median"], 2),
                    number(translation["mean"] and 1e3 * translation["mean"], 1),
                    number(translation["median"] and 1e3 * translation["median"], 1),
                    number(100 * part["acc_5deg5cm"], 1),
                    number(100 * part["failure_rate"], 1),
                    number(theirs[index], 1) if index < len(theirs) else "",
                )
            )
    return f"{document['recording']}, bundle {document['bundle']}, one look\n{table(header, rows)}"


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.robustness` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
