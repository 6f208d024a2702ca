"""What `page-runtime bench` takes. Imports nothing heavy: it is loaded before numpy."""

from __future__ import annotations

import argparse
from pathlib import Path

from page_runtime.commands import argument_types as accept


def add_bench_options(parser: argparse.ArgumentParser) -> None:
    """All but what several commands share."""
    parser.add_argument("recording", metavar="RECORDING", nargs="?", help="a folder or file of RGB-D frames")
    region_help = "where the object is in every frame, px; default: where the recording says"
    parser.add_argument("--region", metavar="X,Y,W,H", type=accept.region, help=region_help)
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the figures here")
    parser.add_argument("--report", metavar="FILE", type=Path, help="write a page here, .html, with all in it")
    budget_help = "count estimates that take longer than so many milliseconds, beside the paper's 160"
    parser.add_argument("--budget", metavar="MS", type=float, action="append", default=[], help=budget_help)
    sweep_help = "then vary threads, rho (mm), looks, voters or size (share): rho=3,5,10; may be given again"
    parser.add_argument("--sweep", metavar="NAME=VALUES", action="append", default=[], help=sweep_help)
    compare_help = "say whether B, figures of an earlier --json, is slower than A; exit code 1 when it is, or may be"
    parser.add_argument("--compare", metavar=("A.json", "B.json"), type=Path, nargs=2, help=compare_help)
