"""How long a fresh process takes to its first pose, stage by stage; run as `python -m page_runtime.cold_start`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from page_runtime.sampling import Region

REPEATS = 3
_TIMEOUT_S = 300


def cold_start(
    bundle: Path, recording: Path, *, threads: int, looks: int, window_s: float, region: Region | None = None
) -> dict[str, Any]:
    """Medians of REPEATS fresh processes, ms: start of the interpreter, imports, loading the bundle, opening the
    recording with its first frame, first estimate, on the CPU; and total, from the call to the end of that estimate.

    region: of the object where the recording does not say. Files are in the system's cache after the first.
    RuntimeError when a process fails.
    """
    command = [sys.executable, "-m", "page_runtime.cold_start", str(bundle), str(recording), str(threads)]
    command += [str(looks), str(window_s), json.dumps(region)]
    found: list[dict[str, float]] = []
    for _ in range(REPEATS):
        begin = perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
        total_ms = (perf_counter() - begin) * 1e3
        if done.returncode != 0:
            raise RuntimeError(f"cold start: the process ended with {done.returncode}: {done.stderr.strip()[-500:]}")
        stages = json.loads(done.stdout)
        found.append({"interpreter_ms": total_ms - sum(stages.values()), **stages, "total_ms": total_ms})
    return {name: round(median(one[name] for one in found), 1) for name in found[0]} | {"repeats": REPEATS}


def _main(bundle: str, recording: str, threads: str, looks: str, window_s: str, given: str) -> dict[str, float]:
    """The stages of this process, ms. Modules are imported here: that they take time is what is measured."""
    marks = [perf_counter()]
    from page_runtime.capture.playback import open_source
    from page_runtime.estimator import estimate
    from page_runtime.network import Network

    marks.append(perf_counter())
    network = Network(bundle, threads=int(threads))
    marks.append(perf_counter())
    first = next(
        (recorded.frame, region)
        for recorded in open_source(recording, window_s=float(window_s))
        for region in [json.loads(given)] + [instance.region for instance in recorded.instances]
        if region is not None
    )
    marks.append(perf_counter())
    estimate(network, first[0], first[1], max_looks=int(looks))
    marks.append(perf_counter())
    names = ("import_ms", "bundle_ms", "first_frame_ms", "first_estimate_ms")
    return {name: (b - a) * 1e3 for name, a, b in zip(names, marks, marks[1:], strict=False)}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_main(*sys.argv[1:7])))
