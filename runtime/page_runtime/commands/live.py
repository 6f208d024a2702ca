"""page-runtime live: the objects before a camera, found and followed; a JSON line for every processed frame."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from page_runtime.commands.inputs import load_network, require_fitting, require_region
from page_runtime.commands.outputs import require_file_place, write_json
from page_runtime.commands.sink_options import STDOUT, SinkOptions, open_sinks
from page_runtime.commands.sources import is_live, opened, stopped_by_signals, total_of
from page_runtime.commands.terminal import Progress
from page_runtime.commands.usage import UsageError
from page_runtime.live.clusters import Clusters
from page_runtime.live.detector import Detector
from page_runtime.live.figures import RunningFigures
from page_runtime.live.following import EachByItself, Tracking
from page_runtime.live.locate import FixedRegion, Locator, OwnRegions
from page_runtime.live.loop import LiveLoop
from page_runtime.live.masks import MaskFolder
from page_runtime.live.result import LiveResult, LoopCounts
from page_runtime.network import Network
from page_runtime.recorded import FrameSource, Source
from page_runtime.sampling import Region
from page_runtime.sinks.queue import Sinks

STATUS_PERIOD_S = 1.0
Where = Region | Literal["auto"]


def live(
    source: str,
    *,
    bundle: Path,
    region: Where | None,
    mask: Path | None,
    detector: Path | None,
    classes: tuple[str, ...],
    objects: int,
    track: bool,
    deadline_ms: float | None,
    status: Path | None,
    frames: int,
    window_s: float,
    threads: int,
    looks: int,
    quiet: bool,
    **where_to: Any,
) -> None:
    """Follow the objects of `source`; a result for every processed frame goes to the sinks of `where_to`, SinkOptions'
    fields, and to standard output where they name none.

    Ctrl-C and SIGTERM end it well after the frame of the moment; a second one interrupts.
    """
    network, threads = load_network(bundle, threads=threads, looks=looks)
    sink_options = SinkOptions(**where_to)
    if sink_options == SinkOptions():
        sink_options = SinkOptions(out=STDOUT)
    require_file_place(status, option="--status")
    if classes and detector is None:
        raise UsageError("--classes: expected with --detector, whose classes they are")
    if sum(way is not None for way in (region, mask, detector)) > 1:
        raise UsageError("--region, --mask and --detector all say where objects are; give one of them")
    if mask is not None and is_live(source):
        raise UsageError(f"--mask: the frames of {source} are not known before they come; use --detector or --region")
    most = objects or None
    with opened(source, window_s=window_s) as found:
        require_fitting(bundle, network, source, found)
        locator = _locator(region, mask, detector, classes, most, found, network, threads)
        if isinstance(locator, FixedRegion):
            require_region(source, found, locator.region)
        follower = (
            Tracking(network, locator, max_looks=looks, most=most)
            if track
            else EachByItself(network, locator, max_looks=looks)
        )
        deadline_s = None if deadline_ms is None else 1e-3 * deadline_ms
        loop = LiveLoop(found, follower, deadline_s=deadline_s, name=source)
        with (
            open_sinks(
                sink_options, tell=_tell, category=network.metadata.category, calibration=found.calibration
            ) as sinks,
            Progress("live", total_of(found, frames), quiet=quiet) as progress,
            _status(status, loop, sinks) as report,
            stopped_by_signals(loop),
            loop,
        ):
            for count, result in enumerate(loop, start=1):
                sinks.put(result)
                report(result)
                progress.advance()
                if count == frames:
                    break
    if not quiet:
        counts = loop.counts
        sys.stderr.write(
            f"page-runtime: {source}: {counts.received} frames, {counts.processed} processed, {counts.dropped} passed "
            f"over for newer ones, {counts.late} late\n"
        )


def _tell(sentence: str) -> None:
    sys.stderr.write(f"page-runtime: {sentence}\n")


def _locator(
    region: Where | None,
    mask: Path | None,
    detector: Path | None,
    classes: tuple[str, ...],
    most: int | None,
    source: FrameSource,
    network: Network,
    threads: int,
) -> Locator:
    """What the options ask for; by default the source's own regions where it has some, else everything that stands
    out."""
    if mask is not None:
        return MaskFolder.opened(mask, most=most)
    if detector is not None:
        return Detector(detector, classes=classes, most=most, threads=threads)
    if region is not None and region != "auto":
        return FixedRegion(region)
    if region is None and isinstance(source, Source) and source.has_regions:
        return OwnRegions(most)
    return Clusters.of(network.metadata.category, most=most)


@contextmanager
def _status(path: Path | None, loop: LiveLoop, sinks: Sinks) -> Iterator[Any]:
    """Called with every result, writes the state and the figures at most once a second, and at the end. A disk that is
    full is told once, and does not end the loop."""
    if path is None:
        yield lambda _: None
        return
    figures, written_s, state, told = RunningFigures(), float("-inf"), "", False

    def document(counts: LoopCounts, *, running: bool) -> dict[str, Any]:
        given = {name: asdict(one) for name, one in sinks.counts.items()}
        return {"running": running, **figures.document(counts), "sinks": given}

    def write(document: dict[str, Any]) -> None:
        nonlocal told
        try:
            write_json(path, document)
        except OSError as error:
            if not told:
                _tell(f"--status: {path} cannot be written ({error.strerror}); going on")
            told = True

    def report(result: LiveResult) -> None:
        nonlocal written_s, state
        figures.add(result)
        now_s = time.monotonic()
        if now_s - written_s >= STATUS_PERIOD_S or result.state != state:
            written_s, state = now_s, result.state
            write(document(result.counts, running=True))

    try:
        yield report
    finally:
        write(document(loop.counts, running=False))
