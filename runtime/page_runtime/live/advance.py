"""What becomes of one track in one frame: a fit to depth, the network near the expected pose, or a full search.

Two frames in three are fitted to depth alone, a fraction of the network's time. Every third asks the network, starting
from the expected pose: its calibrated confidence is the test that the track is still on the object. Where that fails,
and every CHECK_S, the votes are searched as if nothing were known; a search that finds the object otherwise, and is
surer than the track twice in a row, has the last word, so that no wrong pose keeps itself alive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from page_runtime.equivalents import nearest_renaming, poses_of, renamed_pose
from page_runtime.estimator import sample_for, sampled_again
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array
from page_runtime.live.deadline import Deadline
from page_runtime.live.identity import SAME_ROTATION_RAD, SAME_SHARE, matched
from page_runtime.live.locate import covered
from page_runtime.live.near import agreement, fit_near, pose_near
from page_runtime.live.prior import Prior, expected_focus, expected_region, prior_as_named, surfaces_of
from page_runtime.live.track import Observation, Track, begun, prior_of, with_fit, with_observation
from page_runtime.network import Network, NetworkOutput
from page_runtime.part_poses import LabelledPoints, labelled_points, members_of, pose_from_output
from page_runtime.pose import ArticulatedPose, PartPose
from page_runtime.sampling import Region, RegionSample
from page_runtime.stopwatch import Stopwatch

FITS_BETWEEN = 2
CHECK_S = 1.0
# Mean confidence of the parts that have a pose: to go on with a track, and to begin one.
KEEP_TRUST = 0.35
START_TRUST = 0.5
_DOUBTS = 2
# Of the region an object turns out to fill, the share that has to have been looked at.
_ENOUGH = 0.8


@dataclass(frozen=True, eq=False, slots=True)
class Advanced:
    """track: after the frame. pose: what was found, unfiltered; None with a `reason` where nothing was. region: px.
    searched: by a full search, or else from the expected pose. network: whether it was asked."""

    track: Track
    pose: ArticulatedPose | None
    region: Region
    searched: bool = False
    network: bool = False
    reason: str = ""


def trust(pose: ArticulatedPose) -> float:
    """In [0, 1]: mean confidence of the parts that have a pose, 0 where fewer than half do."""
    known = [part.confidence for part in pose.parts if isinstance(part, PartPose)]
    return float(np.mean(known)) if 2 * len(known) >= len(pose.parts) and known else 0.0


def observation(frame: RgbdFrame, labelled: LabelledPoints, pose: ArticulatedPose) -> Observation:
    """What a track remembers of a pose and the points it was made of, both with the same names."""
    surfaces, background = surfaces_of(pose, labelled, _colors(frame, labelled.pixels))
    return Observation(pose, surfaces, background)


def _colors(frame: RgbdFrame, pixels: NDArray[np.int64]) -> NDArray[np.uint8]:
    """(N,3) RGB of the frame's pixels (N,), counted row by row."""
    return frame.color.reshape(-1, 3)[pixels]


def advanced(
    network: Network, track: Track, frame: RgbdFrame, time_s: float, deadline: Deadline, search_s: float
) -> Advanced:
    """The track one frame later. search_s: what a full search costs after the network's answer; it is put off where the
    deadline does not allow it."""
    prior, watch = prior_of(track, frame.camera, time_s), Stopwatch()
    region = expected_region(prior, network.metadata.category, frame.camera)
    if region is None:
        return missed(track, (0, 0, 0, 0), "it is expected outside the picture")
    due = time_s - track.checked_s >= CHECK_S or track.missed > 0 or track.doubts > 0
    # A check looks where parts may be that were not seen before, too.
    focus = None if due else expected_focus(prior, network.metadata.category, frame.camera, region)
    sample = sample_for(network.metadata, frame, region, depth_m=prior.depth_m, focus=focus)
    watch.stage("sampling")
    if isinstance(sample, str):
        return missed(track, region, sample)
    if track.fits < FITS_BETWEEN and track.steady and not due:
        fitted = fit_near(network.metadata.category, sample, _colors(frame, sample.source_index), prior, watch)
        if not isinstance(fitted, str):
            return Advanced(with_fit(track, fitted, frame.camera, time_s), fitted.pose, region)
    seen = _look(network, track, frame, time_s, region, sample, prior, watch)
    if due and deadline.allows(search_s):
        return _checked(seen)
    near = seen.near()
    if trust(near.pose) >= KEEP_TRUST and seen.may_be(near):
        kept = seen.kept(near, searched=False)
        again = _where_it_is(seen, kept) if deadline.allows(search_s) else None
        return kept if again is None else again
    if not deadline.allows(search_s):
        return missed(track, region, "the track is in doubt, and there was no time for a full search", network=True)
    if focus is None:
        return _checked(seen, near)
    # Where it was expected it is not: nothing is known of where it is now.
    anywhere = sample_for(network.metadata, frame, region, depth_m=prior.depth_m)
    watch.stage("sampling")
    if isinstance(anywhere, str):
        return missed(track, region, anywhere, network=True)
    return _checked(_look(network, track, frame, time_s, region, anywhere, prior, watch))


