"""What `page-runtime live` takes besides its sinks. Imports nothing heavy: it is loaded before numpy."""

from __future__ import annotations

import argparse
from pathlib import Path

from page_runtime.commands import argument_types as accept


def add_live_options(parser: argparse.ArgumentParser) -> None:
    """All but what several commands share."""
    where = parser.add_mutually_exclusive_group()
    where_help = (
        "where the one object is first seen, px, or auto: what stands out of table and walls (default: the source's "
        "own regions, else auto)"
    )
    where.add_argument("--region", metavar="X,Y,W,H", type=accept.region_or_auto, help=where_help)
    where.add_argument("--mask", metavar="DIR", type=Path, help="a picture for each frame, 000012.png, objects not 0")
    where.add_argument("--detector", metavar="FILE", type=Path, help="a detector or segmentation, .onnx of Ultralytics")
    classes_help = "names or numbers of --detector's classes"
    parser.add_argument("--classes", metavar="A,B", type=accept.names, default=(), help=classes_help)
    objects_help = "at most N objects at a time (default: all)"
    parser.add_argument("--objects", metavar="N", type=accept.count, default=0, help=objects_help)
    track_help = "follow objects from frame to frame, filtered (default); --no-track: every frame by itself"
    parser.add_argument("--track", action=argparse.BooleanOptionalAction, default=True, help=track_help)
    deadline_help = "leave out what would make a result later than MS after its frame, and count late ones"
    parser.add_argument("--deadline-ms", metavar="MS", type=accept.positive_ms, help=deadline_help)
    parser.add_argument("--status", metavar="FILE", type=Path, help="keep state, counters and latency here, as JSON")
