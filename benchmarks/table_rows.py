"""Figures of the paper and of ours in one list, and what is written of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from benchmarks.paper import FRAMES_PER_S, OURS, RADIUS_VARIANCE, TABLE_8, TABLE_9, TABLES, Row

from page_runtime.report.charts import bar_chart

PAPER, HERE = "paper", "page-edge"
TITLES = {table.number: f"{table.title} ({table.data})" for table in TABLES} | {
    "X": "spread of the radii of keypoints (ArtImage, laptop)",
    "XI": "frames a second (RTX 4090)",
}
METRICS = ("rotation, deg", "translation, m", "IoU, %", "segmentation, %")
# An ablation's own name, the paper's table it belongs to, and the row there.
ABLATIONS = (
    ("FPS, 3", "II", "keypoints: FPS"),
    ("box corners, 3", "II", "keypoints: box"),
    ("KP-Estimator, 3", "II", "keypoints: pre-defined"),
    ("concatenation", "II", "fusion: concatenation"),
    ("dense fusion", "II", "fusion: dense"),
    ("ours", "II", "fusion: PAGE"),
    ("KP-Estimator, 4", "II", "4 keypoints"),
    ("KP-Estimator, 5", "II", "5 keypoints"),
    ("regression", "II", "prediction: direct regression"),
    ("anchors (6-PACK)", "II", "voting: 6-PACK"),
    ("ours", "I", "PAGE, budget of the ablations"),
    ("dense fusion", "I", "DenseFusion, its fusion alone"),
    ("anchors (6-PACK)", "I", "6-PACK, in its manner"),
    ("normalised coordinates (A-NCSH)", "I", "A-NCSH, in its manner"),
    ("pair voting (CPPF)", "I", "CPPF, in its manner"),
    ("depth only", "IV", "depth"),
    ("tau 0.9, 0.1", "VI", "tau 0.9, 0.1"),
    ("tau 0.75, 0.25", "VI", "tau 0.75, 0.25"),
    ("tau 0.5, 0.5", "VI", "tau 0.5, 0.5"),
    ("tau 0.1, 0.9", "VI", "tau 0.1, 0.9"),
    ("lambda 0.2, 0.4", "VII", "lambda 0.2, 0.4, 0.4"),
    ("lambda 0.4, 0.3", "VII", "lambda 0.4, 0.3, 0.3"),
    ("lambda 0.8, 0.1", "VII", "lambda 0.8, 0.1, 0.1"),
)
NOT_THERE = (
    "Rows in the manner of 6-PACK (anchors), A-NCSH (normalised coordinates with RANSAC) and CPPF (voting by pairs) "
    "are heads, losses and solvers written here on this project's layers below them, trained with the same budget as "
    "every other ablation; they are not their authors' systems. PoseCNN and ASMM have no row of ours. Rows of ours are "
    "missing wherever no bundle, recording or ablation is."
)


class Figure(NamedTuple):
    """source: PAPER or HERE. part: its name, or its place in the paper. low, high: of a 95 % interval, if any."""

    table: str
    category: str
    row: str
    source: str
    data: str
    part: str
    metric: str
    value: float | None
    low: float | None = None
    high: float | None = None


def figures_from(results: dict[str, Any]) -> list[Figure]:
    """All of the paper's, then ours. results: `table_steps.results_of`."""
    found = list(_of_paper())
    for one in results["validations"]:
        found += _of_validation(one)
    found += _of_ablations(results["ablations"])
    found += _of_robustness(results["robustness"])
    found += _of_radii(results["radii"])
    for one in results["latencies"]:
        document = one["document"]
        value, stable = 1e3 / document["total"]["p50_ms"], document["stability"]["stable"]
        data = f"{document['cpu']}, threads {document['threads']}, {'stable' if stable else 'UNSTABLE'}"
        row = f"{HERE}, {document['parts']} parts"
        found.append(Figure("XI", one["category"], row, HERE, data, "all", "frames/s", value))
        found += [
            Figure("XI", one["category"], row, HERE, data, "all", f"total {p}, ms", document["total"][f"{p}_ms"])
            for p in ("p50", "p95")
        ]
    return found


def _of_paper() -> Iterator[Figure]:
    for table in TABLES:
        for row in table.rows:
            yield from _of_row(table.number, table.data, row)
    for name, values in RADIUS_VARIANCE.items():
        for place, value in enumerate(values, 1):
            yield Figure("X", "laptop", name, PAPER, "ArtImage", f"keypoint {place}", "radius, variance", value)
    for name, value in FRAMES_PER_S.items():
        yield Figure("XI", "", name, PAPER, "RTX 4090", "all", "frames/s", value)


def _of_row(number: str, data: str, row: Row) -> Iterator[Figure]:
    for metric, values in zip(METRICS, (row.rotation_deg, row.translation_m, row.iou), strict=False):
        for place, value in enumerate(values, 1):
            yield Figure(number, row.category, row.method, PAPER, data, str(place), metric, value)
    if row.accuracy is not None:
        yield Figure(number, row.category, row.method, PAPER, data, "all", METRICS[3], 100 * row.accuracy)


