"""page-runtime bench: the time of every stage beside the paper's."""

from __future__ import annotations

import json as json_text
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from page_runtime.bench import PAPER_MS, PERCENTILES, WINDOWS, Window, report, time_windows
from page_runtime.bench_comparison import TOLERANCE, NotComparable, compare
from page_runtime.cold_start import cold_start
from page_runtime.commands.inputs import Inputs, load_network, open_inputs
from page_runtime.commands.outputs import require_file_place, text_output, write_json
from page_runtime.commands.terminal import Progress, number, table
from page_runtime.commands.usage import UsageError
from page_runtime.content_hash import sha256_of
from page_runtime.machine import commit, governors, load_average
from page_runtime.providers import ProviderChoice, short_name
from page_runtime.recorded import Source
from page_runtime.report.bench_page import bench_page
from page_runtime.sampling import Region
from page_runtime.sweep import VARIES, Sweep, run_sweep, sweep_from

EXIT_REGRESSION = 1


def bench(
    recording: str | None,
    *,
    bundle: Path | None,
    json: Path | None,
    report: Path | None,
    region: Region | None,
    budget: Sequence[float],
    sweep: Sequence[str],
    compare: Sequence[Path] | None,
    window_s: float,
    threads: int,
    on: ProviderChoice,
    looks: int,
    quiet: bool,
) -> int:
    """Time every frame of `recording`; write the figures to `json`, a page to `report` and a table to standard output.
    With `compare`, of two documents only the verdict; 1 for a slower one, or one that may be."""
    if compare is not None:
        if recording is not None:
            raise UsageError("--compare: it times nothing; leave the recording out")
        return _compared(*compare)
    if recording is None or bundle is None:
        raise UsageError("bench: expected a recording and --bundle, or --compare A.json B.json")
    sweeps = _sweeps(sweep)
    if any(not 0 < one < float("inf") for one in budget):
        raise UsageError(f"--budget: expected milliseconds above 0, got {min(budget)}")
    inputs = open_inputs(
        recording, bundle, region=region, threads=threads, looks=looks, on=on, window_s=window_s, command="bench"
    )
    require_file_place(json, option="--json")
    require_file_place(report, option="--report")
    document, windows = _measured(inputs, recording, bundle, budget=budget, window_s=window_s, quiet=quiet)
    document["sweeps"] = _swept(inputs, bundle, sweeps, on=on, quiet=quiet)
    if json is not None:
        write_json(json, document)
    if report is not None:
        with text_output(report) as file:
            file.write(bench_page(document, windows))
    sys.stdout.write(readable(document))
    return 0


def _sweeps(given: Sequence[str]) -> list[Sweep]:
    try:
        return [sweep_from(text) for text in given]
    except ValueError as error:
        raise UsageError(f"--sweep: {error}") from error


def _measured(
    inputs: Inputs[Source], recording: str, bundle: Path, *, budget: Sequence[float], window_s: float, quiet: bool
) -> tuple[dict[str, Any], list[Window]]:
    load_before = load_average()
    with Progress("bench", len(inputs.source), quiet=quiet) as progress:
        windows = time_windows(inputs.network, inputs.source, max_looks=inputs.looks, on_frame=progress.advance)
    if not windows[0].timings:
        raise UsageError(f"{recording}: no frame has enough depth in its region to run the network; nothing to time")
    document = report(windows, threads=inputs.threads, budgets_ms=budget)
    try:
        cold = cold_start(
            bundle,
            inputs.source.path,
            threads=inputs.threads,
            looks=inputs.looks,
            window_s=window_s,
            region=inputs.region,
        )
    except RuntimeError as error:
        raise UsageError(str(error)) from error
    document |= {
        "recording": Path(recording).name,
        "recording_sha256": sha256_of(inputs.source.path),
        "region": inputs.region,
        "bundle": bundle.name,
        "bundle_sha256": sha256_of(bundle),
        "category": inputs.network.metadata.category.name,
        "parts": len(inputs.network.metadata.category.parts),
        "looks": inputs.looks,
        "frames": len(inputs.source),
        "left_out": sum(window.left_out for window in windows),
        "operators": {short_name(name): count for name, count in inputs.network.operators.items()},
        "cold_start": cold,
        "governor": governors(),
        "load": [load_before, load_average()],
        "commit": commit(),
    }
    return document, windows


def _swept(
    inputs: Inputs[Source], bundle: Path, sweeps: Sequence[Sweep], *, on: ProviderChoice, quiet: bool
) -> list[dict[str, Any]]:
    found = []
    for sweep in sweeps:
        with Progress(f"sweep of {sweep.varies}, value", len(sweep.values), quiet=quiet) as progress:
            steps = run_sweep(
                sweep,
                inputs.network,
                inputs.source,
                load=lambda threads: load_network(bundle, threads=threads, looks=inputs.looks, on=on)[0],
                max_looks=inputs.looks,
                on_step=progress.advance,
            )
        found.append({"varies": sweep.varies, "what": VARIES[sweep.varies], "steps": steps})
    return found


