"""Recordings with truth of whole procedural frames: what the runtime is validated and demonstrated on."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from page_runtime.category import Category
from page_runtime.recorded import Instance, PartTruth, RecordedFrame
from page_runtime.recording import RecordingWriter
from page_runtime.sampling import Region
from page_training.categories import category_named
from page_training.records import SPLITS
from page_training.scenes import SceneView, full_view, sample_scene

BOX_JITTER = 0.05
FRAME_PERIOD_S = 1 / 30


def jittered(region: Region, rng: np.random.Generator, width: int, height: int) -> Region:
    """The tight box with each edge moved by up to BOX_JITTER of its size, as a detector's would be."""
    x, y, w, h = region
    left, right = x + w * rng.uniform(-BOX_JITTER, BOX_JITTER), x + w * (1 + rng.uniform(-BOX_JITTER, BOX_JITTER))
    top, bottom = y + h * rng.uniform(-BOX_JITTER, BOX_JITTER), y + h * (1 + rng.uniform(-BOX_JITTER, BOX_JITTER))
    x0, y0 = max(0, round(left)), max(0, round(top))
    return x0, y0, max(2, min(width, round(right)) - x0), max(2, min(height, round(bottom)) - y0)


def recorded_frame(view: SceneView, category: Category, rng: np.random.Generator) -> RecordedFrame:
    """A scene view in the runtime's terms; a joint's state belongs to its child part."""
    states = {joint.child: state for joint, state in zip(category.joints, view.joint_states, strict=True)}
    truths = tuple(
        PartTruth(part.name, truth.T_camera_part, truth.extents_m, truth.visible_share, states.get(k))
        for k, (part, truth) in enumerate(zip(category.parts, view.truths, strict=True))
    )
    camera = view.frame.camera
    region = jittered(view.region, rng, camera.width, camera.height)
    return RecordedFrame(view.frame, (Instance(region, truths),))


def record_split(
    category_name: str,
    path: Path,
    *,
    split: str,
    frames: int,
    seed: int = 0,
    width: int | None = None,
    color_suffix: Literal[".png", ".jpg"] = ".png",
    on_frame: Callable[[], None] = lambda: None,
) -> None:
    """Write `frames` frames, each of another instance, of a split that training never sees.

    Every scene is recorded at its own camera's size, which is what training has seen, or `width` px wide.
    """
    category = category_named(category_name)
    names = tuple(part.name for part in category.parts)
    rng = np.random.default_rng([zlib.crc32(category_name.encode()), SPLITS.index(split), 2**31 + seed])
    with RecordingWriter(path, category=category_name, part_names=names, color_suffix=color_suffix) as writer:
        for index in range(frames):
            view = full_view(sample_scene(category_name, rng, split), rng, width)
            recorded = recorded_frame(view, category, rng)
            timed = replace(recorded.frame, timestamp_s=index * FRAME_PERIOD_S, index=index)
            masks = [[view.part_mask == k + 1 for k in range(len(names))]]
            writer.write(RecordedFrame(timed, recorded.instances), masks=masks)
            on_frame()
