"""The state of a running loop in a file, as JSON: for whoever supervises it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from page_runtime.commands.outputs import write_json
from page_runtime.live.figures import RunningFigures
from page_runtime.live.loop import LiveLoop
from page_runtime.live.result import LiveResult
from page_runtime.sinks.queue import CLOSE_S, NEWEST, QueuedSink, Sinks

PERIOD_S = 1.0


class StatusFile:
    """State and figures of `loop` in the file `path`, replaced as a whole once a second, also when no frame comes, at
    every change of state, and at the end.

    It is written like a sink, by a thread of its own behind a queue of one: a disk that is full or hangs is told of
    once, counted, and holds up neither the loop nor its end.
    """

    def __init__(self, path: Path, loop: LiveLoop, *, tell: Callable[[str], None]) -> None:
        self._loop, self._tell = loop, tell
        self._queued: QueuedSink[dict[str, Any]] = QueuedSink(_Document(path), NEWEST, tell)
        self._figures, self._state = RunningFigures(), ""
        self._sinks: Sinks | None = None
        # Of the figures: results come by one thread, and the clock's reads them.
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._clock = threading.Thread(target=self._tick, name="status", daemon=True)

    def start(self, sinks: Sinks) -> None:
        """Write the file from now on. sinks: whose counters are in it."""
        self._sinks = sinks
        self._queued.start()
        self._clock.start()

    def report(self, result: LiveResult) -> None:
        """Count a result; returns at once, whatever the disk does."""
        with self._lock:
            self._figures.add(result)
            has_changed, self._state = result.state != self._state, result.state
        if has_changed:
            self._put(running=True)

    def finish(self) -> None:
        """Write the last figures, after the loop and its sinks have ended; nothing where they never began."""
        if self._sinks is None:
            return
        self._ended.set()
        self._clock.join()
        self._put(running=False)
        deadline_s = time.monotonic() + CLOSE_S
        self._queued.finish(deadline_s)
        if not self._queued.join(deadline_s):
            self._tell(f"{self._queued.name}: did not close within {CLOSE_S:g} s and is left behind")

    def _tick(self) -> None:
        while not self._ended.is_set():
            self._put(running=True)
            self._ended.wait(PERIOD_S)

    def _put(self, *, running: bool) -> None:
        assert self._sinks is not None
        with self._lock:
            figures = self._figures.document(self._loop.counts)
        sinks = {name: asdict(one) for name, one in self._sinks.counts.items()}
        own = asdict(self._queued.counts)
        self._queued.put({"running": running, **figures, "sinks": sinks, "status": own})


class _Document:
    """The file as a sink of documents."""

    def __init__(self, path: Path) -> None:
        self._path = path

    @property
    def name(self) -> str:
        return f"status {self._path}"

    def write(self, item: dict[str, Any]) -> None:
        write_json(self._path, item)

    def close(self) -> None:
        """Nothing is open between two documents."""


@contextmanager
def status_file(path: Path | None, loop: LiveLoop, *, tell: Callable[[str], None]) -> Iterator[StatusFile | None]:
    """The status file, whose last figures are written when the block ends; None for None."""
    if path is None:
        yield None
        return
    state = StatusFile(path, loop, tell=tell)
    try:
        yield state
    finally:
        state.finish()
