"""page-export calibrate: what a bundle's confidence means, fitted and told."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.progress import track

from page_export.calibration import Examples, cross_fitted, examples_from, fitted, joined, write_confidence
from page_export.given import open_fitting
from page_runtime.commands.outputs import require_file_place
from page_runtime.network import Network
from page_runtime.validation.reliability import calibration_error, reliability


def run(options: argparse.Namespace) -> int:
    """Fit and put it into the bundle; ValueError where a recording does not fit, before anything is estimated."""
    metadata = Network(options.bundle).metadata
    require_file_place(options.bundle, option="BUNDLE")
    sources = [open_fitting(options.bundle, metadata.category, path, with_truth=True) for path in options.on]
    # Confidence decides which frames get a second opinion: the first round finds the confidence of first answers, the
    # second that of what an estimate then is.
    rounds = ("first answers", "with second opinions") if metadata.mirrored else ("estimating",)
    model = None
    collected: list[Examples] = []
    with TemporaryDirectory() as folder:
        trial = Path(folder) / options.bundle.name
        shutil.copyfile(options.bundle, trial)
        for what in rounds:
            write_confidence(trial, metadata, model)
            network = Network(trial)
            collected = [
                frame
                for recording, source in zip(options.on, sources, strict=True)
                for frame in track(examples_from(network, recording), f"{recording.name}, {what}", total=len(source))
            ]
            model = fitted(joined(collected))
    examples = joined(collected)
    bins = reliability(cross_fitted(examples), examples.right)
    lines = ["confidence  parts  mean  right   (each part by a fit without its fifth of the frames)"]
    lines += [f"{one.low:.2f}-{one.high:.2f}  {one.count:5d}  {one.confidence:.3f}  {one.right:.3f}" for one in bins]
    right = examples.right
    lines.append(f"{len(right)} parts, {right.mean():.3f} right, off by {calibration_error(bins):.3f} in mean")
    sys.stdout.write("\n".join(lines) + "\n")
    write_confidence(options.bundle, metadata, model)
    return 0
