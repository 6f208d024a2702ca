"""Reading the project's own recording; `page_runtime.recording` documents its files and writes them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.capture.bop import BopScene, open_scene, pose_of
from page_runtime.capture.documents import field, listed, number, numbers, read_object
from page_runtime.image_files import SourceError
from page_runtime.recorded import FrameEntry, Instance, PartTruth, Refuse, Source, refuse, require_playable
from page_runtime.recording import CALIBRATION_FILE, FORMAT, RECORDING_FILE, RECORDING_VERSION


def read_recording(path: Path, on_problem: Refuse = refuse) -> Source:
    """The recording in folder `path` as a source with truths; SourceError says what is wrong with it, on_problem hears
    of every frame that cannot be read."""
    document = read_object(path / RECORDING_FILE)
    if document.get("version") != RECORDING_VERSION:
        raise SourceError(
            f"{path / RECORDING_FILE}: expected version {RECORDING_VERSION}, got {document.get('version')}; "
            "read it with the release that wrote it"
        )
    where = str(path / RECORDING_FILE)
    names = tuple(str(name) for name in listed(field(document, "parts", where=where), where=f"{where}, parts"))
    frames = field(document, "frames", where=where)

    def entry_of(scene: BopScene, key: int) -> FrameEntry:
        return _entry(scene, key, field(frames, str(key), where=f"{where}, frames"), names)

    entries = open_scene(path, on_problem).entries(entry_of, on_problem)
    category = field(document, "category", where=where)
    calibration_file = path / CALIBRATION_FILE
    calibration = calibration_file.read_text(encoding="utf-8", errors="replace") if calibration_file.is_file() else None
    known = {} if category is None else {"category": str(category), "part_names": names}
    return require_playable(Source(path, FORMAT, entries, calibration=calibration, **known), on_problem)


def _entry(scene: BopScene, key: int, facts: Any, names: tuple[str, ...]) -> FrameEntry:
    where = f"{scene.path / RECORDING_FILE}, frame {key}"
    size = numbers(field(facts, "size_px", where=where), 2, where=f"{where}, size_px")
    timestamp_s = number(field(facts, "timestamp_s", where=where), where=f"{where}, timestamp_s")
    instances = []
    for instance in listed(field(facts, "instances", where=where), where=f"{where}, instances"):
        box = field(instance, "region", where=where)
        x, y, w, h = numbers(box, 4, where=f"{where}, region") if box is not None else (0.0,) * 4
        region = None if box is None else (round(x), round(y), round(w), round(h))
        parts = field(instance, "parts", where=where)
        truths = None if parts is None else _truths(scene, key, listed(parts, where=f"{where}, parts"), names)
        instances.append(Instance(region, truths))
    entry = scene.entry(key, declared_size=(round(size[0]), round(size[1])))
    skew_s = number(facts.get("skew_s", 0.0), where=f"{where}, skew_s")
    return replace(entry, instances=tuple(instances), timestamp_s=timestamp_s, skew_s=skew_s)


def _truths(scene: BopScene, key: int, parts: list[Any], names: tuple[str, ...]) -> tuple[PartTruth, ...]:
    where = f"{scene.path}, frame {key}"
    if len(parts) != len(names):
        raise SourceError(f"{where}: expected the truth of {len(names)} parts, got {len(parts)}")
    gt = listed(scene.gt.get(key, []), where=f"{where}, scene_gt.json")
    info = listed(scene.gt_info.get(key, []), where=f"{where}, scene_gt_info.json")
    truths = []
    for name, part in zip(names, parts, strict=True):
        k = field(part, "gt", where=where)
        if not isinstance(k, int) or not 0 <= k < len(gt):
            raise SourceError(f"{where}: part {name!r} is gt entry {k}, but scene_gt.json has {len(gt)} entries")
        share = info[k].get("visib_fract") if k < len(info) and isinstance(info[k], dict) else None
        try:
            truths.append(PartTruth(
                name=name,
                T_camera_part=pose_of(gt[k], where=f"{where}, scene_gt.json"),
                extents_m=np.array(numbers(field(part, "extents_m", where=where), 3, where=f"{where}, extents_m")),
                visible_share=None if share is None else float(share),
                joint_state=None if part.get("joint_state") is None else float(part["joint_state"]),
            ))  # fmt: skip
        except (TypeError, ValueError) as error:
            raise SourceError(f"{where}: {error}") from error
    return tuple(truths)
