"""The paper's tables with our rows beside its own, as Markdown, CSV and plots.

    make tables      or      python benchmarks/paper_tables.py [--recording CATEGORY=PATH ...] [--quick] [--readme]

Ours come from the shipped bundles on the procedural test split, which is made first where there is none, or on
recordings of yours: ArtImage, ReArtMix or RobotArm where you have them. The same metrics, other data: the two stand
side by side and prove nothing about each other. With --readme, as make tables has it, the README's figures follow.
Interrupt it at any time, the same command goes on. Needs the extra export.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
OUT = RESULTS / "tables"
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 done, 2 bad input, 130 interrupted."""
    parser = argparse.ArgumentParser(prog="paper_tables.py", description="The paper's tables, ours beside its own.")
    parser.add_argument("--recording", metavar="CATEGORY=PATH", action="append", default=[], help="with true poses")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the tables and of what is kept")
    parser.add_argument("--processes", type=int, default=1, help="of a validation (default: 1)")
    parser.add_argument("--quick", action="store_true", help="20 frames a category, to see that it runs")
    parser.add_argument("--readme", action="store_true", help="keep what the README tells, and write its figures")
    options = parser.parse_args(arguments)
    if options.readme and (options.quick or options.recording):
        parser.error("--readme: it tells of the whole test split; leave --quick and --recording out")
    try:
        return _run(options)
    except ImportError as error:
        print(f"tables: {error}; it needs the extra: pip install 'page-edge[export]'", file=sys.stderr)
        return EXIT_BAD_INPUT
    except (ValueError, OSError) as error:
        print(f"tables: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("tables: interrupted; the same command goes on from here", file=sys.stderr)
        return EXIT_INTERRUPTED


def _run(options: argparse.Namespace) -> int:
    from benchmarks import latency_sweeps
    from benchmarks.table_rows import figures_from, markdown, plots_from
    from benchmarks.table_steps import chosen, results_of

    measured = chosen(options.recording, quick=options.quick)
    results = results_of(measured, options.out, processes=options.processes)
    figures = figures_from(results)
    write_tables(options.out, figures, markdown(figures, results), plots_from(figures))
    if options.readme:
        # Times of other numbers of parts and points, kept step by step like the rest.
        if latency_sweeps.main([]) != 0:
            return EXIT_BAD_INPUT
        keep_for_readme(results)
    print(options.out / "tables.md")
    return 0


def keep_for_readme(results: dict[str, Any], folder: Path = RESULTS) -> None:
    """The validations' and timings' figures as the small files that the README is written from."""
    from benchmarks.kept_accuracy import keep
    from benchmarks.readme_figures import write_readme

    for one in results["validations"]:
        keep(f"{one['category']}-{one['kind']}", one["document"], one["data"], folder / "accuracy")
    for one in results["latencies"]:
        text = json.dumps(one["document"], indent=1) + "\n"
        (folder / f"latency-{one['category']}.json").write_text(text, encoding="utf-8")
    if folder == RESULTS:
        write_readme()


def write_tables(folder: Path, figures: list[Any], text: str, plots: dict[str, str]) -> None:
    """tables.md, tables.csv and the plots."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "tables.md").write_text(text, encoding="utf-8")
    with (folder / "tables.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("table", "category", "row", "source", "data", "part", "metric", "value", "low", "high"))
        for one in figures:
            writer.writerow([*one[:-3], *("" if value is None else f"{value:.6g}" for value in one[-3:])])
    for name, svg in plots.items():
        (folder / name).write_text(svg, encoding="utf-8")


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.paper_tables` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
