"""page-export optimise: the forms of a bundle in one table."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.progress import Progress

from page_export.bundle_writer import bundle_bytes, write_file
from page_export.given import open_fitting
from page_export.mixed import SEARCH_FRAMES, Search, grouped, search
from page_export.optimisation import Measured, TrueSample, measure, recommended
from page_export.variants import CALIBRATION_FRAMES, Forms, chosen_for_calibration
from page_runtime.bundle_file import read_bundle
from page_runtime.commands.outputs import require_file_place, require_folder_place
from page_runtime.commands.usage import UsageError
from page_runtime.estimator import first_look
from page_runtime.neighbours import find_neighbours
from page_runtime.network import Network

ROUNDS = 3
# Objects that forms are measured on; a choice. What is decided on are medians and one failure more in a hundred parts:
# of fewer, a single object decides.
MIN_OBJECTS = 20


def run(options: argparse.Namespace) -> int:
    """Measure the forms and write those that are not refused; ValueError for what cannot be measured."""
    if options.frames < MIN_OBJECTS:
        raise UsageError(
            f"--frames: expected at least {MIN_OBJECTS} regions to measure on, got {options.frames}: which form is "
            "recommended would depend on which regions they are"
        )
    require_file_place(options.json, option="--json")
    require_folder_place(options.output, option="--output")
    metadata = read_bundle(options.bundle).metadata
    tested, others = _samples(options.bundle, options.data, options.frames)
    calibration = chosen_for_calibration([given for given, _ in others], CALIBRATION_FRAMES)
    with TemporaryDirectory() as name, Progress(disable=not sys.stderr.isatty()) as progress:
        folder = Path(name)
        forms = Forms(options.bundle, metadata, calibration, folder)
        logging.disable(logging.WARNING)  # the converter's advice, which is not for who runs this
        searching = progress.add_task(f"{len(grouped(forms.layers))} groups of layers in 8 bits", total=None)
        found = search(
            options.bundle,
            metadata,
            forms,
            others[:SEARCH_FRAMES],
            folder,
            bound=options.max_pose_error,
            on_sample=lambda: progress.advance(searching),
        )
        progress.remove_task(searching)
        models = {"fp16": forms.half(), "int8-dynamic": forms.dynamic(), "int8-static": forms.static()}
        if found.chosen:
            models["int8-mixed"] = forms.static([x.name for x in forms.layers if x.works_on in found.chosen])
        made = {"fp32": options.bundle}
        for name, model in models.items():
            path = folder / f"{options.bundle.stem}.{name}.onnx"
            # The comparison with the checkpoint was not of this form.
            provenance = {key: value for key, value in metadata.provenance.items() if key != "parity"}
            provenance |= {"form": f"{name} of {options.bundle.name}"}
            write_file(bundle_bytes(model, replace(metadata, provenance=provenance)), path)
            made[name] = path
        task = progress.add_task("measuring", total=2 * ROUNDS * len(tested))
        results = measure(made, tested, rounds=ROUNDS, on_sample=lambda: progress.advance(task))
        refused = {one.name for one in results[1:] if one.refused(options.max_pose_error, results[0].failures)}
        written = write_kept({name: made[name] for name in models}, refused, options.output)
    best = recommended(results, options.max_pose_error)
    sys.stdout.write(search_table(found, options.max_pose_error))
    sys.stdout.write(table(results, best, options.max_pose_error, len(tested)))
    sys.stdout.write(written)
    if options.json is not None:
        document = {
            "bundle": options.bundle.name,
            "frames": len(tested),
            "calibration_frames": len(calibration),
            "max_pose_error": options.max_pose_error,
            "recommended": best.name,
            "forms": [{**one.document(), "refused": one.name in refused} for one in results],
            "mixed": found.document(),
        }
        write_file((json.dumps(document, indent=1) + "\n").encode(), options.json)
    return 0


def write_kept(forms: dict[str, Path], refused: Collection[str], folder: Path) -> str:
    """Write the forms that are not refused into the folder; what is there now, for people.

    A refused one's file of an earlier run is left, and named.
    """
    lines: list[str] = []
    for name, made in forms.items():
        path = folder / made.name
        if name not in refused:
            write_file(made.read_bytes(), path)
            lines.append(f"{path}: written")
        elif path.exists():
            lines.append(f"{path}: of an earlier run; this one refuses {name} and left the file as it was")
    return "".join(f"{line}\n" for line in lines)


def search_table(found: Search, bound: float) -> str:
    """For people: what each group of layers costs in 8 bits, and what is made of it."""
    lines = [f"{'in 8 bits alone':20s} {'layers':>6s} {'10^6 mult.':>10s} {'kB less':>8s} {'time':>5s} {'error':>6s}"]
    for one in found.groups:
        if one.name in found.chosen:
            verdict = "in int8-mixed"
        elif not one.pays:
            verdict = "no quicker"
        else:
            verdict = "with the others over the limit" if one.harmless(bound) else f"over {bound:g}, or more failures"
        lines.append(
            f"{one.name:20s} {one.layers:6d} {one.multiplications / 1e6:10.1f} {one.saved_bytes / 1e3:8.0f} "
            f"{one.time:5.2f} {one.error:6.2f}  {verdict}"
        )
    if not found.chosen:
        lines.append("8 bits make no group of layers quicker here within the limit: there is no int8-mixed")
    lines.append("time, error: of the original's; time: of a whole pass, the worse of one and two threads")
    return "\n".join(lines) + "\n\n"


def table(results: list[Measured], best: Measured, bound: float, frames: int) -> str:
    """For people."""
    lines = [
        f"{'form':14s} {'MB':>6s} {'load ms':>8s} {'1 thread p50/p95':>17s} {'2 threads p50/p95':>18s} "
        f"{'deg':>6s} {'mm':>6s} {'failures':>9s} {'error':>6s}"
    ]
    for one in results:
        latency = [f"{one.latency[threads].p50_ms:.1f} / {one.latency[threads].p95_ms:.1f}" for threads in (1, 2)]
        refused = one is not results[0] and one.refused(bound, results[0].failures)
        verdict = "recommended" if one is best else f"refused: over {bound:g}, or more failures" if refused else ""
        lines.append(
            f"{one.name:14s} {one.size_bytes / 1e6:6.2f} {one.load_ms:8.0f} {latency[0]:>17s} {latency[1]:>18s} "
            f"{one.rotation_deg:6.2f} {one.translation_mm:6.2f} {100 * one.failures:7.1f} % {one.error:6.2f}  {verdict}"
        )
    note = f"{frames} objects; deg, mm: medians against the truth; error: of the original's; refused forms are not kept"
    return "\n".join([*lines, note]) + "\n"


def _samples(bundle: Path, data: Path, frames: int) -> tuple[list[TrueSample], list[TrueSample]]:
    """The first regions and the others as the bundle's first look has them, with their truth; ValueError where there
    are too few. Of thin objects those are taken where the bundle itself saw them, whatever a form would have seen."""
    network = Network(bundle)
    source = open_fitting(bundle, network.metadata.category, data, with_truth=True)
    tested: list[TrueSample] = []
    others: list[TrueSample] = []
    for recorded in source:
        for instance in recorded.instances:
            if instance.region is None or instance.truths is None:
                continue
            sample = first_look(network, recorded.frame, instance.region).sample
            if sample is None:
                continue
            given = sample, find_neighbours(sample.points_camera - sample.center_camera)
            (tested if len(tested) < frames else others).append((given, instance.truths))
    if len(others) < 2:
        raise UsageError(
            f"{data}: expected at least two regions with depth and truth more than --frames {frames}, as the others "
            f"calibrate; got {len(tested) + len(others)} in all; give a longer recording, or measure on fewer (at "
            f"least {MIN_OBJECTS})"
        )
    return tested, others
