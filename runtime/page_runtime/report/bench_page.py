"""The page of `page-runtime bench --report`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from page_runtime.bench import PERCENTILES, Window
from page_runtime.report.charts import Axis, Series, bar_chart, cumulative, line_chart
from page_runtime.report.page import Cell, cards, figure_cell, note, page, plots, table


def bench_page(document: dict[str, Any], windows: Sequence[Window]) -> str:
    """The whole page. document: as `page-runtime bench --json` writes it; windows: the timings behind it."""
    subtitle = (
        f"{document['measurements']} estimates of {document['frames']} frames in {len(windows)} windows, bundle "
        f"{document['bundle']}, threads {document['threads']}, {document['cpu']}"
    )
    sections = [("", _summary(document)), ("Stages", _stages(document)), ("Over time", _over_time(document, windows))]
    sections += [(f"Sweep: {sweep['what']}", _sweep(sweep)) for sweep in document["sweeps"]]
    sections += [("Cold start", _cold_start(document["cold_start"])), ("Measured on", _machine(document))]
    return page(f"Benchmark: {document['recording']}", subtitle, sections)


def _summary(document: dict[str, Any]) -> str:
    total, stability, energy = document["total"], document["stability"], document["energy"]
    items = [
        ("total, p50", f"{total['p50_ms']:.1f} ms", f"p95 {total['p95_ms']:.1f}, p99 {total['p99_ms']:.1f} ms"),
        ("the windows", "stable" if stability["stable"] else "unstable",
         f"their medians are {100 * stability['spread']:.1f} % apart"),
    ]  # fmt: skip
    items += [
        (f"over {one['budget_ms']:g} ms", f"{100 * one['missed_share']:.1f} %",
         f"{one['missed']} of {document['measurements']}")
        for one in document["deadlines"]
    ]  # fmt: skip
    items += [
        ("jitter", f"{document['jitter']['std_ms']:.1f} ms", "standard deviation of the total"),
        ("first pose", f"{document['cold_start']['total_ms'] / 1e3:.2f} s", "after the start of a process"),
        ("peak memory", f"{document['peak_rss_mb'] or 0:.0f} MB", "resident, loading included"),
    ]
    if energy is not None:
        items.append(("energy", f"{energy['per_estimate_j']:.2f} J", "an estimate, of the whole package"))
    return cards(items)


def _stages(document: dict[str, Any]) -> str:
    figures = {**document["stages"], "total": document["total"]}
    rows: list[list[str | Cell]] = [
        [
            name,
            *(figure_cell(one[f"p{p}_ms"], 1) for p in PERCENTILES),
            figure_cell(document["paper_ms"].get(name), 0),
        ]
        for name, one in figures.items()
    ]
    bars = bar_chart([(name, one["p50_ms"], one["p95_ms"]) for name, one in document["stages"].items()], "ms")
    header = ("stage, ms", *(f"p{p}" for p in PERCENTILES), "paper")
    remark = (
        "The paper's figures are of an RTX 4090 and of a workload that it does not state in full; they are a budget, "
        "not a race."
    )
    return table(header, rows) + note(remark) + plots([(bars, "Median of every stage; the whisker ends at p95.")])


def _over_time(document: dict[str, Any], windows: Sequence[Window]) -> str:
    series, first = [], 0
    for number, window in enumerate(windows, 1):
        totals = [timing.total_ms for timing in window.timings]
        series.append(Series(f"window {number}", list(range(first, first + len(totals))), totals))
        first += len(totals)
    every = [timing.total_ms for window in windows for timing in window.timings]
    # One estimate that the system held up must not flatten all others.
    high = max(float(np.percentile(every, 99)) * 1.35, float(np.median(every)) * 1.5)
    lines = line_chart(series, Axis("estimate"), Axis("total, ms", (0.0, high)))
    shares = [cumulative(one.name, list(one.y), len(one.y), high) for one in series]
    spread = line_chart(shares, Axis("total, ms", (0.0, high)), Axis("share of estimates", (0.0, 1.0)))
    apart = f"{100 * document['stability']['spread']:.1f} %"
    return plots([
        (lines, "Every estimate in the order it was made; beyond the upper edge where it stays there."),
        (spread, f"The same, sorted. Windows whose medians are {apart} apart; 10 % are allowed."),
    ])  # fmt: skip


def _sweep(sweep: dict[str, Any]) -> str:
    values = [step["value"] for step in sweep["steps"]]
    known = [step["errors"] for step in sweep["steps"]]
    label = Axis(sweep["what"])
    times = [
        Series("total, p50", values, [step["total"]["p50_ms"] for step in sweep["steps"]], marked=True),
        Series("total, p95", values, [step["total"]["p95_ms"] for step in sweep["steps"]], marked=True),
        Series("scoring, p50", values, [step["stages"]["scoring"]["p50_ms"] for step in sweep["steps"]], marked=True),
        Series("network, p50", values, [step["stages"]["network"]["p50_ms"] for step in sweep["steps"]], marked=True),
    ]
    drawn = [(line_chart(times, label, Axis("ms")), "Time of an estimate.")]
    rotations = [(value, one["rotation_deg"]) for value, one in zip(values, known, strict=True)
                 if one is not None and one["rotation_deg"] is not None]  # fmt: skip
    if rotations:
        errors = Series("median", [v for v, _ in rotations], [r for _, r in rotations], marked=True)
        drawn.append((line_chart([errors], label, Axis("rotation error, deg")), "Rotation error over all parts."))
    rows: list[list[str | Cell]] = [
        [
            Cell(f"{step['value']:g}", step["value"]),
            figure_cell(step["total"]["p50_ms"], 1),
            figure_cell(step["total"]["p95_ms"], 1),
            figure_cell((step["errors"] or {}).get("rotation_deg"), 2),
            figure_cell((step["errors"] or {}).get("translation_m"), 1, 1e3),
            figure_cell((step["errors"] or {}).get("failure_rate"), 1, 100),
            "stable" if step["stability"]["stable"] else "unstable",
        ]
        for step in sweep["steps"]
    ]
    header = (sweep["what"], "p50, ms", "p95", "rotation, deg", "translation, mm", "failures, %", "windows")
    return plots(drawn) + table(header, rows)


def _cold_start(cold: dict[str, Any]) -> str:
    stages = [
        (name.removesuffix("_ms").replace("_", " "), cold[name], cold[name])
        for name in cold
        if name.endswith("_ms") and name != "total_ms"
    ]
    text = f"Medians of {cold['repeats']} fresh processes; files are in the system's cache after the first."
    return plots([(bar_chart(stages, "ms"), text)])


def _machine(document: dict[str, Any]) -> str:
    facts = {
        "processor": document["cpu"],
        "threads": document["threads"],
        "governor": ", ".join(document["governor"]) or "not shown by the system",
        "load before and after": " and ".join(str(one) for one in document["load"]),
        "commit": document["commit"] or "not a work tree",
        "bundle, SHA-256": document["bundle_sha256"],
        "recording, SHA-256": document["recording_sha256"],
        "at most so many looks": document["looks"],
        **document["versions"],
    }
    return table(("", ""), [[name, str(value)] for name, value in facts.items()])
