"""Latency against K parts, N points and the size S of the network's picture, beside the paper's 160 ms.

    python benchmarks/latency_sweeps.py [--quick] [--threads T]

K: every category with a bundle as it is shipped, and for three and seven parts, where there is none, a network of
untrained weights whose answers are replaced by the truth, as wrong as trained networks are (`known_answers`); one of a
shipped category beside tells how near that is. N and S: bundles of the weights kept for the laptops' one, exported for
other N and S than they were trained with, so their errors beside are upper bounds. One look at each of some procedural
frames of the validation split, which are made first. Interrupt it at any time, the same command goes on. Writes
benchmarks/results/sweeps.json, .md and plots. Needs the extra export.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "benchmarks" / "results"
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 done, 2 bad input, 130 interrupted."""
    parser = argparse.ArgumentParser(prog="latency_sweeps.py", description="Latency against K, N and S.")
    parser.add_argument("--threads", type=int, default=2, help="of the network (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="few frames and settings, to see that it runs")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the results")
    options = parser.parse_args(arguments)
    try:
        _run(options)
    except ImportError as error:
        print(f"latency_sweeps: {error}; it needs the extra: pip install 'page-edge[export]'", file=sys.stderr)
        return EXIT_BAD_INPUT
    except (ValueError, OSError) as error:
        print(f"latency_sweeps: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("latency_sweeps: interrupted; the same command goes on from here", file=sys.stderr)
        return EXIT_INTERRUPTED
    return 0


def _run(options: argparse.Namespace) -> None:
    from benchmarks.sweep_steps import measured
    from benchmarks.sweep_tables import markdown, plots

    document = measured(options.out / "tables", threads=options.threads, quick=options.quick)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "sweeps.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    (options.out / "sweeps.md").write_text(markdown(document), encoding="utf-8")
    for name, svg in plots(document).items():
        (options.out / name).write_text(svg, encoding="utf-8")
    sys.stdout.write(markdown(document))


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.latency_sweeps` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
