"""page-runtime doctor: whether this computer, its cameras and a recording are fit for a loop, and what to change."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

import page_runtime
from page_runtime import findings
from page_runtime.capture.frame_service import DeviceUnavailable
from page_runtime.capture.layouts import WINDOW_S
from page_runtime.capture.oak import connected_devices
from page_runtime.commands.inputs import load_network, require_fitting
from page_runtime.commands.sources import open_recorded
from page_runtime.estimator import estimate
from page_runtime.findings import Finding
from page_runtime.image_files import SourceError
from page_runtime.machine import available_processors
from page_runtime.network import Network
from page_runtime.recorded import RecordedFrame, Source

EXIT_PROBLEM = 1
WARM_UP = 3
WANDERING = 2.0
SLOW_HZ = 10.0
MARKS = {"ok": "ok     ", "advice": "advice ", "problem": "PROBLEM"}


def doctor(recording: str | None, *, bundle: Path | None, seconds: float, as_json: bool) -> int:
    """Write the findings to standard output; returns 1 when one of them is a problem, else 0."""
    source = None if recording is None else open_recorded(recording, window_s=WINDOW_S, command="doctor")
    chosen = bundle or shipped_bundle(None if source is None else source.category)
    network = None if chosen is None else load_network(chosen, threads=0, looks=1)[0]
    if bundle is not None and network is not None and source is not None and recording is not None:
        require_fitting(bundle, network, recording, source)
    found = [*findings.check_software(), *findings.check_processor(), findings.check_memory(), *_devices()]
    frames = [] if source is None else findings.some_frames(source)
    if source is not None:
        found += findings.check_recording(source, frames, None if network is None else network.metadata)
    figures: dict[str, Any] = {}
    if network is None:
        found.append(Finding("speed", "ok", "not measured: no bundle is shipped with this installation", "--bundle B"))
    else:
        figures = measure(network, source, frames, seconds)
        found += speed_findings(figures)
    sys.stdout.write(_as_json(found, figures) if as_json else readable(found))
    return EXIT_PROBLEM if any(finding.level == "problem" for finding in found) else 0


def shipped_bundle(category: str | None) -> Path | None:
    """The bundle of that category beside the package, or any; None where there is none, as in a wheel."""
    folder = Path(page_runtime.__file__).parents[1] / "bundles"
    bundles = sorted(folder.glob("*.onnx"))
    return next((path for path in bundles if path.stem == category), bundles[0] if bundles and not category else None)


def _devices() -> Iterator[Finding]:
    try:
        devices = connected_devices()
    except DeviceUnavailable as error:
        yield Finding("cameras", "problem", str(error), "page-runtime devices")
        return
    except SourceError as error:
        yield Finding("cameras", "ok", "not looked for", str(error))
        return
    if devices:
        yield Finding("cameras", "ok", ", ".join(f"oak:{d.device_id} ({d.name}, {d.state})" for d in devices))
    else:
        yield Finding("cameras", "ok", "no OAK camera found", "page-runtime devices says what to check")


def measure(network: Network, source: Source | None, frames: Sequence[RecordedFrame], seconds: float) -> dict[str, Any]:
    """Milliseconds of an estimate, or of the network alone where no frame says where an object is, with all threads and
    with one, each for half of the `seconds`."""
    known = [(recorded.frame, i.region) for recorded in frames for i in recorded.instances if i.region is not None]
    work = _estimates(known) if known and source is not None else _forward_pass
    threads = available_processors()
    counts = (threads, 1) if threads > 1 else (threads,)
    runs = []
    for count in counts:
        timed_ms = _timed(work(Network(network.path, threads=count)), seconds / len(counts))
        p50, p95 = np.percentile(timed_ms, (50, 95))
        runs.append({"threads": count, "p50_ms": float(p50), "p95_ms": float(p95), "measurements": len(timed_ms)})
    return {"what": "estimate" if known else "network alone", "bundle": network.path.name, "runs": runs}


def _estimates(known: Sequence[tuple[Any, Any]]) -> Callable[[Network], Callable[[int], object]]:
    def work(network: Network) -> Callable[[int], object]:
        return lambda i: estimate(network, *known[i % len(known)], max_looks=1)

    return work


def _forward_pass(network: Network) -> Callable[[int], object]:
    """A forward pass takes the same time whatever is in the picture."""
    return lambda _: network.warm_up(1)


def _timed(call: Callable[[int], object], seconds: float) -> list[float]:
    for i in range(WARM_UP):
        call(i)
    timed_ms: list[float] = []
    end = perf_counter() + seconds
    while perf_counter() < end or not timed_ms:
        begin = perf_counter()
        call(len(timed_ms))
        timed_ms.append((perf_counter() - begin) * 1e3)
    return timed_ms


def speed_findings(figures: dict[str, Any]) -> Iterator[Finding]:
    """What the times mean."""
    runs = figures["runs"]
    for run in runs:
        rate_hz = 1e3 / run["p50_ms"]
        what = (
            f"{figures['what']}, {figures['bundle']}, {run['threads']} thread{'s' * (run['threads'] > 1)}: "
            f"{run['p50_ms']:.0f} ms in the median, {run['p95_ms']:.0f} at p95: {rate_hz:.0f} a second"
        )
        advice = ""
        if run is runs[0] and rate_hz < SLOW_HZ:
            advice = "--looks 1, --track, fewer objects; or a faster computer"
        elif run["p95_ms"] > WANDERING * run["p50_ms"]:
            advice = "times wander: something else runs on these cores"
        yield Finding("speed", "advice" if advice else "ok", what, advice)
    if len(runs) == 2 and runs[1]["p50_ms"] <= runs[0]["p50_ms"]:
        what = f"{runs[0]['threads']} threads are no faster than one"
        yield Finding("threads", "advice", what, "--threads 1 leaves the other cores to the rest of the robot")


def _as_json(found: Sequence[Finding], figures: dict[str, Any]) -> str:
    return json.dumps({"findings": [asdict(finding) for finding in found], "speed": figures or None}) + "\n"


def readable(found: Sequence[Finding]) -> str:
    """The findings as lines, what to do below each, and how many there are."""
    width = max(len(finding.topic) for finding in found)
    lines = []
    for finding in found:
        lines.append(f"{MARKS[finding.level]}  {finding.topic.ljust(width)}  {finding.what}")
        if finding.advice:
            lines.append(f"{' ' * 9}{' ' * width}  -> {finding.advice}")
    problems, advice = (sum(finding.level == level for finding in found) for level in ("problem", "advice"))
    lines.append(f"{problems} problem{'s' * (problems != 1)}, {advice} to improve")
    return "\n".join(lines) + "\n"
