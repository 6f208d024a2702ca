"""`page-train doctor`: what is wrong with a data set, and where."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from page_runtime.capture.playback import open_source
from page_runtime.geometry import apply, invert
from page_runtime.image_files import SourceError
from page_runtime.recorded import FrameEntry, Instance, Source
from page_training.datasets.annotated import read_annotated
from page_training.datasets.checks import check_annotated
from page_training.datasets.depth_checks import BOX_MARGIN_M, MAX_DEPTH_FRAMES, UNITS
from page_training.datasets.findings import Finding
from page_training.datasets.layout import read_layout

# Beside the object a region holds its surroundings; a unit that is wrong by ten leaves nothing in the boxes.
LEAST_SHARE = 0.15


def examine(path: Path, layout: str | None = None, on_frame: Callable[[], None] = lambda: None) -> list[Finding]:
    """Findings of the data set at `path`, by a layout (see `layout.read_layout`) or, without one, as whatever
    `page-runtime` recognises: its own recordings, BOP, ReArtMix. SourceError where nothing of it can be read."""
    if layout is None:
        reartmix = read_layout("reartmix")
        # By its files: reading it as a source would stop at the first fault.
        if not ((path / reartmix.models).is_file() and (path / reartmix.annotations).is_dir()):
            return check_source(open_source(path), on_frame)
        layout = "reartmix"
    return check_annotated(read_annotated(path, read_layout(layout)), on_frame)


def check_source(source: Source, on_frame: Callable[[], None] = lambda: None) -> list[Finding]:
    """The checks that need no annotation format: pictures, truths, and whether depth lies in the parts' boxes."""
    findings = [Finding("fine", "files", f"{len(source)} frames, {source.format}")]
    if not source.has_truth:
        findings.append(Finding("warning", "truths", "no true poses: good to run on, not to train or validate on"))
    without = sum(not instance.region for entry in source.entries for instance in entry.instances)
    if without:
        findings.append(Finding("warning", "regions", f"{without} instances without a region"))
    shares: dict[float, list[float]] = {}
    step = max(1, len(source) // MAX_DEPTH_FRAMES)
    worst = (np.inf, "")
    for entry in source.entries[::step]:
        try:
            for instance, by_unit in _shares(entry):
                for factor, share in by_unit.items():
                    shares.setdefault(factor, []).append(share)
                if by_unit[1.0] < worst[0]:
                    worst = by_unit[1.0], f"{entry.depth_path}, region {instance.region}"
        except SourceError as error:
            findings.append(Finding("error", "pictures", str(error)))
        on_frame()
    if shares:
        findings.append(_unit_finding(shares, worst[1]))
    return findings


def _shares(entry: FrameEntry) -> list[tuple[Instance, dict[float, float]]]:
    """Of each instance with truth, the share of its depth in its parts' boxes, were it so many times as far away."""
    frame = entry.read().frame
    found = []
    for instance in entry.instances:
        if instance.region is None or not instance.truths:
            continue
        x, y, w, h = instance.region
        depth_m = frame.depth_m[max(0, y) : y + h, max(0, x) : x + w]
        rows, columns = np.nonzero(depth_m > 0)
        if len(rows) == 0:
            continue
        chosen = np.linspace(0, len(rows) - 1, min(len(rows), 4000)).astype(np.intp)
        rows, columns = rows[chosen], columns[chosen]
        pixels = np.stack([columns + max(0, x), rows + max(0, y)], axis=1).astype(float)
        by_unit = {}
        for factor in sorted({1.0, *(unit_m / entry.metres_per_unit for unit_m in UNITS)}):
            points = frame.camera.backproject(pixels, depth_m[rows, columns] * factor)
            inside = np.zeros(len(points), bool)
            for truth in instance.truths:
                own = np.abs(apply(invert(truth.T_camera_part), points)) <= truth.extents_m / 2 + BOX_MARGIN_M
                inside |= own.all(axis=1)
            by_unit[factor] = float(inside.mean())
        found.append((instance, by_unit))
    return found


def _unit_finding(shares: dict[float, list[float]], worst: str) -> Finding:
    medians = {factor: float(np.median(values)) for factor, values in shares.items()}
    best = max(medians, key=lambda factor: medians[factor])
    what = f"{100 * medians[1.0]:.0f} % of a region's depth lies in its parts' boxes (median)"
    if medians[1.0] >= LEAST_SHARE:
        return Finding("fine", "depth", what)
    if medians[best] >= LEAST_SHARE:
        return Finding("error", "depth", f"{what}, {100 * medians[best]:.0f} % were depth {best:g} times as far", worst)
    return Finding("error", "depth", f"{what}: poses, intrinsics or depth are of another frame", worst)
