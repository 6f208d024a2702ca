"""From the start of a process to its first pose: time, resident memory, and what it is spent on.

python benchmarks/startup.py BUNDLE RECORDING [--json FILE]
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

from page_runtime.machine import cpu_name, versions

STAGES = ("whole", "imports", "load", "read", "first_pose")
CHILD = """
import os, sys, time
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
begin = time.perf_counter()
from page_runtime import Network, estimate, open_source
from page_runtime.bench import peak_rss_mb
imported = time.perf_counter()
network = Network(sys.argv[1], threads=int(sys.argv[3]))
loaded = time.perf_counter()
recorded = open_source(sys.argv[2]).entries[0].read()
read = time.perf_counter()
estimate(network, recorded.frame, recorded.instances[0].region, max_looks=1)
print(imported - begin, loaded - imported, read - loaded, time.perf_counter() - read, peak_rss_mb())
"""


def main() -> None:
    """Start the child so many times and print the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--starts", type=int, default=9)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    for _ in range(options.starts):
        given = [sys.executable, "-c", CHILD, str(options.bundle), str(options.recording), str(options.threads)]
        begin = time.perf_counter()
        done = subprocess.run(given, capture_output=True, text=True, check=True)
        rows.append([time.perf_counter() - begin, *map(float, done.stdout.split())])
    columns = list(zip(*rows, strict=True))
    figures = {
        f"{name}_ms": {"median": 1e3 * statistics.median(values), "max": 1e3 * max(values)}
        for name, values in zip(STAGES, columns, strict=False)
    }
    document = {
        "bundle": options.bundle.name,
        "starts": options.starts,
        "threads": options.threads,
        **figures,
        "peak_rss_mb": max(columns[-1]),
        "cpu": cpu_name(),
        "versions": versions(),
    }
    for name, values in figures.items():
        print(f"{name:14s} median {values['median']:6.0f}, most {values['max']:6.0f}")
    print(f"peak resident memory {document['peak_rss_mb']:.0f} MB")
    if options.json is not None:
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
