"""The live loop's mechanics for a long time: a camera's pace against a consumer that is too slow for it.

    python benchmarks/soak.py [--frames 10000] [--period-ms 33.3] [--busy-ms 160] [--json FILE]

The follower sleeps instead of estimating: what is measured is the loop, not the network. The default takes six minutes.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.commands.outputs import require_file_place, write_json
from page_runtime.commands.terminal import Progress
from page_runtime.commands.usage import UsageError
from page_runtime.live.loop import LiveLoop
from page_runtime.machine import cpu_name, versions

ROOT = Path(__file__).resolve().parents[1]
EXIT_BAD_INPUT = 2
SIZE = (640, 480)


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(prog="soak.py", description="The live loop for a long time.")
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--period-ms", type=float, default=100 / 3)
    parser.add_argument("--busy-ms", type=float, default=160.0)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    try:
        require_file_place(options.json, option="--json")
        document = soaked(options.frames, 1e-3 * options.period_ms, 1e-3 * options.busy_ms)
        if options.json is not None:
            write_json(options.json, document)
    except (UsageError, ValueError, OSError) as error:
        print(f"soak: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    sys.stdout.write("".join(f"{name}: {value}\n" for name, value in document.items()))
    return 0


def soaked(frames: int, period_s: float, busy_s: float, *, quiet: bool = False) -> dict[str, Any]:
    """Run the loop over so many frames; what became of them, and of the process."""
    import psutil
    from benchmarks.paced import Idle, PacedSource

    process = psutil.Process()
    source, follower = PacedSource(frames, period_s, size=SIZE), Idle(busy_s, frames=frames)
    # Seconds, bytes, descriptors, threads, ms; filled from the start, or they would be what grows.
    samples, count, running = np.full((frames, 5), np.nan), 0, 0
    began_s = time.monotonic()
    with LiveLoop(source, follower) as loop, Progress("soak", frames, quiet=quiet) as progress:
        for result in loop:
            counts = result.counts
            if counts.received != counts.processed + counts.dropped + counts.waiting:
                raise ValueError(f"counters: expected received = processed + dropped + waiting, got {counts}")
            now_s, rss = time.monotonic() - began_s, process.memory_info().rss
            samples[count] = now_s, rss, process.num_fds(), threading.active_count(), result.latency_ms
            count += 1
            # With its last frame the source ends, and the thread that captures with it.
            running = count if counts.received < frames else running
            while progress.done < counts.received:
                progress.advance()
    ages_s = follower.taken_s - source.sent_s
    quarter, rows = max(1, count // 4), samples[:count]
    first, last = (float(np.percentile(part[:, 4], 99)) for part in (rows[:quarter], rows[-quarter:]))
    # The interpreter and the allocators settle in the first quarter.
    rows = rows[quarter:]
    slope = float(np.polyfit(rows[:, 0], rows[:, 1], 1)[0]) * 3600 / 1e6
    return {
        "frames": frames,
        "period_ms": round(1e3 * period_s, 2),
        "busy_ms": round(1e3 * busy_s, 2),
        "sent": source.sent,
        "received": loop.counts.received,
        "processed": loop.counts.processed,
        "dropped": loop.counts.dropped,
        "waiting": loop.counts.waiting,
        "most_age_when_taken_ms": round(1e3 * float(np.nanmax(ages_s)), 2),
        "p99_latency_first_quarter_ms": round(first, 2),
        "p99_latency_last_quarter_ms": round(last, 2),
        "rss_mb": round(float(rows[-1, 1]) / 1e6, 2),
        "rss_slope_mb_an_hour": round(slope, 3),
        "descriptors": sorted({int(value) for value in rows[:, 2]}),
        "threads": sorted({int(value) for value in samples[quarter:running, 3]}),
        "cpu": cpu_name(),
        "versions": versions(),
    }


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.soak` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
