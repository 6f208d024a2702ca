"""page-runtime live: the objects before a camera, found and followed; a JSON line for every processed frame."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from page_runtime.commands.inputs import load_network, require_fitting, require_inside, require_region
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
from page_runtime.live.result import LiveResult
from page_runtime.network import Network
from page_runtime.providers import ProviderChoice
from page_runtime.recorded import FrameSource, RecordedFrame, Source
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
            LiveLoop(found, follower, deadline_s=deadline_s, name=source) as loop,
            _ended_by_status(status, loop) as state,
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
            state.start(sinks)
            for count, result in enumerate(loop, start=1):
                sinks.put(result)
                state.report(result)
                progress.advance()
                if count == frames:
                    break
            sinks.drain()
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
        return _RegionOption(region)
    if region is None and isinstance(source, Source) and source.has_regions:
        return OwnRegions(most)
    return Clusters.of(network.metadata.category, most=most)


class _RegionOption(FixedRegion):
    """--region: a camera's pictures have a size when the first one is there, and only then it can be refused."""

    def locate(self, recorded: RecordedFrame) -> Sequence[Region]:
        require_inside(self.region, recorded.frame.camera.width, recorded.frame.camera.height)
        return (self.region,)


@contextmanager
def _ended_by_status(path: Path | None, loop: LiveLoop) -> Iterator[_StatusFile]:
    """The status file, whose last figures are written when the loop and its sinks have ended."""
    state = _StatusFile(path, loop)
    try:
        yield state
    finally:
        state.finish()


class _StatusFile:
    """The state and the figures in a file, once a second even when no frame comes, at every change of state, and at the
    end. A disk that is full is told once, and does not end the loop."""

    def __init__(self, path: Path | None, loop: LiveLoop) -> None:
        self._path, self._loop = path, loop
        self._sinks: Sinks | None = None
        self._figures, self._state, self._told = RunningFigures(), "", False
        # Of the figures and the file.
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._clock = threading.Thread(target=self._tick, name="status", daemon=True)

    def start(self, sinks: Sinks) -> None:
        """Write the file from now on."""
        self._sinks = sinks
        if self._path is not None:
            self._clock.start()

    def report(self, result: LiveResult) -> None:
        """Count a result."""
        if self._path is None:
            return
        with self._lock:
            self._figures.add(result)
            if result.state != self._state:
                self._state = result.state
                self._write(self._path, running=True)

    def finish(self) -> None:
        """Write the last figures, after the loop and its sinks have ended; nothing where they never began."""
        if self._path is None or self._sinks is None:
            return
        self._ended.set()
        self._clock.join()
        with self._lock:
            self._write(self._path, running=False)

    def _tick(self) -> None:
        assert self._path is not None
        while not self._ended.is_set():
            with self._lock:
                self._write(self._path, running=True)
            self._ended.wait(STATUS_PERIOD_S)

    def _write(self, path: Path, *, running: bool) -> None:
        sinks = {} if self._sinks is None else {name: asdict(one) for name, one in self._sinks.counts.items()}
        try:
            write_json(path, {"running": running, **self._figures.document(self._loop.counts), "sinks": sinks})
        except OSError as error:
            if not self._told:
                _tell(f"--status: {path} cannot be written ({error.strerror}); going on")
            self._told = True
