"""The checks of recordings: the project's own, BOP folders, and whatever else `page-runtime` plays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from page_runtime.capture.documents import METRES_PER_MM
from page_runtime.geometry import apply, invert
from page_runtime.image_files import SourceError, read_color, read_depth
from page_runtime.part_masks import PartMasks
from page_runtime.recorded import FrameEntry, Instance, PartTruth, Source
from page_training.categories import category_named
from page_training.datasets.depth_checks import MAX_FRAMES, UNITS, check_seen, sampled
from page_training.datasets.evidence import BOX_MARGIN_M, SeenPart, thinned
from page_training.datasets.findings import Finding, in_places
from page_training.datasets.truth_checks import check_truths

# Beside the object a region holds its surroundings; a unit that is wrong by ten leaves nothing in the boxes.
LEAST_SHARE = 0.15


def check_source(
    source: Source,
    masks: PartMasks | None,
    problems: Sequence[str] = (),
    on_frame: Callable[[], None] = lambda: None,
    most_frames: int = MAX_FRAMES,
) -> list[Finding]:
    """Every finding. masks: of the parts, None where nobody marked them. problems: of frames that the source is already
    without; `on_frame` hears of each whose pictures are read,
    of which there are at most `most_frames`."""
    findings = [Finding("error", "files", problem) for problem in problems]
    chosen = [source.entries[i] for i in sampled(len(source), most_frames)]
    findings.append(Finding("fine", "files", f"{len(source)} frames, {source.format}; pictures of {len(chosen)} read"))
    findings += _regions(source)
    findings += _truths(source)
    if source.has_truth and masks is None:
        what = "no mask_visib: poses are compared with all depth of a region, which only great faults show in"
        findings.append(Finding("warning", "masks", what))
    return [*findings, *_pictures(chosen, masks, on_frame)]


def _regions(source: Source) -> Iterator[Finding]:
    without = [_place(entry) for entry in source.entries for one in entry.instances if one.region is None]
    if without:
        yield Finding("warning", "regions", f"{len(without)} instances without a region", in_places(without))


def _truths(source: Source) -> Iterator[Finding]:
    if not source.has_truth:
        yield Finding("warning", "truths", "no true poses: good to run on, not to train or validate on")
        return
    if source.category is None:
        what = "of single objects, which no --layout makes parts of a category: joints stay unchecked"
        yield Finding("warning", "truths", what)
        return
    placed = [(_place(entry), one.truths) for entry in source.entries for one in entry.instances if one.truths]
    try:
        category = category_named(source.category)
    except ValueError:
        what = f"the category {source.category!r} is not known here: sizes, joints and states stay unchecked"
        yield Finding("warning", "truths", what)
        return
    yield from check_truths(category, placed)


def _place(entry: FrameEntry) -> str:
    return f"frame {entry.index}"


def _pictures(chosen: list[FrameEntry], masks: PartMasks | None, on_frame: Callable[[], None]) -> Iterator[Finding]:
    """What the pictures of the chosen frames say, those that cannot be read named and left out."""
    seen: list[SeenPart] = []
    regions: dict[float, list[tuple[float, str]]] = {}
    blank: list[str] = []
    for entry in chosen:
        try:
            units = _raw_pictures(entry)
            if not units.any():
                blank.append(_place(entry))
            for i, instance in enumerate(entry.instances):
                if instance.truths and masks is not None and masks.known(entry.index, i):
                    part_map = masks.part_map(entry.index, i, units.shape)
                    seen += _seen(entry, instance, instance.truths, part_map, units)
                elif instance.truths and masks is not None:
                    yield Finding("error", "masks", "a mask of a part with a true pose is missing", _place(entry))
                elif instance.truths and instance.region is not None:
                    for factor, share in _region_shares(entry, instance, units).items():
                        regions.setdefault(factor, []).append((share, _place(entry)))
        except SourceError as error:
            yield Finding("error", "pictures", str(error))
        on_frame()
    if blank:
        what = f"{len(blank)} of {len(chosen)} depth pictures are 0 everywhere; record them again or leave them out"
        yield Finding("error" if len(blank) == len(chosen) else "warning", "depth", what, in_places(blank))
    if seen:
        yield from check_seen(seen, lambda unit_m: f"depth_scale {unit_m / METRES_PER_MM:g}")
    if regions:
        yield _unit_finding(regions)


def _raw_pictures(entry: FrameEntry) -> np.ndarray:
    """(H,W) the raw depth units, once the colour could be read, too; where depth is in no picture, metres over the
    entry's unit."""
    if entry.decode is not None:
        return entry.read().frame.depth_m / np.float32(entry.metres_per_unit)
    read_color(entry.color_path)
    return read_depth(entry.depth_path, metres_per_unit=1.0)


def _seen(
    entry: FrameEntry, instance: Instance, truths: tuple[PartTruth, ...], part_map: np.ndarray, units: np.ndarray
) -> Iterator[SeenPart]:
    for k, truth in enumerate(truths):
        pixels, values = thinned(part_map == k + 1, units)
        half = truth.extents_m / 2
        yield SeenPart(
            f"{_place(entry)}, {truth.name}",
            entry.camera,
            entry.metres_per_unit,
            truth.T_camera_part,
            np.stack([-half, half]),
            pixels,
            values,
            visible_share=truth.visible_share,
            region=instance.region,
        )


def _region_shares(entry: FrameEntry, instance: Instance, units: np.ndarray) -> dict[float, float]:
    """The share of a region's depth in its parts' boxes, were it so many times as far away; nothing without depth."""
    assert instance.region is not None
    x, y, w, h = instance.region
    region = np.zeros(units.shape, bool)
    region[max(0, y) : y + h, max(0, x) : x + w] = True
    pixels, values = thinned(region & (units > 0), units)
    if not len(pixels):
        return {1.0: 0.0}
    by_unit = {}
    for factor in sorted({1.0, *(unit_m / entry.metres_per_unit for unit_m in UNITS)}):
        points = entry.camera.backproject(pixels, values * entry.metres_per_unit * factor)
        inside = np.zeros(len(points), bool)
        for truth in instance.truths or ():
            own = np.abs(apply(invert(truth.T_camera_part), points)) <= truth.extents_m / 2 + BOX_MARGIN_M
            inside |= own.all(axis=1)
        by_unit[factor] = float(inside.mean())
    return by_unit


def _unit_finding(regions: dict[float, list[tuple[float, str]]]) -> Finding:
    medians = {factor: float(np.median([share for share, _ in values])) for factor, values in regions.items()}
    best = max(medians, key=lambda factor: medians[factor])
    worst = min(regions[1.0])[1]
    what = f"{100 * medians[1.0]:.0f} % of a region's depth lies in its parts' boxes (median)"
    if medians[1.0] >= LEAST_SHARE:
        return Finding("fine", "depth", what)
    if medians[best] >= LEAST_SHARE:
        return Finding("error", "depth", f"{what}, {100 * medians[best]:.0f} % were depth {best:g} times as far", worst)
    return Finding("error", "depth", f"{what}: poses, intrinsics or depth are of another frame", worst)
