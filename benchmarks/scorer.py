"""How fast and how exact the scorer is, beside accumulators that visit every voxel, on synthetic parts.

    python benchmarks/scorer.py --quick --json FILE     under a minute
    python benchmarks/scorer.py [--out DIR]             the full sweep: JSON and plots; goes on where it was interrupted

Needs numba for the compiled peers, which are left out without it, and matplotlib for the plots.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn

from page_runtime.commands.usage import UsageError

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "benchmarks" / "results" / "scorer"
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


class _Parser(argparse.ArgumentParser):
    """Reports errors as main() does: one sentence, without the usage text before it."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see --help")


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; returns the exit code: 0 done, 2 bad arguments, 130 interrupted."""
    try:
        options = _parser().parse_args(arguments)
        if options.quick and (options.out is not None or options.fresh):
            raise UsageError("--quick keeps nothing between runs and draws no plots: leave out --out and --fresh")
        _prepare()
        _run(options)
    except (UsageError, OSError) as error:
        sys.stderr.write(f"scorer: {' '.join(str(error).split())}\n")
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        sys.stderr.write("scorer: interrupted; a full sweep goes on from here when it is started again\n")
        return EXIT_INTERRUPTED
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="scorer.py", description="Time and errors of the scorer on synthetic parts.")
    parser.add_argument("--quick", action="store_true", help="the standard settings only, no plots")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the figures here (default: DIR/scorer.json)")
    parser.add_argument("--out", metavar="DIR", type=Path, help=f"folder of the full sweep (default: {_short(OUT)})")
    parser.add_argument("--fresh", action="store_true", help="measure again what an interrupted sweep left")
    return parser


def _short(path: Path) -> Path:
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def _prepare() -> None:
    """One thread, set before numpy's BLAS is loaded: the accumulators compared are single-threaded, as the runtime's
    scorer is."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"


def _run(options: argparse.Namespace) -> None:
    from page_runtime.commands.outputs import require_file_place, require_folder_place, write_json

    require_file_place(options.json, option="--json")
    out: Path = options.out or OUT
    if not options.quick:
        require_folder_place(out, option="--out")

    from benchmarks.report import Cache, document_from, fingerprint, machine
    from benchmarks.steps import full_steps, quick_steps
    from benchmarks.tables import readable

    steps = quick_steps() if options.quick else full_steps()
    measured_on = machine()
    cache = None if options.quick else Cache(out / "steps", measured_on["fingerprint"])
    results = {}
    with _progress(len(steps)) as advance:
        for step in steps:
            result = None if cache is None or options.fresh else cache.load(step.name)
            advance(step.name)
            if result is None:
                result = step.work()
                if cache is not None:
                    cache.keep(step.name, result)
            results[step.name] = result
    if fingerprint() != measured_on["fingerprint"]:
        sys.stderr.write("scorer: the sources changed meanwhile; the figures are of those at the start\n")
    document = document_from(steps, results, measured_on, quick=options.quick)
    if options.json is not None:
        write_json(options.json, document)
    elif not options.quick:
        write_json(out / "scorer.json", document)
    sys.stdout.write(readable(document))
    if not options.quick:
        _draw(document, out)


def _draw(document: dict, out: Path) -> None:
    try:
        from benchmarks.plots import draw
    except ImportError as error:
        sys.stderr.write(f"scorer: no plots: {error}; `pip install matplotlib`, and run again\n")
        return
    for path in draw(document, out):
        sys.stdout.write(f"{_short(path)}\n")


@contextmanager
def _progress(total: int) -> Iterator[Callable[[str], None]]:
    """Told the name of each step that begins: a bar on a terminal that has rich, a line for each elsewhere."""
    if not sys.stderr.isatty() or find_spec("rich") is None:
        count = itertools.count(1)
        yield lambda name: print(f"scorer: {next(count)} of {total}: {name}", file=sys.stderr, flush=True)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("", total=total, completed=-1)
        yield lambda name: progress.update(task, advance=1, description=name)
        progress.update(task, completed=total, description="")


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.scorer` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
