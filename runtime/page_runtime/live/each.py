"""The objects of every frame as if it were the only one."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

from page_runtime.estimator import MAX_LOOKS, estimate
from page_runtime.live.deadline import Deadline
from page_runtime.live.faults import FrameFault, attempt
from page_runtime.live.locate import Locator
from page_runtime.live.loop import Followed
from page_runtime.live.result import LiveObject
from page_runtime.network import Network
from page_runtime.pose import not_seen
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import Region
from page_runtime.stopwatch import add_stages


class EachByItself:
    """Finds the objects of every frame as if it were the only one: `estimator.estimate` wherever `locator` says.

    Everything is reported, however unlikely; objects are numbered in the locator's order. Nothing is left out for a
    deadline, only for the end of the loop.
    """

    def __init__(self, network: Network, locator: Locator, *, max_looks: int = MAX_LOOKS) -> None:
        self._network, self._locator, self._max_looks = network, locator, max_looks

    def follow(self, recorded: RecordedFrame, deadline: Deadline) -> Followed:
        """All objects of this frame."""
        stage_ms: dict[str, float] = {}
        began = perf_counter()
        places: Sequence[Region] = self._locator.locate(recorded)
        stage_ms["locating"] = 1e3 * (perf_counter() - began)
        frame, objects, faults = recorded.frame, list[LiveObject](), list[FrameFault]()
        for number, place in enumerate(places):
            if number and deadline.stopping():
                break
            pose = attempt(
                lambda place=place: estimate(self._network, frame, place, max_looks=self._max_looks),
                frame=frame.index,
                subject=f"object {number}",
            )
            if isinstance(pose, FrameFault):
                faults.append(pose)
                pose = not_seen(self._network.metadata.category, pose.reason)
            add_stages(stage_ms, pose.stage_ms)
            objects.append(LiveObject(number, place, pose, tracked=False))
        reason = "" if objects else "nothing says where an object is in this frame"
        return Followed(
            tuple(objects),
            "searching",
            stage_ms,
            reason,
            searched=len(objects) - len(faults),
            faults=tuple(faults),
            failed=bool(faults) and len(faults) == len(objects),
        )
