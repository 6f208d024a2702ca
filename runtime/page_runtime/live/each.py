"""The objects of every frame as if it were the only one."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

from page_runtime.estimator import MAX_LOOKS, FirstLook, examined, first_look
from page_runtime.frame import RgbdFrame
from page_runtime.live.deadline import Deadline
from page_runtime.live.faults import FrameFault, attempt
from page_runtime.live.locate import Locator
from page_runtime.live.loop import Followed
from page_runtime.live.result import LiveObject
from page_runtime.network import Network
from page_runtime.pose import ArticulatedPose, not_seen
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import Region
from page_runtime.stopwatch import add_stages


@dataclass(frozen=True, eq=False, slots=True)
class Looked:
    """The places of a frame that were looked at, with what was seen there, and how long it took to find them."""

    seen: tuple[tuple[Region, FirstLook | FrameFault], ...]
    locating_ms: float


class EachByItself:
    """Finds the objects of every frame as if it were the only one: `estimator.estimate` wherever `locator` says.

    The loop may look at a frame while it makes the answer of the one before (`loop.LooksAhead`).

    Everything is reported, however unlikely; objects are numbered in the locator's order. Nothing is left out for a
    deadline, only for the end of the loop.
    """

    def __init__(self, network: Network, locator: Locator, *, max_looks: int = MAX_LOOKS) -> None:
        self._network, self._locator, self._max_looks = network, locator, max_looks

    def follow(self, recorded: RecordedFrame, deadline: Deadline) -> Followed:
        """All objects of this frame."""
        return self.answer(recorded, self.look(recorded, deadline), deadline)

    def look(self, recorded: RecordedFrame, deadline: Deadline) -> Looked:
        """Where objects are, and what the network says of each."""
        began = perf_counter()
        places = self._locator.locate(recorded)
        locating_ms = 1e3 * (perf_counter() - began)
        frame, seen = recorded.frame, list[tuple[Region, FirstLook | FrameFault]]()
        for number, place in enumerate(places):
            if number and deadline.stopping():
                break
            look = attempt(
                lambda place=place: first_look(self._network, frame, place),
                frame=frame.index,
                subject=f"object {number}",
            )
            seen.append((place, look))
        return Looked(tuple(seen), locating_ms)

    def answer(self, recorded: RecordedFrame, looked: Looked, deadline: Deadline) -> Followed:
        """The poses of what was looked at."""
        stage_ms = {"locating": looked.locating_ms}
        frame, objects, faults = recorded.frame, list[LiveObject](), list[FrameFault]()
        for number, (place, look) in enumerate(looked.seen):
            if number and deadline.stopping():
                break
            pose = self._pose(frame, place, look, f"object {number}")
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

    def _pose(
        self, frame: RgbdFrame, place: Region, look: FirstLook | FrameFault, subject: str
    ) -> ArticulatedPose | FrameFault:
        if isinstance(look, FrameFault):
            return look
        return attempt(
            lambda: examined(self._network, frame, place, look, max_looks=self._max_looks).pose,
            frame=frame.index,
            subject=subject,
        )
