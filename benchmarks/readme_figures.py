"""The README's figures, written between its markers from the committed results and the shipped bundles.

    python benchmarks/readme_figures.py

`make tables` ends with it, and a test holds the README to what it writes.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
RESULTS = ROOT / "benchmarks" / "results"
BUNDLES = ROOT / "runtime" / "bundles"
# How far each is known: the other categories follow, in the order of their names.
FIRST = ("laptop", "box", "drawer")


def main() -> int:
    try:
        write_readme()
    except (OSError, ValueError) as error:
        print(f"readme_figures: {error}", file=sys.stderr)
        return 2
    return 0


def write_readme(path: Path = README) -> None:
    """ValueError where a marker is missing."""
    path.write_text(with_figures(path.read_text(encoding="utf-8")), encoding="utf-8")


def with_figures(text: str) -> str:
    """The text with what lies between the markers of every section written anew."""
    markers = {name: (f"<!-- figures: {name} -->\n", f"<!-- end of figures: {name} -->") for name in SECTIONS}
    for begin, end in markers.values():
        if text.count(begin) != 1 or text.count(end) != 1:
            raise ValueError(f"expected the markers {begin.strip()!r} and {end!r} once each; put them back")
    for name, section in SECTIONS.items():
        begin, end = markers[name]
        before, rest = text.split(begin)
        _, after = rest.split(end)
        text = f"{before}{begin}{section()}{end}{after}"
    return text


def training() -> str:
    """How many frames each shipped network has seen, as its bundle says."""
    from page_runtime.bundle_file import read_bundle

    seen = {path.stem: read_bundle(path).metadata.provenance.get("frames_seen") for path in BUNDLES.glob("*.onnx")}
    told = ", ".join(f"{seen[name]:,} ({name})" for name in _ordered(seen) if seen[name])
    return f"Frames seen in training, repeats included: {told}.\n"


def accuracy() -> str:
    """A row for each part of every kept validation."""
    header = ("data", "part", "rotation, deg", "translation, mm", "of diagonal, %", "5 deg 5 cm, %", "failures, %")
    rows = []
    for one in _validations():
        for part in one["parts"]:
            rotation, translation, share = (
                part[name] for name in ("rotation_deg", "translation_m", "translation_share")
            )
            rows.append((
                f"{one['category']}, {one['data']}",
                part["name"],
                f"{_figure(rotation['mean'])} / {_figure(rotation['median'])}",
                f"{_figure(translation['mean'], 1e3)} / {_figure(translation['median'], 1e3)}",
                f"{_figure(share['mean'], 100)} / {_figure(share['median'], 100)}",
                _figure(part["acc_5deg5cm"], 100, digits=0),
                _figure(part["failure_rate"], 100),
            ))  # fmt: skip
    return _table(header, rows)


def joints() -> str:
    """The error of every joint's state."""
    rows = []
    for one in _validations():
        for joint in one["joints"]:
            times, unit = (1e3, "mm") if joint["unit"] == "m" else (1.0, joint["unit"])
            error = joint["error"]
            if error["median"] is None:
                continue
            told = f"{_figure(error['mean'], times)} / {_figure(error['median'], times)} {unit}"
            rows.append((f"{one['category']}, {one['data']}", joint["name"], told))
    return _table(("data", "joint", "error of its state"), rows)


def latency() -> str:
    """A column for each bundle that was timed, beside the paper's times, and what they were measured on."""
    from page_runtime.bench import PAPER_MS

    timed = {path.stem.removeprefix("latency-"): _read(path) for path in RESULTS.glob("latency-*.json")}
    names = _ordered(timed)
    rows = []
    for stage in (*timed[names[0]]["stages"], "total"):
        cells = []
        for name in names:
            times = timed[name]["total"] if stage == "total" else timed[name]["stages"][stage]
            cells.append(f"{times['p50_ms']:.0f} / {times['p95_ms']:.0f}")
        paper = f"{PAPER_MS[stage]:.0f}" if stage in PAPER_MS else "-"
        rows.append((stage, *cells, paper))
    rows.append(("spread of three windows' medians, %", *(_spread(timed[name]) for name in names), "-"))
    rows.append(("longer than 160 ms, %", *(_late(timed[name]) for name in names), "-"))
    rows.append(("peak resident memory, MB", *(f"{timed[name]['peak_rss_mb']:.0f}" for name in names), "-"))
    cold = [f"{1e-3 * timed[name]['cold_start']['total_ms']:.2f}" for name in names]
    rows.append(("start of the process to the first pose, s", *cold, "-"))
    header = ("p50 / p95 ms", *(f"{name}, K = {timed[name]['parts']}" for name in names), "paper")
    machines = sorted({f"{one['cpu']}, {one['threads']} threads" for one in timed.values()})
    return f"{_table(header, rows)}\nMeasured on {'; '.join(machines)}.\n"


def elsewhere() -> str:
    """Of `page-runtime bench` on other machines, a row for each kept run."""
    header = (
        "machine, threads", "bundle", "network", "total", "spread of windows, %", "longer than 160 ms, %",
        "first pose, s",
    )  # fmt: skip
    rows = []
    for path in sorted((RESULTS / "elsewhere").glob("*.json")):
        one = _read(path)
        network, total = (
            f"{times['p50_ms']:.0f} / {times['p95_ms']:.0f}" for times in (one["stages"]["network"], one["total"])
        )
        cold = f"{1e-3 * one['cold_start']['total_ms']:.2f}"
        rows.append(
            (f"{one['cpu']}, {one['threads']}", one["category"], network, total, _spread(one), _late(one), cold)
        )
    return _table(header, rows)


def sweeps() -> str:
    """Latency by parts beside the paper's time, of the last kept run of benchmarks/latency_sweeps.py."""
    from benchmarks.sweep_tables import parts_table

    path = RESULTS / "sweeps.json"
    if not path.is_file():
        return "No run of `benchmarks/latency_sweeps.py` is kept yet.\n"
    document = _read(path)
    return f"{parts_table(document)}\nMeasured on {document['cpu']}, {document['threads']} threads.\n"


SECTIONS: dict[str, Callable[[], str]] = {
    "training": training,
    "accuracy": accuracy,
    "joints": joints,
    "latency": latency,
    "elsewhere": elsewhere,
    "sweeps": sweeps,
}


def _validations() -> list[dict[str, Any]]:
    """By category, and in one by the names of their files."""
    kept = {path.stem: _read(path) for path in sorted((RESULTS / "accuracy").glob("*.json"), key=lambda one: one.stem)}
    order = _ordered({one["category"] for one in kept.values()})
    return sorted(kept.values(), key=lambda one: order.index(one["category"]))


def _ordered(names: Any) -> list[str]:
    return sorted(names, key=lambda name: (FIRST.index(name) if name in FIRST else len(FIRST), name))


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def _spread(document: dict[str, Any]) -> str:
    stability = document["stability"]
    return f"{100 * stability['spread']:.0f}" + ("" if stability["stable"] else ", unstable")


def _late(document: dict[str, Any]) -> str:
    return f"{100 * next(one['missed_share'] for one in document['deadlines'] if one['budget_ms'] == 160.0):.1f}"


def _figure(value: float | None, times: float = 1.0, *, digits: int = 1) -> str:
    if value is None:
        return "-"
    return f"{value * times:.{digits}f}" if value * times < 99.95 else f"{value * times:.0f}"


def _table(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [header, ("---",) * len(header), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines).replace("| --- ", "|---").replace("|--- |", "|---|")


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.readme_figures` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
