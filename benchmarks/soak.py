"""The live loop's mechanics for a long time: a camera's pace against a consumer that is too slow for it.

    python benchmarks/soak.py [--frames 10000] [--period-ms 33.3] [--busy-ms 160] [--json FILE]

The follower sleeps instead of estimating: what is measured is the loop, not the network. The default takes six minutes;
the growth of memory an hour and the drift of latency mean something only at that length, on a machine that does nothing
else. `held` says which of the loop's promises it kept, and the exit code is 1 if one was not.

The age of a result is at most one period and the processing time, both as they really were: the period from its frame
to the next one, which the machine's load may stretch, and the time from when the frame was taken. What is left over is
how long after the next frame was stored it was taken, which must be less than what handing over between threads takes.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from page_runtime.commands.outputs import require_file_place, write_json
from page_runtime.commands.terminal import Progress
from page_runtime.commands.usage import UsageError
from page_runtime.live.loop import LiveLoop
from page_runtime.machine import cpu_name, versions

if TYPE_CHECKING:
    from benchmarks.paced import Idle, PacedSource

ROOT = Path(__file__).resolve().parents[1]
EXIT_BAD_INPUT = 2
EXIT_NOT_HELD = 1
SIZE = (640, 480)
# Python hands over between threads every 5 ms.
HAND_OVER_S = 5e-3
MOST_DRIFT = 0.1
MOST_MB_AN_HOUR = 1.0


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 all held, 1 not, 2 bad input."""
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
    return 0 if all(document["held"].values()) else EXIT_NOT_HELD


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
            # After the last frame none comes for which it would make room: it waits for as long as it has to.
            latency_ms = result.latency_ms if result.frame.index < frames - 1 else np.nan
            samples[count] = now_s, rss, process.num_fds(), threading.active_count(), latency_ms
            count += 1
            # With its last frame the source ends, and the thread that captures with it.
            running = count if counts.received < frames else running
            while progress.done < counts.received:
                progress.advance()
    quarter, rows = max(1, count // 4), samples[:count]
    first, last = (float(np.nanpercentile(part[:, 4], 99)) for part in (rows[:quarter], rows[-quarter:]))
    # The interpreter and the allocators settle in the first quarter.
    rows = rows[quarter:]
    slope = float(np.polyfit(rows[:, 0], rows[:, 1], 1)[0]) * 3600 / 1e6
    over_s = bound_excess_s(source, follower)
    descriptors = sorted({int(value) for value in rows[:, 2]})
    threads = sorted({int(value) for value in samples[quarter:running, 3]})
    end = loop.counts
    return {
        "frames": frames,
        "period_ms": round(1e3 * period_s, 2),
        "busy_ms": round(1e3 * busy_s, 2),
        "sent": source.sent,
        "received": end.received,
        "processed": end.processed,
        "dropped": end.dropped,
        "waiting": end.waiting,
        "period_between_frames_ms": _spread_ms(np.diff(source.sent_s)),
        "processing_ms": _spread_ms(follower.done_s - follower.taken_s),
        "age_of_result_ms": _spread_ms((follower.done_s - source.sent_s)[:-1]),
        "age_beyond_period_and_processing_ms": round(1e3 * over_s, 3),
        "p99_latency_first_quarter_ms": round(first, 2),
        "p99_latency_last_quarter_ms": round(last, 2),
        "rss_mb": round(float(rows[-1, 1]) / 1e6, 2),
        "rss_slope_mb_an_hour": round(slope, 3),
        "descriptors": descriptors,
        "threads": threads,
        "held": {
            "sent = processed + dropped": source.sent == end.received == end.processed + end.dropped,
            "age <= period + processing": over_s <= HAND_OVER_S,
            "p99 of the last quarter within 10 % of the first": abs(last / first - 1.0) <= MOST_DRIFT,
            "memory <= 1 MB an hour": slope <= MOST_MB_AN_HOUR,
            "descriptors and threads constant": len(descriptors) == 1 and len(threads) == 1,
        },
        "cpu": cpu_name(),
        "versions": versions(),
    }


def bound_excess_s(source: PacedSource, follower: Idle) -> float:
    """By how much the age of a result was at most beyond the time to the next frame and its own processing; negative
    where every frame was taken before the next one was stored."""
    age_s = follower.done_s - source.sent_s
    period_s = source.stored_s[1:] - source.sent_s[:-1]
    over_s = age_s[:-1] - (period_s + (follower.done_s - follower.taken_s)[:-1])
    return float(np.nanmax(over_s)) if np.isfinite(over_s).any() else float("-inf")


def _spread_ms(values_s: NDArray[np.floating]) -> dict[str, float]:
    p50, p99, most = np.nanpercentile(1e3 * values_s, [50, 99, 100]).tolist()
    return {"p50": round(p50, 2), "p99": round(p99, 2), "most": round(most, 2)}


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.soak` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
