"""What the commands are given, checked before anything is computed or written."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2

from page_runtime.capture.playback import open_source
from page_runtime.commands.usage import UsageError
from page_runtime.estimator import estimate
from page_runtime.network import Network
from page_runtime.pose import ArticulatedPose, not_seen
from page_runtime.recorded import Instance, RecordedFrame, Source
from page_runtime.sampling import Region, check_region

NO_REGION = "not seen: nothing says where the object is in this frame; pass --region"


@dataclass(frozen=True, eq=False, slots=True)
class Inputs:
    """A loaded bundle and an opened source that go together; threads: what onnxruntime and OpenCV were given; looks: at
    most so many at a frame."""

    network: Network
    source: Source
    threads: int
    looks: int


def open_inputs(source: Path, bundle: Path, *, threads: int, looks: int, region: Region | None = None) -> Inputs:
    """Load and open; threads 0: one for each processor; `region` takes the place of all the source's own.

    Errors say what does not fit.
    """
    if looks < 1:
        raise UsageError(f"--looks: expected at least 1, got {looks}")
    threads = threads or available_threads()
    cv2.setNumThreads(threads)
    network = Network(bundle, threads=threads)
    opened = open_source(source)
    category = network.metadata.category
    if opened.category is not None and opened.category != category.name:
        raise UsageError(f"{bundle} is for the category {category.name!r}, but {source} holds {opened.category!r}")
    names = tuple(part.name for part in category.parts)
    if opened.part_names is not None and opened.part_names != names:
        known, found = ", ".join(names), ", ".join(opened.part_names)
        raise UsageError(f"{bundle} knows the parts {known}, but {source} has {found}")
    if region is not None:
        opened = _with_region(opened, region)
    if not opened.has_regions:
        raise UsageError(f"{source}: this {opened.format} does not say where the object is; pass --region x,y,w,h")
    return Inputs(network, opened, threads, looks)


def available_threads() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _with_region(source: Source, region: Region) -> Source:
    for width, height in {(entry.camera.width, entry.camera.height) for entry in source.entries}:
        try:
            check_region(region, width, height)
        except ValueError as error:
            raise UsageError(f"--region: {str(error).removeprefix('region: ')}") from error
    return replace(source, entries=tuple(replace(entry, instances=(Instance(region),)) for entry in source.entries))


Estimates = tuple[RecordedFrame, tuple[tuple[Instance, ArticulatedPose], ...]]


def estimates(inputs: Inputs) -> Iterator[Estimates]:
    """Every frame with the estimate of each of its objects; a frame without a region gets one that is all reasons."""
    for recorded in inputs.source:
        instances = recorded.instances or (Instance(None),)
        yield recorded, tuple((instance, _estimate(inputs, recorded, instance)) for instance in instances)


def _estimate(inputs: Inputs, recorded: RecordedFrame, instance: Instance) -> ArticulatedPose:
    if instance.region is None:
        return not_seen(inputs.network.metadata.category, NO_REGION)
    return estimate(inputs.network, recorded.frame, instance.region, max_looks=inputs.looks)
