"""Objects found and followed from frame to frame: the state machine of the live loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

from page_runtime.estimator import MAX_LOOKS, estimate, examine
from page_runtime.frame import RgbdFrame
from page_runtime.live.advance import SAME_ROTATION_RAD, START_TRUST, Advanced, advanced, observation, trust
from page_runtime.live.deadline import Deadline
from page_runtime.live.locate import Locator, overlap
from page_runtime.live.loop import Followed
from page_runtime.live.near import agreement
from page_runtime.live.prior import expected_region
from page_runtime.live.result import LiveObject, LiveState
from page_runtime.live.track import Observation, Track, begun, filtered_pose, joint_rates, prior_of
from page_runtime.network import Network
from page_runtime.pose import ArticulatedPose, NotSeen, PartPose
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import Region

# Without the object for so long a track is lost, and the object looked for everywhere; then it is forgotten.
LOST_S = 0.4
FORGET_S = 10.0
# How often to look for further objects.
LOOK_AROUND_S = 1.0
# The source's clock where it has none.
PERIOD_S = 1 / 30
# A region of which so much is in a followed object's is about that object.
_SAME_PLACE = 0.5
# Two tracks nearer to each other than this share of a part's diagonal follow one object; stacked things are farther.
_SAME_BODY = 0.03
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
        """Every followed object in this frame, and those found in it."""
        frame, time_s = recorded.frame, self._clock(recorded.frame)
        stage_ms: dict[str, float] = {}
        objects: list[LiveObject] = []
        reasons: list[str] = []
        searched = tracked = lost = 0
        for track, region in self._take_tracks():
            began = perf_counter()
            step = advanced(self._network, track, frame, time_s, deadline, self._search_s)
            if step.searched:
                self._search_s = max(perf_counter() - began, self._search_s)
            if step.pose is not None:
                _add(stage_ms, step.pose)
                objects.append(self._live_object(step, frame))
                searched, tracked = searched + step.searched, tracked + (not step.searched)
                self._tracks.append((step.track, step.region))
            elif time_s - step.track.time_s > LOST_S:
                lost += 1
                reasons.append(f"object {track.number} is lost: {step.reason}")
                self._lost.append(_Lost(step.track, region, time_s))
            else:
                reasons.append(f"object {track.number}: {step.reason}")
                self._tracks.append((step.track, region))
        twins = _twins(objects)
        objects = [one for one in objects if one.number not in twins]
        self._tracks = [own for own in self._tracks if own[0].number not in twins]
        lost += len(twins)
        self._lost = [one for one in self._lost if time_s - one.since_s <= FORGET_S]
        if self._wants_more(time_s):
            found = self._search(recorded, time_s, deadline, stage_ms, reasons)
            searched += len(found)
            objects += found
        return Followed(
            objects=tuple(sorted(objects, key=lambda one: one.number)),
            state=self._state(),
            stage_ms=stage_ms,
            reason="" if objects else "; ".join(reasons) or "nothing was found where an object may be",
            searched=searched,
            tracked=tracked,
            lost=lost,
        )

    def _clock(self, frame: RgbdFrame) -> float:
        """The source's time, or a period more than the last where it has none or steps back, and from there at the
        source's pace."""
        now = frame.timestamp_s + self._shift_s
        if self._time_s is not None and now <= self._time_s:
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
    ) -> list[LiveObject]:
        """Objects that are not followed yet, where lost ones were and where the locator says, as time allows: one place
        in every frame at least, those left out first in the next."""
        self._looked_s = time_s
        frame = recorded.frame
        began = perf_counter()
        places = [*self._locator.locate(recorded), *(one.region for one in self._lost)]
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
            found = examine(self._network, frame, place, max_looks=self._max_looks)
            self._search_s = max(perf_counter() - began, _COST_MEMORY * self._search_s)
            _add(stage_ms, found.pose)
            if found.sample is None or found.output is None or trust(found.pose) < START_TRUST:
                reasons.append(_refused(found.pose))
                continue
            seen = observation(frame, found.sample, found.output, found.pose)
            objects.append(self._begin(seen, place, frame, time_s))
            if self._full():
                break
        return objects

    def _full(self) -> bool:
        """Whether as many objects are seen as there can be."""
        return self._most is not None and sum(not track.missed for track, _ in self._tracks) >= self._most

    def _missing(self) -> list[tuple[Track, Region]]:
        """Tracks whose object was not seen in this frame, and where it was: lost ones, and those that soon will be."""
        return [*((one.track, one.region) for one in self._lost), *(own for own in self._tracks if own[0].missed)]

    def _occupied(self, place: Region) -> bool:
        return any(overlap(place, region) > _SAME_PLACE for track, region in self._tracks if not track.missed)

    def _begin(self, seen: Observation, region: Region, frame: RgbdFrame, time_s: float) -> LiveObject:
        number, category = self._number_at(region), self._network.metadata.category
        track = begun(number, category, seen, frame.camera, time_s)
        own = expected_region(prior_of(track, frame.camera, time_s), category, frame.camera) or region
        self._tracks.append((track, own))
        return LiveObject(number, region, seen.pose, tracked=False, joint_rates=joint_rates(track))

    def _number_at(self, region: Region) -> int:
        """Of the missing object that was nearest to `region`, whose old track ends here, or a new one."""
        missing = self._missing()
        if not missing:
            self._next_number += 1
            return self._next_number - 1
        number = min(missing, key=lambda own: _away(own[1], region))[0].number
        self._lost = [one for one in self._lost if one.track.number != number]
        self._tracks = [own for own in self._tracks if own[0].number != number]
        return number

    def _live_object(self, step: Advanced, frame: RgbdFrame) -> LiveObject:
        assert step.pose is not None
        pose = filtered_pose(step.track, self._network.metadata.category, step.pose, frame.camera)
        return LiveObject(
            step.track.number, step.region, pose, tracked=not step.searched, joint_rates=joint_rates(step.track)
        )


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
        objects = []
        for number, place in enumerate(places):
            if number and deadline.stopping():
                break
            pose = estimate(self._network, recorded.frame, place, max_looks=self._max_looks)
            _add(stage_ms, pose)
            objects.append(LiveObject(number, place, pose, tracked=False))
        reason = "" if objects else "nothing says where an object is in this frame"
        return Followed(tuple(objects), "searching", stage_ms, reason, searched=len(objects))


