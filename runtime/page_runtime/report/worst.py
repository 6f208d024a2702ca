"""The objects an estimate did worst on, drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.estimator import estimate
from page_runtime.evaluation import FAILURE_ROTATION_RAD, FAILURE_SHARE
from page_runtime.frame import RgbdFrame
from page_runtime.network import Network
from page_runtime.overlay import draw
from page_runtime.pose import NO_REGION, not_seen
from page_runtime.providers import ON_CPU, ProviderChoice
from page_runtime.sampling import Region
from page_runtime.validation.comparison import Comparison
from page_runtime.validation.study import Study

MOST = 12
_PICTURE_WIDTH = 560
# Around the region, of its longer side.
_MARGIN = 0.35


@dataclass(frozen=True, eq=False, slots=True)
class DrawnObject:
    """picture: (H,W,3) uint8 RGB, the part of the frame around the object, true boxes in white. study: its name."""

    study: str
    comparison: Comparison
    picture: NDArray[np.uint8]


def badness(one: Comparison) -> float:
    """Of an object's worst part, in failures: 1 is just not of use; a missing pose counts as 2 at least."""
    worst = 0.0
    for part in one.parts:
        if part.rotation_rad is None or part.translation_m is None:
            worst = max(worst, 2.0)
            continue
        off = part.translation_m / (FAILURE_SHARE * part.diagonal_m)
        worst = max(worst, part.rotation_rad / FAILURE_ROTATION_RAD, off)
    return worst


def worst_objects(
    studies: Sequence[Study],
    comparisons: Mapping[str, Sequence[Comparison]],
    *,
    looks: int,
    threads: int,
    on: ProviderChoice = ON_CPU,
) -> list[DrawnObject]:
    """The MOST worst objects, worst first, estimated once more to be drawn."""
    every = [(study, one) for study in studies for one in comparisons[study.name] if one.parts]
    chosen = sorted(every, key=lambda pair: badness(pair[1]), reverse=True)[:MOST]
    networks: dict[str, Network] = {}
    found = []
    for study, one in chosen:
        if study.bundle_sha256 not in networks:
            networks[study.bundle_sha256] = Network(study.bundle, threads=threads, on=on)
        entry = next(entry for entry in study.source.entries if entry.index == one.frame)
        recorded = entry.read()
        instance = recorded.instances[one.instance]
        if instance.region is None:
            pose = not_seen(study.category, NO_REGION)
        else:
            pose = estimate(networks[study.bundle_sha256], recorded.frame, instance.region, max_looks=looks)
        near, region = _around(recorded.frame, instance.region)
        picture = draw(near, ((replace(instance, region=region), pose),), with_truth=True)
        found.append(DrawnObject(study.name, one, picture))
    return found


def _around(frame: RgbdFrame, region: Region | None) -> tuple[RgbdFrame, Region | None]:
    """The region in a 4 by 3 cut with some of what surrounds it, at the page's size, and where it is there."""
    left, top, wide, high = 0, 0, frame.camera.width, frame.camera.height
    if region is not None:
        x, y, w, h = region
        side = max(w, h * 4 / 3) * (1 + 2 * _MARGIN)
        wide, high = max(2, round(min(side, wide))), max(2, round(min(side * 3 / 4, high)))
        left = round(float(np.clip(x + w / 2 - wide / 2, 0, frame.camera.width - wide)))
        top = round(float(np.clip(y + h / 2 - high / 2, 0, frame.camera.height - high)))
    scale = _PICTURE_WIDTH / wide
    size = _PICTURE_WIDTH, max(1, round(high * scale))
    kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    cut = np.ascontiguousarray(frame.color[top : top + high, left : left + wide])
    color = np.asarray(cv2.resize(cut, size, interpolation=kind), np.uint8)
    camera = frame.camera.cropped(left, top, wide, high).resized(*size)
    near = RgbdFrame(color, np.zeros(color.shape[:2], np.float32), camera, index=frame.index)
    if region is None:
        return near, None
    x, y, w, h = region
    return near, (round((x - left) * scale), round((y - top) * scale), round(w * scale), round(h * scale))
