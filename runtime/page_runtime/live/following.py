"""Objects found and followed from frame to frame: the state machine of the live loop."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from page_runtime.equivalents import renamed_pose
from page_runtime.estimator import examine
from page_runtime.frame import RgbdFrame
from page_runtime.live.advance import START_TRUST, Advanced, advanced, missed, observation, trust
from page_runtime.live.deadline import Deadline
from page_runtime.live.faults import FrameFault, attempt
from page_runtime.live.identity import Match, matched, twins
from page_runtime.live.locate import Locator, overlap
from page_runtime.live.loop import Followed
from page_runtime.live.prior import expected_region
from page_runtime.live.result import LiveObject, LiveState
from page_runtime.live.track import Track, begun, filtered_pose, joint_rates, prior_of
from page_runtime.network import Network
from page_runtime.part_poses import LabelledPoints
from page_runtime.pose import ArticulatedPose, NotSeen
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import Region
from page_runtime.stopwatch import add_stages

# Without the object for so long a track is lost, and the object looked for everywhere; then it is forgotten.
LOST_S = 0.4
FORGET_S = 10.0
# How often to look for further objects.
LOOK_AROUND_S = 1.0
# The source's clock where it has none.
PERIOD_S = 1 / 30
# A region of which so much is in a followed object's is about that object.
_SAME_PLACE = 0.5
_COST_MEMORY = 0.8
# In a second: a search that once took long is not put off for ever, or a wrong pose would never be checked.
_COST_FADES = 0.95


@dataclass(frozen=True, eq=False, slots=True)
class _Lost:
    """A track that was lost, where its object was last, and since when it is gone."""

    track: Track
    region: Region
    since_s: float


class Tracking:
    """Finds objects where `locator` says, and follows each from frame to frame (`advance`).

    max_looks: at most so many looks at a frame in a full search; most: objects at a time, None for any number.
    """

    def __init__(self, network: Network, locator: Locator, *, max_looks: int = 1, most: int | None = None) -> None:
        self._network, self._locator, self._max_looks = network, locator, max_looks
        self._most = locator.most if most is None else most
        self._tracks: list[tuple[Track, Region]] = []
        self._lost: list[_Lost] = []
        self._next_number = 0
        self._looked_s = float("-inf")
        self._time_s: float | None = None
        self._shift_s = 0.0
        self._search_s = 0.0
        self._turn = 0

    def follow(self, recorded: RecordedFrame, deadline: Deadline) -> Followed:
        """Every followed object in this frame, and those found in it.

        What is raised while one of them is worked on costs that one: as long as it goes on it is not seen, then it is
        lost, and a new search begins without what the track knew.
        """
        before = list(self._tracks), list(self._lost)
        try:
            return self._followed(recorded, deadline)
        except BaseException:
            self._tracks, self._lost = before
            raise

    def _followed(self, recorded: RecordedFrame, deadline: Deadline) -> Followed:
        frame, time_s = recorded.frame, self._clock(recorded.frame)
        stage_ms: dict[str, float] = {}
        objects: list[LiveObject] = []
        reasons: list[str] = []
        faults: list[FrameFault] = []
        searched = tracked = lost = 0
        for track, region in self._take_tracks():
            began = perf_counter()
            step, found = self._step(track, region, frame, time_s, deadline, faults)
            if step.searched:
                self._search_s = max(perf_counter() - began, self._search_s)
            if found is not None:
                add_stages(stage_ms, found.pose.stage_ms)
                objects.append(found)
                searched, tracked = searched + step.searched, tracked + (not step.searched)
                self._tracks.append((step.track, step.region))
            elif time_s - step.track.time_s > LOST_S:
                lost += 1
                reasons.append(f"object {track.number} is lost: {step.reason}")
                self._lost.append(_Lost(step.track, region, time_s))
            else:
                reasons.append(f"object {track.number}: {step.reason}")
                self._tracks.append((step.track, region))
        doubles = twins(self._network.metadata.category, objects)
        objects = [one for one in objects if one.number not in doubles]
        self._tracks = [own for own in self._tracks if own[0].number not in doubles]
        lost += len(doubles)
        self._lost = [one for one in self._lost if time_s - one.since_s <= FORGET_S]
        if self._wants_more(time_s):
            more = self._search(recorded, time_s, deadline, stage_ms, reasons, faults)
            searched += len(more)
            objects += more
        return Followed(
            objects=tuple(sorted(objects, key=lambda one: one.number)),
            state=self._state(),
            stage_ms=stage_ms,
            reason="" if objects else "; ".join(reasons) or "nothing was found where an object may be",
            searched=searched,
            tracked=tracked,
            lost=lost,
            faults=tuple(faults),
            # Tracks that were worked on to their end, and places: those that are no object have a reason of their own.
            failed=bool(faults) and not objects and len(reasons) == len(faults),
        )

    def _step(
        self,
        track: Track,
        region: Region,
        frame: RgbdFrame,
        time_s: float,
        deadline: Deadline,
        faults: list[FrameFault],
    ) -> tuple[Advanced, LiveObject | None]:
        """One track in this frame, and its object where that was seen."""

        def stepped() -> tuple[Advanced, LiveObject | None]:
            step = advanced(self._network, track, frame, time_s, deadline, self._search_s)
            return step, None if step.pose is None else self._live_object(step, step.pose, frame)

        found = attempt(stepped, frame=frame.index, subject=f"object {track.number}")
        if isinstance(found, FrameFault):
            faults.append(found)
            return missed(track, region, found.reason), None
        return found

    def _clock(self, frame: RgbdFrame) -> float:
        """The source's time, or a period more than the last where it has none or steps back, and from there at the
        source's pace."""
        now = frame.timestamp_s + self._shift_s
        if not np.isfinite(now):
            now = 0.0 if self._time_s is None else self._time_s + PERIOD_S
        elif self._time_s is not None and now <= self._time_s:
            self._shift_s += self._time_s + PERIOD_S - now
            now = self._time_s + PERIOD_S
        if self._time_s is not None:
            self._search_s *= _COST_FADES ** (now - self._time_s)
        self._time_s = now
        return now

    def _take_tracks(self) -> list[tuple[Track, Region]]:
        taken, self._tracks = self._tracks, []
        return taken

    def _state(self) -> LiveState:
        if self._lost or any(track.missed for track, _ in self._tracks):
            return "reacquiring"
        return "tracking" if self._tracks else "searching"

    def _wants_more(self, time_s: float) -> bool:
        if self._full():
            return False
        return not self._tracks or bool(self._missing()) or time_s - self._looked_s >= LOOK_AROUND_S

    def _search(
        self,
        recorded: RecordedFrame,
        time_s: float,
        deadline: Deadline,
        stage_ms: dict[str, float],
        reasons: list[str],
        faults: list[FrameFault],
    ) -> list[LiveObject]:
        """Objects that are not followed yet, where lost ones were and where the locator says, as time allows: one place
        in every frame at least, those left out first in the next."""
        self._looked_s = time_s
        frame = recorded.frame
        began = perf_counter()
        located = attempt(lambda: self._locator.locate(recorded), frame=frame.index, subject="where objects may be")
        if isinstance(located, FrameFault):
            faults.append(located)
            reasons.append(located.reason)
            located = ()
        places = [*located, *(one.region for one in self._lost)]
        stage_ms["locating"] = 1e3 * (perf_counter() - began)
        free = [place for place in places if not self._occupied(place)]
        if not free:
            return []
        start = self._turn % len(free)
        objects: list[LiveObject] = []
        for count, place in enumerate([*free[start:], *free[:start]]):
            if count and not deadline.allows(self._search_s):
                self._looked_s = float("-inf")
                self._turn += count
                break
            if self._occupied(place):
                continue
            began = perf_counter()
            found = attempt(
                lambda place=place: self._found_at(place, frame, time_s, stage_ms),
                frame=frame.index,
                subject=f"the place {','.join(map(str, place))}",
            )
            self._search_s = max(perf_counter() - began, _COST_MEMORY * self._search_s)
            if isinstance(found, LiveObject):
                objects.append(found)
                if self._full():
                    break
                continue
            if isinstance(found, FrameFault):
                faults.append(found)
                found = found.reason
            reasons.append(found)
        return objects

    def _found_at(self, place: Region, frame: RgbdFrame, time_s: float, stage_ms: dict[str, float]) -> LiveObject | str:
        """The object at a place, followed from now on, or why there is none."""
        found = examine(self._network, frame, place, max_looks=self._max_looks)
        add_stages(stage_ms, found.pose.stage_ms)
        if found.labelled is None or trust(found.pose) < START_TRUST:
            return _refused(found.pose)
        return self._begin(found.pose, found.labelled, place, frame, time_s)

    def _full(self) -> bool:
        """Whether as many objects are seen as there can be."""
        return self._most is not None and sum(not track.missed for track, _ in self._tracks) >= self._most

    def _missing(self) -> list[tuple[Track, Region]]:
        """Tracks whose object was not seen in this frame, and where it was: lost ones, and those that soon will be."""
        return [*((one.track, one.region) for one in self._lost), *(own for own in self._tracks if own[0].missed)]

    def _occupied(self, place: Region) -> bool:
        return any(overlap(place, region) > _SAME_PLACE for track, region in self._tracks if not track.missed)

    def _begin(
        self, pose: ArticulatedPose, labelled: LabelledPoints, region: Region, frame: RgbdFrame, time_s: float
    ) -> LiveObject:
        """A track of what was found: that of the missing object it is, whose old one ends here, or a new one."""
        category, again = self._network.metadata.category, self._missing_one(pose, frame, time_s)
        number = self._next_number if again is None else again[0]
        if again is not None:
            renaming = again[1].renaming
            pose, labelled = renamed_pose(category, pose, renaming), labelled.in_order(renaming.order)
        track = begun(number, category, observation(frame, labelled, pose), frame.camera, time_s)
        own = expected_region(prior_of(track, frame.camera, time_s), category, frame.camera) or region
        self._next_number += again is None
        self._lost = [one for one in self._lost if one.track.number != number]
        self._tracks = [one for one in self._tracks if one[0].number != number] + [(track, own)]
        return LiveObject(number, region, pose, tracked=False, joint_rates=joint_rates(track))

    def _missing_one(self, pose: ArticulatedPose, frame: RgbdFrame, time_s: float) -> tuple[int, Match] | None:
        """The number of the missing object that this is, the nearest of those it may be."""
        category = self._network.metadata.category
        matches = [
            (track.number, match)
            for track, _ in self._missing()
            if (match := matched(track, category, pose, frame.camera, time_s)) is not None
        ]
        return min(matches, key=lambda one: one[1].distance_m, default=None)

    def _live_object(self, step: Advanced, found: ArticulatedPose, frame: RgbdFrame) -> LiveObject:
        pose = filtered_pose(step.track, self._network.metadata.category, found, frame.camera)
        return LiveObject(
            step.track.number, step.region, pose, tracked=not step.searched, joint_rates=joint_rates(step.track)
        )


def _refused(pose: ArticulatedPose) -> str:
    """Why no track begins with this estimate."""
    reasons = dict.fromkeys(part.reason for part in pose.parts if isinstance(part, NotSeen))
    if len(reasons) == 1 and len(pose.parts) == sum(isinstance(part, NotSeen) for part in pose.parts):
        return next(iter(reasons))
    return f"what was seen is too unlikely to be it: confidence {trust(pose):.2f}, {START_TRUST} is needed"
