"""Sources as the commands name them: a folder or file, or a camera; and what is said of them on standard error."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from page_runtime.capture.events import SourceEvent
from page_runtime.capture.oak import is_oak, open_oak
from page_runtime.capture.playback import open_source
from page_runtime.capture.supervision import SupervisedSource
from page_runtime.commands.usage import UsageError
from page_runtime.live.slot import Stoppable
from page_runtime.recorded import FrameSource, RecordedFrame, Source


def is_live(name: str) -> bool:
    """Whether `name` means a camera: "oak" or "oak:DEVICE"; "./oak" is a folder."""
    return is_oak(name)


def open_recorded(name: str, *, window_s: float, command: str) -> Source:
    """The recorded frames called `name`, with a sentence on what could not be read; UsageError for a camera."""
    if is_live(name):
        raise UsageError(
            f"{command}: expected a recording, got the camera {name!r}; record it first (page-runtime record)"
        )
    source = open_source(Path(name), window_s=window_s)
    report_losses(name, source)
    return source


@contextmanager
def opened(name: str, *, window_s: float) -> Iterator[FrameSource]:
    """The source called `name`; a camera is closed when the block ends."""
    if not is_live(name):
        yield open_recorded(name, window_s=window_s, command="source")
        return

    def tell(event: SourceEvent) -> None:
        sys.stderr.write(f"page-runtime: {name}: {event}\n")

    with open_oak(name, window_s=window_s, on_event=tell) as source:
        try:
            yield source
        finally:
            report_losses(name, source)


def report_losses(name: str, source: FrameSource) -> None:
    """Say on standard error what did not become a frame; nothing when everything did."""
    if not source.counts.complete:
        sys.stderr.write(f"page-runtime: {name}: {source.counts}\n")


def frames_of(source: FrameSource, limit: int) -> Iterator[RecordedFrame]:
    """At most `limit` frames, all for 0. For a camera Ctrl-C and SIGTERM are the usual end: whatever is being done with
    the frame of the moment is done, and the iteration ends; a second Ctrl-C interrupts."""
    if isinstance(source, SupervisedSource):
        with stopped_by_signals(source):
            yield from islice(source, limit or None)
    else:
        yield from islice(source, limit or None)


@contextmanager
def stopped_by_signals(running: Stoppable) -> Iterator[None]:
    """Within the block the first Ctrl-C or SIGTERM asks `running` to stop; a second one interrupts."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, _: object) -> None:
        signal.signal(number, before[number])
        running.stop()

    before: dict[int, Any] = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def total_of(source: FrameSource, limit: int) -> int:
    """How many frames there will be, 0 where nobody knows."""
    if not isinstance(source, Source):
        return limit
    return min(limit, len(source)) if limit else len(source)
