"""Results as the live loop gives them, made of the frames of a recording and the estimates of a bundle."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import toy
from page_runtime import Network, estimate, open_source
from page_runtime.frame import RgbdFrame
from page_runtime.live.result import LiveObject, LiveResult, LoopCounts
from page_runtime.pose import not_seen


def results_of(recording: Path, bundle: Path, *, max_looks: int = 1) -> Iterator[LiveResult]:
    """A result for every frame, 30 a second, objects numbered in the order of the frame's regions."""
    network = Network(bundle, threads=1)
    for count, recorded in enumerate(open_source(recording), start=1):
        begin = time.perf_counter()
        objects = tuple(
            LiveObject(number, i.region, estimate(network, recorded.frame, i.region, max_looks=max_looks), False)
            for number, i in enumerate(recorded.instances)
            if i.region is not None
        )
        latency_ms = (time.perf_counter() - begin) * 1e3
        stage_ms: dict[str, float] = {}
        for found in objects:
            for name, value in found.pose.stage_ms.items():
                stage_ms[name] = stage_ms.get(name, 0.0) + value
        frame = replace(recorded.frame, timestamp_s=count / 30)
        counts = LoopCounts(received=count, processed=count, searched=count * len(objects))
        yield LiveResult(frame, objects, "tracking", counts, latency_ms, stage_ms)


def empty_result(index: int, *, period_s: float = 1 / 30) -> LiveResult:
    """A black frame without a depth reading, in which nothing was found."""
    camera = toy.toy_camera()
    size = camera.height, camera.width
    frame = RgbdFrame(
        np.zeros((*size, 3), np.uint8), np.zeros(size, np.float32), camera, timestamp_s=index * period_s, index=index
    )
    counts = LoopCounts(received=index + 1, processed=index + 1)
    return LiveResult(frame, (), "searching", counts, 1.0, reason="no object found: no depth reading in the frame")


def noisy_result(index: int) -> LiveResult:
    """A picture that no codec makes small."""
    result = empty_result(index)
    result.frame.color[:] = np.random.default_rng(index).integers(0, 255, result.frame.color.shape)
    return result


def unseen_result(index: int) -> LiveResult:
    """An object of which no part has a pose."""
    result = empty_result(index)
    found = LiveObject(0, (10, 10, 50, 50), not_seen(toy.CATEGORY, "not seen: no depth reading"), tracked=False)
    return LiveResult(result.frame, (found,), "reacquiring", result.counts, 2.0, late=True)
