"""page-runtime bench: the time of every stage beside the paper's."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from page_runtime.bench import PAPER_MS, PERCENTILES, report, time_estimates
from page_runtime.commands.inputs import open_inputs
from page_runtime.commands.outputs import require_file_place, write_json
from page_runtime.commands.terminal import Progress, number, table
from page_runtime.commands.usage import UsageError
from page_runtime.providers import ProviderChoice, short_name


def bench(
    recording: str,
    *,
    bundle: Path,
    json: Path | None,
    window_s: float,
    threads: int,
    on: ProviderChoice,
    looks: int,
    quiet: bool,
) -> None:
    """Time every frame of `recording`; write the figures to `json` and a table to standard output."""
    inputs = open_inputs(recording, bundle, threads=threads, looks=looks, on=on, window_s=window_s, command="bench")
    require_file_place(json, option="--json")
    with Progress("bench", len(inputs.source), quiet=quiet) as progress:
        timings, left_out = time_estimates(inputs.network, inputs.source, max_looks=looks, on_frame=progress.advance)
    if not timings:
        raise UsageError(f"{recording}: no frame has enough depth in its region to run the network; nothing to time")
    document = report(timings, threads=inputs.threads)
    document |= {
        "recording": Path(recording).name,
        "bundle": bundle.name,
        "frames": len(inputs.source),
        "left_out": left_out,
        "operators": {short_name(name): count for name, count in inputs.network.operators.items()},
    }
    if json is not None:
        write_json(json, document)
    sys.stdout.write(readable(document))


def readable(document: dict[str, Any]) -> str:
    """The figures as a table for people."""
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
    versions = ", ".join(f"{name} {value}" for name, value in document["versions"].items())
    return (
        f"{title}\n"
        f"{table(('ms', *percentiles, 'paper'), rows)}"
        f"{number(document['mean_looks'], 2)} looks a frame in the mean\n"
        f"peak resident memory {number(document['peak_rss_mb'], 0)} MB\n"
        f"{document['threads']} threads, {document['cpu']}; the network runs on {on}\n"
        f"{versions}\n"
    )