def _of_validation(one: dict[str, Any]) -> Iterator[Figure]:
    document, category, data = one["document"], one["category"], one["data"]
    numbers = [table.number for table in TABLES if any(row.category == category for row in table.rows)]
    for number in numbers:
        if number not in ("I", "III", "IV", "V"):
            continue
        row = "depth and colour" if number == "IV" else HERE
        for part in document["parts"]:
            yield from _of_part(number, category, row, data, part)
        accuracy = document["categories"][0]["segmentation"]["accuracy_on_object"]
        if number == "IV" and accuracy is not None:
            yield Figure(number, category, row, HERE, data, "all", METRICS[3], 100 * accuracy)
    for part in document["parts"]:
        for level in part["by_occlusion"]:
            hidden = level["occlusion"]
            row = f"{100 * hidden[0]:.0f} to {100 * hidden[1]:.0f} %"
            yield from _of_part(TABLE_8.number, category, row, data, {**level, "name": part["name"]})


def _of_part(number: str, category: str, row: str, data: str, part: dict[str, Any]) -> Iterator[Figure]:
    for metric, name, times in zip(METRICS, ("rotation_deg", "translation_m", "iou"), (1.0, 1.0, 100.0), strict=False):
        interval = (part[name].get("ci95") or {}).get("mean") or (None, None)
        low, high = (None if end is None else end * times for end in interval)
        mean = part[name]["mean"]
        value = None if mean is None else mean * times
        yield Figure(number, category, row, HERE, data, part["name"], metric, value, low, high)


def _of_ablations(document: dict[str, Any] | None) -> Iterator[Figure]:
    if document is None:
        return
    data = f"{document['recording']}, each network after {document['samples']:,} frames"
    for name, number, row in ABLATIONS:
        for part in document["results"].get(name, {"parts": ()})["parts"]:
            yield from _of_part(number, document["category"], row, data, part)


def _of_robustness(one: dict[str, Any] | None) -> Iterator[Figure]:
    if one is None:
        return
    for setting, figures in one["document"]["settings"].items():
        for part in figures["parts"]:
            yield from _of_part(TABLE_9.number, one["category"], f"{setting}, {HERE}", one["data"], part)


def _of_radii(document: dict[str, Any] | None) -> Iterator[Figure]:
    if document is None:
        return
    for name, by_part in document["radius_std"].items():
        for part, values in enumerate(by_part, 1):
            for place, value in enumerate(values, 1):
                where = f"part {part}, keypoint {place}"
                data = "procedural scenes, in the part's diagonals"
                yield Figure("X", document["category"], name, HERE, data, where, "radius, standard deviation", value)


def markdown(figures: Sequence[Figure], results: dict[str, Any]) -> str:
    """A section for each of the paper's tables; its own rows of other categories than ours are left to the CSV."""
    measured = {figure.category for figure in figures if figure.source == HERE}
    sections = [
        "# The paper's tables, and ours\n",
        "Ours are measured with the same metrics on other data, named in each row, and neither folded nor capped. The "
        "95 % intervals are of the mean. Two rows of one table are not a comparison of methods.\n",
        f"{NOT_THERE}\n",
    ]
    if results["ablations"] is None:
        sections.append("No ablations are there: run benchmarks/ablations.py, then this again.\n")
    for number, title in TITLES.items():
        own = [one for one in figures if one.table == number]
        shown = [one for one in own if one.source == HERE or one.category in (measured | {""})]
        shown = shown or [one for one in own if one.row == OURS] or own
        sections.append(f"## Table {number}: {title}\n\n{_table(shown)}")
        if not any(one.source == HERE for one in own):
            sections.append("No row of ours.\n")
    return "\n".join(sections)


def _table(figures: Sequence[Figure]) -> str:
    """A line for each category, row and source; its parts side by side in a cell."""
    metrics = list(dict.fromkeys(one.metric for one in figures))
    lines = list(dict.fromkeys((one.category, one.row, one.source, one.data) for one in figures))
    text = f"| category | row | from | data | {' | '.join(metrics)} |\n|{'---|' * (4 + len(metrics))}\n"
    for line in lines:
        own = [one for one in figures if (one.category, one.row, one.source, one.data) == line]
        cells = [", ".join(_cell(one) for one in own if one.metric == metric) for metric in metrics]
        text += f"| {' | '.join((*line, *cells))} |\n"
    return text


def _cell(figure: Figure) -> str:
    if figure.value is None:
        return "-"
    interval = "" if figure.low is None or figure.high is None else f" ({figure.low:.3g} to {figure.high:.3g})"
    return f"{figure.value:.3g}{interval}"


def plots_from(figures: Sequence[Figure]) -> dict[str, str]:
    """Rotation errors of every table and category that has rows of ours, as SVG files by name."""
    found = {}
    own = [one for one in figures if one.metric == METRICS[0] and one.value is not None]
    for table, category in dict.fromkeys((one.table, one.category) for one in own if one.source == HERE):
        here = [one for one in own if (one.table, one.category) == (table, category)]
        rows = []
        for row, source in dict.fromkeys((one.row, one.source) for one in here):
            values = [one.value or 0.0 for one in here if (one.row, one.source) == (row, source)]
            mean = sum(values) / len(values)
            rows.append((f"{row}, {source}" if row != source else row, mean, mean))
        found[f"table-{table}-{category}.svg"] = alone(bar_chart(rows, "deg", label_px=230))
    return found


def alone(svg: str) -> str:
    """A drawing of a page as a file of its own, with the page's colours."""
    style = (
        "<style>:root { --soft:#66717d; --rule:#e3e7eb; --paper:#fff; --c0:#2f6f9f; --c1:#d07c2e; }"
        "text { fill: #66717d; font: 11px sans-serif; }</style>"
    )
    return svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1).replace(">", f">{style}", 1)
