"""What the commands are given, checked before anything is computed or written."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import cv2

from page_runtime.category import Category
from page_runtime.commands.sources import open_recorded
from page_runtime.commands.usage import UsageError
from page_runtime.estimator import estimate
from page_runtime.machine import available_processors
from page_runtime.network import Network
from page_runtime.pose import NO_REGION, ArticulatedPose, not_seen
from page_runtime.providers import AUTO, CPU, CPU_PROVIDER, ON_CPU, ProviderChoice, described
from page_runtime.recorded import FrameSource, Instance, RecordedFrame, Source
from page_runtime.sampling import Region, check_region

AnySource = TypeVar("AnySource", bound=FrameSource)


@dataclass(frozen=True, eq=False, slots=True)
class Inputs(Generic[AnySource]):
    """A loaded bundle and an opened source that go together; threads: what onnxruntime and OpenCV were given; looks: at
    most so many at a frame; region: takes the place of all the source's own."""

    network: Network
    source: AnySource
    threads: int
    looks: int
    region: Region | None = None


def load_network(bundle: Path, *, threads: int, looks: int, on: ProviderChoice = ON_CPU) -> tuple[Network, int]:
    """The bundle's network, and the threads it was given; threads 0: one for each processor. What it runs on is told
    where it is not the CPU."""
    if looks < 1:
        raise UsageError(f"--looks: expected at least 1, got {looks}")
    threads = threads or available_processors()
    cv2.setNumThreads(threads)
    network = Network(bundle, threads=threads, on=on)
    if network.fell_back:
        sys.stderr.write(f"page-runtime: {network.fell_back}; the network runs on {described(network.operators)}\n")
    elif network.operators.keys() != {CPU_PROVIDER} or on.provider not in (AUTO, CPU):
        sys.stderr.write(f"page-runtime: the network runs on {described(network.operators)}\n")
    return network, threads


def open_inputs(
    source: str,
    bundle: Path,
    *,
    region: Region | None,
    threads: int,
    looks: int,
    on: ProviderChoice,
    window_s: float,
    command: str,
) -> Inputs[Source]:
    """Load a bundle and open a recording, with `region` or its own regions; errors say what does not fit."""
    network, threads = load_network(bundle, threads=threads, looks=looks, on=on)
    opened = open_recorded(source, window_s=window_s, command=command)
    require_fitting(bundle, network, source, opened)
    require_region(source, opened, region)
    return Inputs(network, opened if region is None else opened.with_region(region), threads, looks, region)


def require_fitting(bundle: Path, network: Network, name: str, source: FrameSource) -> None:
    """UsageError when the source holds other objects than the bundle knows."""
    require_category(bundle, network.metadata.category, name, source)


def require_category(knowing: Path, category: Category, name: str, source: FrameSource) -> None:
    """The same of any file that knows a category, as a checkpoint does."""
    if source.category is not None and source.category != category.name:
        raise UsageError(f"{knowing} is for the category {category.name!r}, but {name} holds {source.category!r}")
    names = tuple(part.name for part in category.parts)
    if source.part_names is not None and source.part_names != names:
        known, found = ", ".join(names), ", ".join(source.part_names)
        raise UsageError(f"{knowing} knows the parts {known}, but {name} has {found}")


def require_region(
    name: str, source: FrameSource, region: Region | None, otherwise: str = "pass --region x,y,w,h"
) -> None:
    """UsageError unless `region` lies in the pictures, or the source says where objects are; otherwise: the way out."""
    if not isinstance(source, Source):
        return  # A camera's pictures have a size when the first one is there.
    if region is None:
        if not source.has_regions:
            raise UsageError(f"{name}: this {source.format} does not say where the object is; {otherwise}")
    else:
        for width, height in {(entry.camera.width, entry.camera.height) for entry in source.entries}:
            require_inside(region, width, height)


def require_inside(region: Region, width: int, height: int) -> None:
    """UsageError for a region that is not in pictures of that size."""
    try:
        check_region(region, width, height)
    except ValueError as error:
        raise UsageError(f"--region: {str(error).removeprefix('region: ')}") from error


Estimates = tuple[RecordedFrame, tuple[tuple[Instance, ArticulatedPose], ...]]


def estimates(inputs: Inputs[AnySource], frames: Iterable[RecordedFrame] | None = None) -> Iterator[Estimates]:
    """Every frame with the estimate of each of its objects; a frame without a region gets one that is all reasons.

    frames: of the source, where not all are wanted.
    """
    for recorded in inputs.source if frames is None else frames:
        instances = recorded.instances or (Instance(None),)
        if inputs.region is not None:
            require_inside(inputs.region, recorded.frame.camera.width, recorded.frame.camera.height)
            instances = (Instance(inputs.region),)
        yield recorded, tuple((instance, _estimate(inputs, recorded, instance)) for instance in instances)


def _estimate(inputs: Inputs[AnySource], recorded: RecordedFrame, instance: Instance) -> ArticulatedPose:
    if instance.region is None:
        return not_seen(inputs.network.metadata.category, NO_REGION)
    return estimate(inputs.network, recorded.frame, instance.region, max_looks=inputs.looks)
