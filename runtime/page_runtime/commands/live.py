"""page-runtime live: the objects before a camera, found and followed; a JSON line for every processed frame."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

from page_runtime.commands.inputs import load_network, require_fitting, require_region
from page_runtime.commands.outputs import require_file_place
from page_runtime.commands.sink_options import STDOUT, SinkOptions, open_sinks
from page_runtime.commands.sources import is_live, opened, stopped_by_signals, total_of
from page_runtime.commands.status_file import status_file
from page_runtime.commands.terminal import Progress
from page_runtime.commands.usage import UsageError
from page_runtime.live.clusters import Clusters
from page_runtime.live.detector import Detector
from page_runtime.live.each import EachByItself
from page_runtime.live.faults import FrameFault
from page_runtime.live.following import Tracking
from page_runtime.live.locate import FixedRegion, Locator, OwnRegions, RegionError
from page_runtime.live.loop import LiveLoop, can_look_ahead
from page_runtime.live.masks import MaskFolder
from page_runtime.live.result import LiveResult
from page_runtime.machine import available_processors
from page_runtime.network import Network
from page_runtime.providers import ProviderChoice
from page_runtime.recorded import FrameSource, Source
from page_runtime.sampling import Region

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
    on: ProviderChoice,
    looks: int,
    quiet: bool,
    **where_to: Any,
) -> None:
    """Follow the objects of `source`; a result for every processed frame goes to the sinks of `where_to`, SinkOptions'
    fields, and to standard output where they name none.

    Ctrl-C and SIGTERM end it well after the frame of the moment; a second one interrupts. So does the end of whoever
    reads standard output, where nothing else takes results.
    """
    # The scoring that runs beside it has a processor of its own.
    threads = threads or (available_processors() - 1 if not track and can_look_ahead() else 0)
    network, threads = load_network(bundle, threads=threads, looks=looks, on=on)
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
        network.warm_up()
        with (
            LiveLoop(found, follower, deadline_s=deadline_s, name=source, on_event=_tell_of(source)) as loop,
            status_file(status, loop, tell=_tell) as state,
            open_sinks(
                sink_options,
                tell=_tell,
                category=network.metadata.category,
                calibration=found.calibration,
                waits=lambda: isinstance(found, Source) and not loop.stopping,
                # Whoever read the lines has enough, and there is nobody else to work for.
                reader_gone=loop.stop if sink_options == SinkOptions(out=STDOUT) else None,
            ) as sinks,
            Progress("live", total_of(found, frames), quiet=quiet) as progress,
            stopped_by_signals(loop),
            loop,
        ):
            if state is not None:
                state.start(sinks)
            for count, result in enumerate(_results(loop), start=1):
                sinks.put(result)
                if state is not None:
                    state.report(result)
                progress.advance()
                if count == frames:
                    break
            sinks.drain()
    if not quiet:
        counts = loop.counts
        sys.stderr.write(
            f"page-runtime: {source}: {counts.received} frames, {counts.processed} processed, {counts.dropped} passed "
            f"over for newer ones, {counts.late} late, {counts.failed} failed\n"
        )


def _tell(sentence: str) -> None:
    sys.stderr.write(f"page-runtime: {sentence}\n")


def _tell_of(source: str) -> Callable[[FrameFault], None]:
    return lambda fault: _tell(
        f"{source}: {fault}; the loop goes on without it, and this is not said again, but counted as failed"
    )


def _results(loop: LiveLoop) -> Iterator[LiveResult]:
    """The loop's results; UsageError where --region is not in its pictures: a camera's have a size when the first one
    is there, and only then it can be refused."""
    try:
        yield from loop
    except RegionError as error:
        raise UsageError(f"--{error}") from error


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
