"""Where objects may be in a frame: what every way of finding that out has in common, and the two simplest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import Region, check_region


class Locator(Protocol):
    """Says where to look. most: at most so many objects are there at a time, None where nobody knows.

    locate: regions (x,y,w,h) px, the likeliest first. They may hold something else: whoever asked finds out.
    """

    @property
    def most(self) -> int | None: ...
    def locate(self, recorded: RecordedFrame) -> Sequence[Region]: ...


class RegionError(ValueError):
    """The region that was asked for is not in the source's pictures."""


@dataclass(frozen=True, slots=True)
class FixedRegion:
    """One object that is first seen in `region`, whatever frame that is. locate: RegionError where it lies outside."""

    region: Region
    most: int | None = 1

    def locate(self, recorded: RecordedFrame) -> Sequence[Region]:
        camera = recorded.frame.camera
        try:
            return (check_region(self.region, camera.width, camera.height),)
        except ValueError as error:
            raise RegionError(str(error)) from error


@dataclass(frozen=True, slots=True)
class OwnRegions:
    """Where the source itself says that objects are."""

    most: int | None = None

    def locate(self, recorded: RecordedFrame) -> Sequence[Region]:
        return tuple(instance.region for instance in recorded.instances if instance.region is not None)


def overlap(one: Region, other: Region) -> float:
    """Area that two regions share, over the smaller one's: 1 where one lies in the other."""
    return _shared(one, other) / min(one[2] * one[3], other[2] * other[3])


def covered(region: Region, by: Region) -> float:
    """The share of `region` that lies in `by`."""
    return _shared(region, by) / (region[2] * region[3])


def _shared(one: Region, other: Region) -> int:
    width = min(one[0] + one[2], other[0] + other[2]) - max(one[0], other[0])
    height = min(one[1] + one[3], other[1] + other[3]) - max(one[1], other[1])
    return max(width, 0) * max(height, 0)
