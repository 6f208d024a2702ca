"""What a sink is."""

from __future__ import annotations

from typing import Protocol, TypeVar

from page_runtime.live.result import LiveResult

Item_contra = TypeVar("Item_contra", contravariant=True)


class SinkOf(Protocol[Item_contra]):
    """Takes things one by one, from one thread of its own (`sinks.queue`).

    name: as in messages and counters. write: may block and may raise; what it raises is counted and told once, and does
    not reach the loop. close: finishes files; called once, from the same thread, also after a write that raised.
    """

    @property
    def name(self) -> str: ...
    def write(self, item: Item_contra, /) -> None: ...
    def close(self) -> None: ...


Sink = SinkOf[LiveResult]
