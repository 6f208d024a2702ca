"""page-export onnx and verify: a bundle beside its checkpoint."""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from onnx import load as load_model

from page_export.batched import Batch, batched_run
from page_export.bundle_writer import bundle_bytes, write_file
from page_export.onnx_export import graph_of, write_bundle
from page_export.parity import Parity, compare, samples_of
from page_runtime.capture.playback import open_source
from page_runtime.network import Network
from page_training.templates import with_templates
from page_training.trained import load_trained


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


def _commit() -> str:
    """The commit exported from, "-dirty" with changes, or why it is not known."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=True, timeout=10
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown: not exported from a git work tree"
    return described.stdout.strip()


def onnx(options: argparse.Namespace) -> int:
    """Export a checkpoint; nothing is written that differs from it."""
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
        parity = compare(metadata, ours, trained.network, samples)
    sys.stdout.write(table(parity))
    if parity.holds:
        provenance["parity"] = _kept(parity, options.checkpoint, options.compare_on)
        write_bundle(model, category, options.output, mirrored=mirrored, provenance=provenance)
        sys.stdout.write(f"{options.output}: {options.output.stat().st_size / 1e6:.2f} MB\n")
    return 0 if parity.holds else 1


def verify(options: argparse.Namespace) -> int:
    """Compare a bundle with its checkpoint; kept in the bundle where they are the same."""
    if options.frames < 1:
        raise ValueError(f"--frames: expected at least 1, got {options.frames}")
    bundle = Network(options.bundle, threads=1)
    metadata, trained = bundle.metadata, load_trained(options.against)
    if trained.category.name != metadata.category.name:
        raise ValueError(
            f"{options.bundle} is for {metadata.category.name!r}, {options.against} for {trained.category.name!r}"
        )
    samples = samples_of(metadata, open_source(options.data), options.frames)
    parity = compare(metadata, bundle.run_raw, trained.network, samples)
    sys.stdout.write(table(parity))
    kept = _kept(parity, options.against, options.data)
    if options.json is not None:
        write_file((json.dumps(kept, indent=1) + "\n").encode(), options.json)
    if parity.holds:
        stated = replace(metadata, provenance={**metadata.provenance, "parity": kept})
        write_file(bundle_bytes(load_model(options.bundle), stated), options.bundle)
    return 0 if parity.holds else 1


def _kept(parity: Parity, checkpoint: Path, data: Path) -> dict[str, Any]:
    """What a bundle keeps of a comparison: of what with what, too."""
    digest = hashlib.sha256(checkpoint.read_bytes()).hexdigest()
    return {"checkpoint_sha256": digest, "data": data.resolve().name, **parity.document()}