def _compared(one: Path, other: Path) -> int:
    documents = []
    for path in (one, other):
        try:
            document = json_text.loads(path.read_text(encoding="utf-8"))
        except (UnicodeDecodeError, json_text.JSONDecodeError) as error:
            raise UsageError(f"--compare: {path}: expected JSON of page-runtime bench, got {error}") from error
        if not isinstance(document, dict):
            raise UsageError(f"--compare: {path}: expected JSON of page-runtime bench, got a list or a value")
        documents.append(document)
    try:
        found = compare(*documents)
    except NotComparable as error:
        raise UsageError(f"--compare: {one}, {other}: {error}") from error
    rows = [
        (
            change.name,
            number(change.one_ms, 2),
            number(change.other_ms, 2),
            f"{100 * (change.ratio - 1):+.1f}",
            "slower" if change.slower else "",
        )
        for change in found.changes
    ]
    verdict = {
        "no regression": f"no regression: nothing is more than {100 * TOLERANCE:.0f} % slower",
        "regression": "regression",
        "unstable": "no verdict: a run whose windows disagree proves nothing; measure again on a quiet machine",
    }[found.verdict]
    sys.stdout.write(f"{table(('ms', one.name, other.name, '%', ''), rows)}{verdict}\n")
    return 0 if found.verdict == "no regression" else EXIT_REGRESSION


def readable(document: dict[str, Any]) -> str:
    """The figures as tables for people."""
    percentiles = [f"p{p}" for p in PERCENTILES]
    rows = [
        (name, *(number(figures[f"{p}_ms"], 1) for p in percentiles), number(PAPER_MS.get(name), 0))
        for name, figures in (*document["stages"].items(), ("total", document["total"]))
    ]
    title = (
        f"{document['recording']}: {document['measurements']} estimates of {document['frames']} frames after "
        f"{document['warm_up']} of warm-up, bundle {document['bundle']}"
    )
    on = ", ".join(f"{name} ({count} operators)" for name, count in document["operators"].items())
    on = ", ".join(f"{name} ({count} operators)" for name, count in document["operators"].items())
    versions = ", ".join(f"{name} {value}" for name, value in document["versions"].items())
    governor = f", governor {', '.join(document['governor'])}" if document["governor"] else ""
    cold, jitter, energy = document["cold_start"], document["jitter"], document["energy"]
    return (
        f"{title}\n"
        f"{table(('ms', *percentiles, 'paper'), rows)}"
        f"{stability_line(document['stability'])}\n"
        f"jitter {number(jitter['std_ms'], 1)} ms standard deviation, {number(jitter['successive_ms'], 1)} ms from one "
        "estimate to the next\n"
        + "".join(
            f"{one['missed']} of {document['measurements']} took longer than {one['budget_ms']:g} ms\n"
            for one in document["deadlines"]
        )
        + f"{number(document['mean_looks'], 2)} looks a frame in the mean\n"
        f"a fresh process has its first pose after {number(cold['total_ms'], 0)} ms\n"
        f"peak resident memory {number(document['peak_rss_mb'], 0)} MB\n"
        + (f"{number(energy['per_estimate_j'], 2)} J an estimate, all of the package\n" if energy else "")
        + f"{document['threads']} threads, {document['cpu']}{governor}, load {number(document['load'][0], 1)} to "
        f"{number(document['load'][1], 1)}; the network runs on {on}\n"
        f"{versions}\n" + "".join(_sweep(sweep) for sweep in document["sweeps"])
    )


def stability_line(stability: dict[str, Any]) -> str:
    """Whether the figures may be believed, in a sentence."""
    medians = ", ".join(number(one, 1) for one in stability["windows_p50_ms"])
    word = "stable" if stability["stable"] else "UNSTABLE"
    return f"{word}: medians of {WINDOWS} windows {medians} ms, {100 * stability['spread']:.0f} % apart"


def _sweep(sweep: dict[str, Any]) -> str:
    rows = []
    for step in sweep["steps"]:
        errors = step["errors"] or {}
        translation = errors.get("translation_m")
        rows.append((
            f"{step['value']:g}",
            number(step["total"]["p50_ms"], 1),
            number(step["total"]["p95_ms"], 1),
            number(step["stages"]["scoring"]["p50_ms"], 1),
            number(errors.get("rotation_deg"), 2),
            number(None if translation is None else 1e3 * translation, 1),
            "" if step["stability"]["stable"] else "unstable",
        ))  # fmt: skip
    return "\n" + table((sweep["what"], "p50, ms", "p95", "scoring", "rot deg", "trans mm", ""), rows)