def _where_it_is(seen: _Seen, kept: Advanced) -> Advanced | None:
    """A second look where the first one found the object to be; None where the first saw enough of it, or the second
    recognises nothing. A network that saw half an object is sure of poses that are slid along it."""
    prior = prior_of(kept.track, seen.frame.camera, seen.time_s)
    region = expected_region(prior, seen.network.metadata.category, seen.frame.camera)
    if region is None or covered(region, seen.region) >= _ENOUGH:
        return None
    sample = sample_for(seen.network.metadata, seen.frame, region, depth_m=prior.depth_m)
    seen.watch.stage("sampling")
    if isinstance(sample, str):
        return None
    again = _look(seen.network, seen.track, seen.frame, seen.time_s, region, sample, prior, seen.watch)
    near = again.near()
    return again.kept(near, searched=False) if trust(near.pose) >= KEEP_TRUST else None


def _look(
    network: Network,
    track: Track,
    frame: RgbdFrame,
    time_s: float,
    region: Region,
    sample: RegionSample,
    prior: Prior,
    watch: Stopwatch,
) -> _Seen:
    output = network.run(sample, network.neighbours_of(sample))
    watch.stage("network")
    again = None
    if sample.focus is None:
        members = members_of(output, sample.num_distinct)
        again = sampled_again(network.metadata, frame, region, sample, members, depth_m=prior.depth_m)
    if again is not None:
        watch.stage("sampling")
        sample, output = again, network.run(again, network.neighbours_of(again))
        watch.stage("network")
    return _Seen(network, track, frame, time_s, region, sample, output, prior, watch)


@dataclass(frozen=True, eq=False, slots=True)
class _Answer:
    """A pose, and the points it was made of under the same names."""

    pose: ArticulatedPose
    labelled: LabelledPoints


@dataclass(frozen=True, eq=False, slots=True)
class _Seen:
    """A track, and the network's answer for the frame after it."""

    network: Network
    track: Track
    frame: RgbdFrame
    time_s: float
    region: Region
    sample: RegionSample
    output: NetworkOutput
    prior: Prior
    watch: Stopwatch

    def near(self) -> _Answer:
        """From the expected pose, in the names that the network has for the parts in this frame."""
        labelled = labelled_points(self.sample, self.output)
        prior = prior_as_named(self.network.metadata.category, self.prior, labelled)
        pose = pose_near(self.network.metadata, self.sample, self.output, prior, self.watch)
        return self._in_the_tracks_names(pose, labelled)

    def full(self) -> _Answer:
        """By a search of all votes."""
        pose = pose_from_output(self.network.metadata, self.sample, self.output, self.watch)
        return self._in_the_tracks_names(pose, labelled_points(self.sample, self.output))

    def _in_the_tracks_names(self, pose: ArticulatedPose, labelled: LabelledPoints) -> _Answer:
        # Filtered under names that change, a pose would leap half a turn.
        category = self.network.metadata.category
        renaming = nearest_renaming(category, poses_of(pose), self.prior.poses)
        return _Answer(renamed_pose(category, pose, renaming), labelled.in_order(renaming.order))

    def may_be(self, answer: _Answer) -> bool:
        """Whether this is the track's object; that of one that was there in the last frame is not asked for."""
        category, camera = self.network.metadata.category, self.frame.camera
        return not self.track.missed or matched(self.track, category, answer.pose, camera, self.time_s) is not None

    def kept(self, answer: _Answer, *, searched: bool) -> Advanced:
        """The track goes on with this pose."""
        observed = observation(self.frame, answer.labelled, answer.pose)
        track = with_observation(self.track, observed, self.frame.camera, self.time_s)
        return Advanced(track, answer.pose, self.region, searched, network=True)

    def restarted(self, answer: _Answer) -> Advanced:
        """The object is elsewhere: what was known of its motion is forgotten."""
        observed = observation(self.frame, answer.labelled, answer.pose)
        category = self.network.metadata.category
        track = begun(self.track.number, category, observed, self.frame.camera, self.time_s)
        return Advanced(track, answer.pose, self.region, searched=True, network=True)


def _checked(seen: _Seen, near: _Answer | None = None) -> Advanced:
    """By a full search; near: from the expected pose, where that was tried before."""
    track, full = seen.track, seen.full()
    expected = [None if part is None else _as_pose(part.last, part.evidence.T_camera_part) for part in seen.prior.parts]
    same = agreement(full.pose.parts, expected, rotation_rad=SAME_ROTATION_RAD, share=SAME_SHARE)
    if trust(full.pose) >= START_TRUST and not seen.may_be(full):
        return missed(track, seen.region, "another object is where it may be", network=True)
    if trust(full.pose) >= KEEP_TRUST and same:
        found = seen.kept(full, searched=True)
        return replace(found, track=replace(found.track, checked_s=seen.time_s, doubts=0))
    if trust(full.pose) >= START_TRUST and track.missed:
        # Nothing is known of where it went meanwhile.
        return seen.restarted(full)
    near = near or seen.near()
    surer = trust(full.pose) > max(trust(near.pose), KEEP_TRUST)
    if surer and track.doubts + 1 >= _DOUBTS:
        return seen.restarted(full)
    doubts = track.doubts + 1 if surer else 0
    if trust(near.pose) < KEEP_TRUST:
        absent = missed(track, seen.region, "the network does not recognise it here", network=True)
        return replace(absent, track=replace(absent.track, doubts=doubts))
    found = seen.kept(near, searched=False)
    return replace(found, track=replace(found.track, checked_s=seen.time_s, doubts=doubts))


def _as_pose(last: PartPose, T_camera_part: Array) -> PartPose:
    return replace(last, T_camera_part=T_camera_part)


def missed(track: Track, region: Region, reason: str, *, network: bool = False) -> Advanced:
    """The track after a frame in which its object was not seen, and why."""
    return Advanced(replace(track, missed=track.missed + 1), None, region, network=network, reason=reason)
