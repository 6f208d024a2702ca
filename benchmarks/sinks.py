"""What it costs to give a result to each sink: processor time of the whole process, and bytes.

    python benchmarks/sinks.py [RECORDING] [--bundle B] [--results N] [--sink NAME ...] [--json FILE]

The results are a bundle's on the frames of a recording, over and over. Each sink is written to directly, with nothing
else running in the process; threads of its own (Rerun's, the web server's) count. Needs the extras ros and view.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from page_runtime import Network, estimate, open_source
from page_runtime.bundle_fields import BundleError
from page_runtime.commands.outputs import require_file_place, write_json
from page_runtime.commands.terminal import number, table
from page_runtime.commands.usage import UsageError
from page_runtime.image_files import SourceError
from page_runtime.live.result import LiveObject, LiveResult, LoopCounts
from page_runtime.machine import cpu_name, versions
from page_runtime.sinks.json_lines import UdpSink, line_file
from page_runtime.sinks.mcap import McapSink
from page_runtime.sinks.rerun_log import RrdSink
from page_runtime.sinks.sink import Sink
from page_runtime.sinks.video import VideoSink
from page_runtime.sinks.web import WebSink

ROOT = Path(__file__).resolve().parents[1]
EXIT_BAD_INPUT = 2
WARM_UP = 5
PACKAGES = ("page-edge", "numpy", "opencv-python-headless", "mcap", "rosbags", "rerun-sdk")
SINKS: dict[str, Callable[[Path], Sink]] = {
    "lines": line_file,
    "udp": lambda _: UdpSink("127.0.0.1", 9),
    "mcap": McapSink,
    "rrd": RrdSink,
    "web": lambda _: WebSink(0),
    "video": lambda path: VideoSink(path.with_suffix(".mkv")),
}


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(prog="sinks.py", description="What it costs to give a result to each sink.")
    parser.add_argument("recording", nargs="?", type=Path, default=ROOT / "tests/data/laptop")
    parser.add_argument("--bundle", type=Path, default=ROOT / "runtime/bundles/laptop.onnx")
    parser.add_argument("--results", type=int, default=100, metavar="N", help="for each sink (default: 100)")
    parser.add_argument("--sink", nargs="+", choices=tuple(SINKS), default=tuple(SINKS), help="(default: all)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    try:
        require_file_place(options.json, option="--json")
        document = _measured(options)
    except (BundleError, SourceError, UsageError, OSError) as error:
        print(f"sinks: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    if options.json is not None:
        write_json(options.json, document)
    rows = [
        (
            name,
            number(figures["cpu_p50_ms"], 1),
            number(figures["cpu_p95_ms"], 1),
            number(figures["kb_a_result"], 0),
            number(figures["rss_growth_kb_a_result"], 2),
        )
        for name, figures in document["sinks"].items()
    ]
    print(table(("sink", "cpu p50 ms", "cpu p95 ms", "kB", "memory kB"), rows), end="")
    return 0


def _measured(options: argparse.Namespace) -> dict[str, Any]:
    cv2.setNumThreads(1)
    results = _results(options.recording, options.bundle)
    document: dict[str, Any] = {"recording": options.recording.name, "results": options.results, "sinks": {}}
    with tempfile.TemporaryDirectory() as folder:
        for name, make in ((name, SINKS[name]) for name in options.sink):
            print(f"sinks: {name}", file=sys.stderr)
            path = Path(folder) / name
            document["sinks"][name] = _cost(make(path), results, options.results)
            written = sum(file.stat().st_size for file in Path(folder).glob(f"{name}*"))
            document["sinks"][name]["kb_a_result"] = round(written / (options.results + WARM_UP) / 1e3, 1)
    return document | {"cpu": cpu_name(), "versions": versions(PACKAGES)}


def _results(recording: Path, bundle: Path) -> list[LiveResult]:
    network, found = Network(bundle, threads=1), []
    for recorded in open_source(recording):
        regions = [instance.region for instance in recorded.instances if instance.region is not None]
        objects = tuple(
            LiveObject(n, region, estimate(network, recorded.frame, region, max_looks=1), False)
            for n, region in enumerate(regions)
        )
        found.append(LiveResult(recorded.frame, objects, "tracking", LoopCounts(), 0.0))
    return found


def _cost(sink: Sink, results: list[LiveResult], count: int) -> dict[str, float]:
    """rss_growth_kb_a_result: of the process, over the last three quarters of the results; of some hundred it says
    nothing, as buffers and allocators are still settling."""
    import psutil

    process, spent_ms, quarter = psutil.Process(), [], WARM_UP + count // 4
    settled = process.memory_info().rss
    for i in range(count + WARM_UP):
        result = results[i % len(results)]
        result = replace(result, frame=replace(result.frame, index=i, timestamp_s=i / 30))
        begin = time.process_time()
        sink.write(result)
        spent_ms.append((time.process_time() - begin) * 1e3)
        if i == quarter:
            settled = process.memory_info().rss
    growth = (process.memory_info().rss - settled) / 1e3 / max(1, count + WARM_UP - quarter)
    sink.close()
    timed = spent_ms[WARM_UP:]
    spent = {f"cpu_p{p}_ms": round(float(np.percentile(timed, p)), 3) for p in (50, 95)}
    return spent | {"rss_growth_kb_a_result": round(growth, 3)}


if __name__ == "__main__":
    sys.exit(main())
