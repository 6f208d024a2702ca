"""What `page-runtime validate` takes. Imports nothing heavy: it is loaded before numpy."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_validate_options(parser: argparse.ArgumentParser, overlay_help: str) -> None:
    """All but what several commands share."""
    parser.add_argument("recordings", metavar="RECORDING", nargs="+", help="a folder or file with true poses")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the figures here")
    parser.add_argument("--report", metavar="FILE", type=Path, help="write a page here, .html, with all in it")
    parser.add_argument("--overlay", metavar="DIR", type=Path, help=f"{overlay_help}, and the true boxes")
    results_help = "keep results here as they come, and go on from those of an earlier, interrupted call"
    parser.add_argument("--results", metavar="DIR", type=Path, help=results_help)
    parser.add_argument("--processes", metavar="N", type=int, default=1, help="so many at once (default: 1)")
    cluster_help = "share the work with the workers of this Dask scheduler, which see the same paths"
    parser.add_argument("--cluster", metavar="ADDRESS", help=cluster_help)
    symmetry_help = "count errors by no symmetry, or PART=AXIS:FOLD (lid=z:2, hand=z:any); default: the bundle's"
    parser.add_argument("--symmetry", metavar="S", action="append", default=[], help=symmetry_help)
    paper_help = "a second table, counted as the paper counts: angles folded and capped"
    parser.add_argument("--paper", action="store_true", help=paper_help)
    parser.add_argument("--seed", metavar="N", type=int, default=0, help="of the intervals' bootstrap (default: 0)")
