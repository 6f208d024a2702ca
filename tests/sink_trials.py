"""What tests of sinks share: a sink that does as it is told, and a disk without room."""

from __future__ import annotations

import resource
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from page_runtime.live.result import LiveResult
from page_runtime.sinks.queue import Sinks
from page_runtime.sinks.sink import Sink


def keep(sink: Sink, results: list[LiveResult]) -> None:
    """All results into one sink, however busy the computer is."""
    with Sinks([(sink, len(results))], close_s=60) as sinks:
        for result in results:
            sinks.put(result)
    assert sinks.counts[sink.name].written == len(results)


class Script:
    """A sink that does as it is told: `act` is called with the number of each write."""

    name = "script"

    def __init__(self, act: Callable[[int], object] = lambda _: None) -> None:
        self.act, self.seen, self.closings, self.threads = act, [], 0, set[int]()

    def write(self, result: LiveResult) -> None:
        self.threads.add(threading.get_ident())
        self.seen.append(result.frame.index)
        self.act(len(self.seen))

    def close(self) -> None:
        self.closings += 1


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file of this process may grow above `size` bytes, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def read_ros2(path: Path) -> dict[str, list[object]]:
    """Messages by topic, read by Foxglove's library."""
    from mcap_ros2.reader import read_ros2_messages

    found: dict[str, list[object]] = {}
    for message in read_ros2_messages(path):
        found.setdefault(message.channel.topic, []).append(message.ros_msg)
    return found
