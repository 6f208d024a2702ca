"""The page of `page-runtime validate --report`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from page_runtime.report.charts import Axis, Series, cumulative, line_chart
from page_runtime.report.page import NONE, Cell, cards, figure_cell, note, page, pictures, plots, table
from page_runtime.report.worst import DrawnObject, badness
from page_runtime.validation.comparison import Comparison

MOST_ROWS = 400
_ROTATION_LIMIT_DEG, _TRANSLATION_LIMIT_MM = 20.0, 50.0
COUNTED = (
    "Rotation, translation, keypoints and radii are over visible parts that have a pose; everything else over all "
    "visible parts, a missing pose counting as IoU 0 and as a failure. Small figures: 95 % interval of the mean, by a "
    "bootstrap over frames; of shares, Wilson's. A failure is no pose, or one worse than 30 degrees or half the part's "
    "diagonal."
)


def validation_page(
    document: dict[str, Any], comparisons: Mapping[str, Sequence[Comparison]], worst: Sequence[DrawnObject]
) -> str:
    """The whole page. document: `study.document_of`; comparisons: by recording."""
    several = len(document["categories"]) > 1
    settings = document["settings"]
    subtitle = (
        f"{document['frames']} frames, {document['instances']} objects, bundle {document['bundle']}, at most "
        f"{settings['looks']} looks"
    )
    sections = [("", _summary(document))]
    sections.append(("Parts", _parts(document["parts"], several=several) + note(COUNTED)))
    sections.append(("How errors are spread", _spread(document, comparisons) + _reliability(document)))
    levels = _occlusion(document["parts"], several=several)
    if levels:
        sections.append(("By how much of a part is hidden", levels))
    if document["joints"]:
        sections.append(("Joints", _joints(document["joints"], several=several)))
    sections.append(("Worst objects", _worst(worst)))
    sections.append(("Objects", _objects(comparisons)))
    sections.append(("Counted as the paper counts", _compatible(document["paper_compatible"], several=several)))
    sections.append(("Recordings", _recordings(document["recordings"])))
    return page(f"Validation: {document['recording']}", subtitle, sections)


def _summary(document: dict[str, Any]) -> str:
    found = []
    for category in document["categories"]:
        name = f"{category['name']}, " if len(document["categories"]) > 1 else ""
        interval = category["share_ci95"]["failure_rate"]
        bounds = "" if interval is None else f"95 %: {100 * interval[0]:.1f} to {100 * interval[1]:.1f} %"
        rows = [
            (f"{name}failures", _percent(category["failure_rate"]), bounds),
            (f"{name}5 deg 5 cm", _percent(category["acc_5deg5cm"]), f"of {category['visible']} visible parts"),
            (f"{name}rotation, median", _text(category["rotation_deg"]["median"], 2, "°"), "of parts with a pose"),
            (f"{name}translation, median", _text(category["translation_m"]["median"], 1, " mm", 1e3), ""),
            (f"{name}IoU, median", _text(category["iou"]["median"], 2, ""), "exact, of oriented boxes"),
        ]
        if category["segmentation"]["accuracy_on_object"] is not None:
            right = category["segmentation"]["accuracy_on_object"]
            rows.append((f"{name}points of the right part", _percent(right), "of those on the object"))
        found.append(cards(rows))
    return "".join(found)


def _percent(value: float | None) -> str:
    return _text(value, 1, " %", 100)


def _text(value: float | None, digits: int, unit: str, times: float = 1.0) -> str:
    return NONE if value is None else f"{value * times:.{digits}f}{unit}"


def _called(part: dict[str, Any], *, several: bool) -> str:
    return f"{part['category']} {part['name']}" if several else part["name"]


def _mean(figures: dict[str, Any], digits: int, times: float = 1.0) -> Cell:
    interval = figures.get("ci95", {}).get("mean")
    small = "" if not interval else f"{interval[0] * times:.{digits}f}{NONE}{interval[1] * times:.{digits}f}"
    return figure_cell(figures["mean"], digits, times, small)


def _share(figures: dict[str, Any], name: str) -> Cell:
    interval = figures.get("share_ci95", {}).get(name)
    small = "" if not interval else f"{100 * interval[0]:.0f}{NONE}{100 * interval[1]:.0f}"
    return figure_cell(figures[name], 1, 100, small)


_PART_HEADER = (
    "visible", "no pose", "failures, %", "rotation, deg", "median", "p95", "translation, mm", "median", "p95",
    "% of diag.", "IoU", "5°5cm, %", "10°10cm, %", "IoU50, %",
)  # fmt: skip


def _part_cells(part: dict[str, Any]) -> list[str | Cell]:
    rotation, translation = part["rotation_deg"], part["translation_m"]
    return [
        Cell(str(part["visible"]), part["visible"]),
        Cell(str(part["missing"]), part["missing"]),
        _share(part, "failure_rate"),
        _mean(rotation, 2),
        figure_cell(rotation["median"], 2),
        figure_cell(rotation["p95"], 1),
        _mean(translation, 1, 1e3),
        figure_cell(translation["median"], 1, 1e3),
        figure_cell(translation["p95"], 1, 1e3),
        figure_cell(part["translation_share"]["mean"], 1, 100),
        figure_cell(part["iou"]["mean"], 3),
        _share(part, "acc_5deg5cm"),
        _share(part, "acc_10deg10cm"),
        _share(part, "iou50"),
    ]


def _parts(parts: Sequence[dict[str, Any]], *, several: bool) -> str:
    first = table(("part", *_PART_HEADER), [[_called(part, several=several), *_part_cells(part)] for part in parts])
    rows = [
        [
            _called(part, several=several),
            figure_cell(part["segmentation_accuracy"], 1, 100),
            figure_cell(part["radius_m"]["mean"], 1, 1e3),
            figure_cell(part["radius_m"]["median"], 1, 1e3),
            figure_cell(part["keypoint_m"]["mean"], 1, 1e3),
            figure_cell(part["keypoint_m"]["median"], 1, 1e3),
        ]
        for part in parts
    ]
    header = ("part", "its points called so, %", "radii, mm", "median", "keypoints, mm", "median")
    return first + "<br>" + table(header, rows)


def _occlusion(parts: Sequence[dict[str, Any]], *, several: bool) -> str:
    rows: list[list[str | Cell]] = [
        [
            _called(part, several=several),
            Cell(f"{100 * level['occlusion'][0]:.0f}{NONE}{100 * level['occlusion'][1]:.0f} %", level["occlusion"][0]),
            *_part_cells(level),
        ]
        for part in parts
        for level in part["by_occlusion"]
    ]
    return table(("part", "hidden", *_PART_HEADER), rows) if rows else ""


def _joints(joints: Sequence[dict[str, Any]], *, several: bool) -> str:
    rows = []
    for joint in joints:
        times, unit = (1.0, "deg") if joint["unit"] == "deg" else (1e3, "mm")
        rows.append([
            _called(joint, several=several),
            Cell(str(joint["visible"]), joint["visible"]),
            Cell(str(joint["missing"]), joint["missing"]),
            unit,
            _mean(joint["error"], 2, times),
            figure_cell(joint["error"]["median"], 2, times),
            figure_cell(joint["error"]["p95"], 2, times),
            figure_cell(joint["axis_deg"]["median"], 2),
            figure_cell(joint["axis_offset_m"]["median"], 1, 1e3),
        ])  # fmt: skip
    header = ("joint", "visible", "no state", "unit", "state", "median", "p95", "axis, deg", "axis away, mm")
    return table(header, rows)


def _spread(document: dict[str, Any], comparisons: Mapping[str, Sequence[Comparison]]) -> str:
    several = len(document["categories"]) > 1
    rotation, translation = [], []
    category_of = {one["recording"]: one["category"] for one in document["recordings"]}
    for part in document["parts"]:
        own = [
            error
            for name, found in comparisons.items()
            if category_of[name] == part["category"]
            for one in found
            for error in one.parts
            if error.name == part["name"]
        ]
        called = _called(part, several=several)
        angles = [float(np.degrees(error.rotation_rad)) for error in own if error.rotation_rad is not None]
        lengths = [1e3 * error.translation_m for error in own if error.translation_m is not None]
        rotation.append(cumulative(called, angles, len(own), _ROTATION_LIMIT_DEG))
        translation.append(cumulative(called, lengths, len(own), _TRANSLATION_LIMIT_MM))
    shares = Axis("share of visible parts", (0.0, 1.0))
    return plots([
        (line_chart(rotation, Axis("rotation error, deg", (0, _ROTATION_LIMIT_DEG)), shares),
         "Share of the visible parts whose rotation is off by at most so much."),
        (line_chart(translation, Axis("translation error, mm", (0, _TRANSLATION_LIMIT_MM)), shares),
         "The same of translation. A part without a pose is never within."),
    ])  # fmt: skip


def _reliability(document: dict[str, Any]) -> str:
    drawn = []
    for category in document["categories"]:
        trust = category["confidence"]
        if not trust["bins"]:
            continue
        x = [one["confidence"] for one in trust["bins"]]
        y = [one["right"] for one in trust["bins"]]
        half = [1.96 * np.sqrt(max(r * (1 - r), 0.02) / one["count"]) for r, one in zip(y, trust["bins"], strict=True)]
        low = [max(0.0, r - h) for r, h in zip(y, half, strict=True)]
        high = [min(1.0, r + h) for r, h in zip(y, half, strict=True)]
        reference = Series("as it should be", (0.0, 1.0), (0.0, 1.0), dashed=True)
        measured = Series(category["name"], x, y, low, high, marked=True)
        axes = Axis("confidence", (0.0, 1.0)), Axis("share within 5 deg and 5 cm", (0.0, 1.0))
        caption = (
            f"Whether the confidence means what it says: {trust['parts']} parts of {category['name']}, off by "
            f"{trust['calibration_error']:.3f} in the mean."
        )
        drawn.append((line_chart([measured, reference], *axes), caption))
    return plots(drawn) if drawn else ""


def _words(one: Comparison) -> str:
    said = []
    for part in one.parts:
        if part.rotation_rad is None or part.translation_m is None:
            said.append(f"{part.name}: {part.reason}")
        else:
            angle, length = np.degrees(part.rotation_rad), 1e3 * part.translation_m
            said.append(f"{part.name}: {angle:.1f}°, {length:.0f} mm, confidence {part.confidence or 0:.2f}")
    return "; ".join(said)


def _worst(worst: Sequence[DrawnObject]) -> str:
    items = [(one.picture, f"{one.study}, frame {one.comparison.frame}. {_words(one.comparison)}") for one in worst]
    return note("Estimated boxes and axes in colour, true boxes thin and white.") + pictures(items)


def _objects(comparisons: Mapping[str, Sequence[Comparison]]) -> str:
    every = [(name, one) for name, found in comparisons.items() for one in found if one.parts]
    shown = sorted(every, key=lambda pair: badness(pair[1]), reverse=True)
    rows: list[list[str | Cell]] = [
        [
            name,
            Cell(str(one.frame), one.frame),
            part.name,
            figure_cell(None if part.rotation_rad is None else float(np.degrees(part.rotation_rad)), 2),
            figure_cell(part.translation_m, 1, 1e3),
            figure_cell(part.iou, 3),
            figure_cell(part.confidence, 2),
            figure_cell(None if part.visible_share is None else 1.0 - part.visible_share, 0, 100),
            Cell(str(one.looks), one.looks),
        ]
        for name, one in shown
        for part in one.parts
    ]
    cut = f" The {MOST_ROWS} worst of {len(rows)} rows; --json and --results have all." if len(rows) > MOST_ROWS else ""
    header = ("recording", "frame", "part", "rotation, deg", "mm", "IoU", "confidence", "hidden, %", "looks")
    return note(f"Worst first; click a head to sort.{cut}") + table(header, rows[:MOST_ROWS], tall=True)


def _compatible(compatible: dict[str, Any], *, several: bool) -> str:
    rows = [
        [
            _called(part, several=several),
            figure_cell(part["rotation_deg"], 2),
            figure_cell(part["translation_m"], 4),
        ]
        for part in compatible["parts"]
    ]
    what = compatible["what"]
    return table(("part", "rotation, mean deg", "translation, mean m"), rows) + note(what[0].upper() + what[1:] + ".")


def _recordings(recordings: Sequence[dict[str, Any]]) -> str:
    rows: list[list[str | Cell]] = [
        [
            one["recording"],
            one["format"],
            one["category"],
            Cell(str(one["frames"]), one["frames"]),
            Cell(str(one["instances"]), one["instances"]),
            one["bundle"],
            f"{one['sha256'][:12]} / {one['bundle_sha256'][:12]}",
        ]
        for one in recordings
    ]
    header = ("recording", "format", "category", "frames", "objects", "bundle", "SHA-256: recording / bundle")
    return table(header, rows)
