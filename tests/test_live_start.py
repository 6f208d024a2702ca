"""The live loop as a program starts it, over recorded boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import pytest

from followed_boxes import ROOT, apart, at, only, region_of
from page_runtime import Network, RecordedFrame, live_results, open_source
from page_runtime.estimator import estimate, examine, first_look
from page_runtime.frame import RgbdFrame
from page_runtime.live import each, following
from page_runtime.live.deadline import Deadline
from page_runtime.live.each import EachByItself
from page_runtime.live.following import Tracking
from page_runtime.live.locate import OwnRegions, covered, overlap
from page_runtime.live.loop import LiveLoop
from page_runtime.sampling import Region


def test_every_frame_by_itself_is_what_estimate_says(network: Network, frames: list[RecordedFrame]) -> None:
    followed = EachByItself(network, OwnRegions(), max_looks=1).follow(frames[0], Deadline())
    found = only(followed.objects)
    full = estimate(network, frames[0].frame, region_of(frames[0]), max_looks=1)
    assert apart(found.pose, full) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert not found.tracked


def test_regions_overlap_by_the_smaller_and_cover_by_their_own() -> None:
    assert overlap((0, 0, 10, 10), (5, 5, 10, 10)) == 0.25
    assert overlap((0, 0, 10, 10), (2, 2, 2, 2)) == overlap((2, 2, 2, 2), (0, 0, 10, 10)) == 1.0
    assert overlap((0, 0, 10, 10), (20, 0, 5, 5)) == 0.0
    assert covered((0, 0, 10, 10), (0, 0, 5, 10)) == 0.5
    assert covered((0, 0, 5, 10), (0, 0, 10, 10)) == 1.0


def test_live_results_of_a_recording_has_one_for_every_frame(network: Network) -> None:
    source = open_source(ROOT / "tests" / "data" / "box")
    with live_results(source, network, objects=1) as results:
        indices = [result.frame.index for result in results]
    assert indices == [entry.index for entry in source.entries]
    with pytest.raises(ValueError, match="objects: expected at least 1"):
        live_results(source, network, objects=0)
    with pytest.raises(ValueError, match="max_looks: expected at least 1"):
        live_results(source, network, max_looks=0)


@dataclass(frozen=True)
class Everywhere:
    """Places without an object, all apart from each other; none knows how many objects there are."""

    places: tuple[Region, ...] = tuple((40 * k, 400, 38, 60) for k in range(8))
    most: int | None = None

    def locate(self, recorded: RecordedFrame) -> Sequence[Region]:
        del recorded
        return self.places


@pytest.mark.parametrize("way", [Tracking, EachByItself])
def test_a_loop_that_is_told_to_stop_looks_at_no_further_place(
    way: type[Tracking | EachByItself], network: Network, frames: list[RecordedFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[Region] = []
    loops: list[LiveLoop] = []

    def counted(run: Callable[..., object]) -> Callable[..., object]:
        def called(network: Network, frame: RgbdFrame, place: Region, **more: int) -> object:
            looked.append(place)
            if len(looked) == 2:
                loops[0].stop()
            return run(network, frame, place, **more)

        return called

    monkeypatch.setattr(following, "examine", counted(examine))
    monkeypatch.setattr(each, "first_look", counted(first_look))
    with LiveLoop([frames[0], at(frames[0], 1)], way(network, Everywhere())) as loop:
        loops.append(loop)
        assert len(list(loop)) == 1
    assert len(looked) == 2
