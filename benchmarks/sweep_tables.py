"""The latency sweeps as tables and plots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.table_rows import alone

from page_runtime.report.charts import Axis, Series, line_chart


def markdown(document: dict[str, Any]) -> str:
    """Three tables: by parts, beside the paper's time; by points; by the picture's size."""
    paper = document["paper_ms"]["total"]
    unstable = "A total marked * is of windows that lay more than 10 % apart: measure again on a quiet machine."
    return (
        f"Latency of one look, p50 / p95 ms, {document['frames']} procedural frames of the validation split, "
        f"{document['cpu']}, {document['threads']} threads. {unstable}\n\n"
        f"{parts_table(document)}\n"
        "Untrained weights, known answers: the forward pass of an untrained network, and votes of the truth, as wrong "
        f"as trained networks are. The paper gives {paper:.0f} ms for an unstated K.\n\n"
        f"Bundles of the {document['swept']} weights, which were trained with N = 2048 and S = 224:\n\n"
        f"{_shape_table(document['points'], 'num_points', 'N')}\n"
        f"{_shape_table(document['size'], 'image_size', 'S')}"
    )


def parts_table(document: dict[str, Any]) -> str:
    """A row for each category, fewest parts first, and the paper's."""
    paper = document["paper_ms"]
    rows = [
        (
            str(one["parts"]),
            one["category"],
            one["network"],
            *(_both(one["stages"][stage]) for stage in ("network", "scoring", "registration")),
            _total(one),
            f"{paper['total'] / one['total']['p50_ms']:.1f}",
        )
        for one in sorted(document["parts"], key=lambda one: one["parts"])
    ]
    rows.append(
        (
            "not stated",
            "paper",
            "RTX 4090",
            "-",
            *(f"{paper[s]:.0f}" for s in ("scoring", "registration", "total")),
            "1",
        )
    )
    header = (
        "K",
        "category",
        "network",
        "network, ms",
        "scoring, ms",
        "registration, ms",
        "total, ms",
        "paper's 160 ms / p50",
    )
    return _table(header, rows)


def plots(document: dict[str, Any]) -> dict[str, str]:
    """Totals as SVG files by name."""
    paper = document["paper_ms"]["total"]
    kinds = dict.fromkeys(one["network"] for one in document["parts"])
    by_parts = [
        _series(kind, [(one["parts"], one) for one in document["parts"] if one["network"] == kind]) for kind in kinds
    ]
    found = {"sweep-parts.svg": _chart(by_parts, "K, parts", paper)}
    for name, value, label in (("points", "num_points", "N, points"), ("size", "image_size", "S, px")):
        found[f"sweep-{name}.svg"] = _chart(
            [_series("total", [(one[value], one) for one in document[name]])], label, None
        )
    return found


def _series(name: str, points: Sequence[tuple[float, dict[str, Any]]]) -> Series:
    """p50 with a whisker to p95."""
    ordered = sorted(points, key=lambda one: one[0])
    p50, p95 = ([one["total"][f"{p}_ms"] for _, one in ordered] for p in ("p50", "p95"))
    # The legend of all series has one line: of "untrained weights, known answers" the last words.
    return Series(name.split(", ")[-1], [x for x, _ in ordered], p50, low=p50, high=p95, marked=True)


def _chart(series: list[Series], label: str, paper_ms: float | None) -> str:
    if paper_ms is not None:
        across = [x for one in series for x in one.x]
        series = [*series, Series("paper, RTX 4090", [min(across), max(across)], [paper_ms] * 2, dashed=True)]
    return alone(line_chart(series, Axis(label), Axis("total, ms: p50, whisker to p95")))


def _shape_table(rows: Sequence[dict[str, Any]], value: str, name: str) -> str:
    told = []
    for one in rows:
        errors = one["errors"]
        told.append((
            str(one[value]),
            *(_both(one["stages"][stage]) for stage in ("sampling", "network", "scoring")),
            _total(one),
            f"{errors['rotation_deg']:.1f}" if errors["rotation_deg"] is not None else "-",
            f"{1e3 * errors['translation_m']:.1f}" if errors["translation_m"] is not None else "-",
        ))  # fmt: skip
    header = (
        name,
        "sampling, ms",
        "network, ms",
        "scoring, ms",
        "total, ms",
        "rotation, median deg",
        "translation, median mm",
    )
    return _table(header, told)


def _both(times: dict[str, float]) -> str:
    return f"{times['p50_ms']:.0f} / {times['p95_ms']:.0f}"


def _total(one: dict[str, Any]) -> str:
    return _both(one["total"]) + ("" if one["stability"]["stable"] else " *")


def _table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [header, *rows]
    text = [f"| {' | '.join(line)} |\n" for line in lines]
    return "".join([text[0], f"|{'---|' * len(header)}\n", *text[1:]])
