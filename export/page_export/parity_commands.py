"""page-export onnx and verify: a bundle beside its checkpoint."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from onnx import load as load_model

from page_export.batched import Batch, batched_run
from page_export.bundle_writer import bundle_bytes, write_file
from page_export.given import open_fitting
from page_export.onnx_export import bundle_metadata, graph_of, write_bundle
from page_export.parity import Parity, compare, samples_of
from page_export.provenance import commit, trained_on, weights_sha256
from page_runtime.commands.outputs import require_file_place
from page_runtime.commands.usage import UsageError
from page_runtime.neighbours import LEVELS, MIN_POINTS
from page_runtime.network import Network
from page_training.templates import with_templates
from page_training.trained import load_trained

# The most that benchmarks/latency_sweeps.py measured.
MAX_POINTS = 4096


def table(parity: Parity) -> str:
    """For people."""
    document = parity.document()
    rows = [*document["outputs"].items(), *((name, document[name]) for name in ("rotation_deg", "translation_mm"))]
    lines = [f"{'':14s} {'max':>9s} {'mean':>9s} {'bound':>9s}"]
    lines += [f"{name:14s} {row['max']:9.2e} {row['mean']:9.2e} {row['bound']:9.2e}" for name, row in rows]
    one_only = f"{parity.disagreements} with a pose from only one of the two"
    lines.append(f"{parity.samples} samples, {parity.parts} parts: {one_only}")
    if parity.undecided:
        lines.append(
            f"{parity.undecided} parts ({100 * parity.undecided / parity.parts:.1f} %, at most "
            f"{100 * parity.undecided_bound:g} %) are undecided and left out: two fits are as good as each other, and "
            "the checkpoint's own pose changes from one to the other when its outputs change in their last digits"
        )
    lines.append("same network" if parity.holds else "NOT the same network")
    return "\n".join(lines) + "\n"


def onnx(options: argparse.Namespace) -> int:
    """Export a checkpoint; nothing is written that differs from it."""
    batch = None if options.batch == "1" else Batch.parsed(options.batch)
    points = _points(options.points)
    require_file_place(options.output, option="--output")
    trained = load_trained(options.checkpoint)
    source = open_fitting(options.checkpoint, trained.category, options.compare_on)
    training = trained.config
    weights = weights_sha256(trained.network.state_dict())
    provenance: dict[str, Any] = {
        "trained_on": trained_on(training),
        "weights_sha256": weights,
        "commit": commit(),
        "frames_seen": trained.samples,
        "training": training,
        "note": options.note,
    }
    if batch is not None:
        provenance["batch"] = str(batch)
    category = with_templates(trained.category)
    about: dict[str, Any] = {
        "mirrored": trained.category.joints_mirror and training["augmentation"]["flip_probability"] > 0.0,
        "provenance": provenance,
        "num_points": points,
    }
    metadata = bundle_metadata(category, **about)
    samples = list(samples_of(metadata, source))
    model = graph_of(trained.network, points) if batch is None else batch.graph_of(trained.network, points)
    with TemporaryDirectory() as folder:
        trial = Path(folder) / "trial.onnx"
        write_bundle(model, category, trial, **about)
        ours = Network(trial, threads=1).run_raw if batch is None else batched_run(trial.read_bytes(), metadata, batch)
        parity = compare(metadata, ours, trained.network, samples)
    sys.stdout.write(table(parity))
    if not parity.holds:
        sys.stdout.write(f"{options.output}: not written\n")
        return 1
    provenance["parity"] = _kept(parity, weights, options.compare_on)
    write_bundle(model, category, options.output, **about)
    sys.stdout.write(f"{options.output}: {options.output.stat().st_size / 1e6:.2f} MB\n")
    if points != LEVELS[0]:
        sys.stdout.write(
            f"{points} points, but the weights were trained with {LEVELS[0]}: compare its poses with the truth before "
            "you use it (page-runtime validate)\n"
        )
    return 0


def _points(count: int) -> int:
    """Unchanged; UsageError for a number of points that no network is exported for."""
    if not MIN_POINTS <= count <= MAX_POINTS or count % 64:
        raise UsageError(f"--points: expected a multiple of 64 from {MIN_POINTS} to {MAX_POINTS}, got {count}")
    return count


def verify(options: argparse.Namespace) -> int:
    """Compare a bundle with its checkpoint; kept in the bundle where they are the same."""
    if options.frames < 1:
        raise UsageError(f"--frames: expected at least 1, got {options.frames}")
    require_file_place(options.json, option="--json")
    bundle = Network(options.bundle, threads=1)
    require_file_place(options.bundle, option="BUNDLE")
    metadata, trained = bundle.metadata, load_trained(options.against)
    if trained.category.name != metadata.category.name:
        raise UsageError(
            f"{options.bundle} is for {metadata.category.name!r}, {options.against} for {trained.category.name!r}"
        )
    source = open_fitting(options.bundle, metadata.category, options.data)
    parity = compare(metadata, bundle.run_raw, trained.network, samples_of(metadata, source, options.frames))
    weights = weights_sha256(trained.network.state_dict())
    stated = metadata.provenance.get("weights_sha256")
    sys.stdout.write(table(parity) + _origin(stated, weights, options.bundle, options.against))
    kept = _kept(parity, weights, options.data)
    if options.json is not None:
        write_file((json.dumps(kept, indent=1) + "\n").encode(), options.json)
    before = _samples_kept(metadata.provenance)
    same = parity.holds and stated in (None, weights)
    if not same:
        stays = f"; the comparison of {before} samples it holds is of before, and stays" if before else ""
        sys.stdout.write(f"{options.bundle}: nothing of this is kept in the bundle{stays}\n")
    elif before > parity.samples:
        sys.stdout.write(
            f"{options.bundle}: keeps the comparison of {before} samples it holds, as this one rests on "
            f"{parity.samples}; --frames {before} and a recording of as many regions replace it\n"
        )
    else:
        replaced = replace(metadata, provenance={**metadata.provenance, "parity": kept})
        write_file(bundle_bytes(load_model(options.bundle), replaced), options.bundle)
        sys.stdout.write(f"{options.bundle}: this comparison is kept in the bundle\n")
    return 0 if same else 1


def _origin(stated: Any, weights: str, bundle: Path, checkpoint: Path) -> str:
    """Whether the bundle was made from these weights, in words."""
    if stated is None:
        return f"{bundle} does not say which weights it was made from: an earlier release exported it\n"
    if stated == weights:
        return f"made from the weights in {checkpoint}, by their SHA-256\n"
    return (
        f"NOT made from the weights in {checkpoint}: the bundle says weights_sha256 {stated}, theirs is {weights}; "
        "compare it with those it was made from, or export it again from these\n"
    )


def _samples_kept(provenance: dict[str, Any]) -> int:
    """Of the comparison that a bundle holds, 0 where it holds none."""
    kept = provenance.get("parity")
    samples = kept.get("samples") if isinstance(kept, dict) and kept.get("holds") is True else None
    return samples if isinstance(samples, int) else 0


def _kept(parity: Parity, weights: str, data: Path) -> dict[str, Any]:
    """What a bundle keeps of a comparison: of what with what, too."""
    return {"weights_sha256": weights, "data": data.resolve().name, **parity.document()}