def _twins(objects: Sequence[LiveObject]) -> set[int]:
    """Numbers of tracks that have come to follow the object of an older one: two bodies are not in one place."""
    kept: list[LiveObject] = []
    twins: set[int] = set()
    for one in sorted(objects, key=lambda found: found.number):
        if any(_same_body(one.pose, other.pose) for other in kept):
            twins.add(one.number)
        else:
            kept.append(one)
    return twins


def _same_body(one: ArticulatedPose, other: ArticulatedPose) -> bool:
    both = any(isinstance(a, PartPose) and isinstance(b, PartPose) for a, b in zip(one.parts, other.parts, strict=True))
    return both and agreement(one.parts, other.parts, rotation_rad=SAME_ROTATION_RAD, share=_SAME_BODY)


def _away(one: Region, other: Region) -> float:
    """Squared distance of two regions' middles, px^2."""
    return (one[0] + one[2] / 2 - other[0] - other[2] / 2) ** 2 + (one[1] + one[3] / 2 - other[1] - other[3] / 2) ** 2


def _add(stage_ms: dict[str, float], pose: ArticulatedPose) -> None:
    for name, value in pose.stage_ms.items():
        stage_ms[name] = stage_ms.get(name, 0.0) + value


def _refused(pose: ArticulatedPose) -> str:
    """Why no track begins with this estimate."""
    reasons = dict.fromkeys(part.reason for part in pose.parts if isinstance(part, NotSeen))
    if len(reasons) == 1 and len(pose.parts) == sum(isinstance(part, NotSeen) for part in pose.parts):
        return next(iter(reasons))
    return f"what was seen is too unlikely to be it: confidence {trust(pose):.2f}, {START_TRUST} is needed"
