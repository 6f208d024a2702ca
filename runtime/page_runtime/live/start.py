"""The live loop as a program starts it: a source, a network, and where to look."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from page_runtime.live.clusters import Clusters
from page_runtime.live.faults import FrameFault
from page_runtime.live.following import Tracking
from page_runtime.live.locate import FixedRegion, Locator, OwnRegions
from page_runtime.live.loop import LiveLoop
from page_runtime.network import Network
from page_runtime.recorded import RecordedFrame, Source
from page_runtime.sampling import Region


def live_results(
    source: Iterable[RecordedFrame],
    network: Network,
    where: Region | Locator | None = None,
    *,
    objects: int | None = None,
    deadline_s: float | None = None,
    max_looks: int = 1,
    on_event: Callable[[FrameFault], None] = lambda _: None,
) -> LiveLoop:
    """Find the objects of `network`'s category in the frames of `source` and follow them: a result for each frame.

        with live_results(open_oak("oak"), network) as results:
            for result in results: ...

        live_results(source, network, (200, 120, 240, 200)).run(on_result)

    source: frames as they come (`SupervisedSource`, or any iterable), of which the newest is taken and the others are
    counted as dropped; or a recording, every frame of which is. where: the region (x,y,w,h) px in which the one object
    is first seen, or a `Locator` (`Clusters`, `Detector`, `MaskFolder`); by default the source's own regions where it
    has some, else `Clusters`: whatever stands out of table and walls. objects: at most so many at a time. deadline_s,
    on_event, and what iterating raises: `LiveLoop`. max_looks: at a frame in a full search, as in `estimate`.
    """
    if max_looks < 1:
        raise ValueError(f"max_looks: expected at least 1, got {max_looks}")
    if objects is not None and objects < 1:
        raise ValueError(f"objects: expected at least 1, or None for as many as there are, got {objects}")
    locator = locator_of(where, source, network)
    name = str(source.path) if isinstance(source, Source) else str(getattr(source, "name", "source"))
    tracking = Tracking(network, locator, max_looks=max_looks, most=objects)
    return LiveLoop(source, tracking, deadline_s=deadline_s, name=name, on_event=on_event)


def locator_of(where: Region | Locator | None, source: Iterable[RecordedFrame], network: Network) -> Locator:
    """What `live_results` makes of its argument `where`."""
    if isinstance(where, tuple):
        return FixedRegion(where)
    if where is not None:
        return where
    if isinstance(source, Source) and source.has_regions:
        return OwnRegions()
    return Clusters.of(network.metadata.category)
