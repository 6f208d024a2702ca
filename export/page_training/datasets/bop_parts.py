"""BOP scenes with the boxes of their objects' models: true poses of the parts of one category, or of single objects.

BOP has no parts. A layout says which obj_id is which part and how its model's axes lie; without one every object is a
part by itself, of which box, pose and mask can be compared with depth all the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.capture.bop import FORMAT, BopScene, open_scene, pose_of, visible_box
from page_runtime.capture.documents import METRES_PER_MM, field, listed, number, read_object
from page_runtime.category import Category
from page_runtime.geometry import Array, transform_from
from page_runtime.image_files import SourceError
from page_runtime.part_masks import PartMasks
from page_runtime.recorded import FrameEntry, Instance, PartTruth, Refuse, Source, refuse, require_playable
from page_runtime.sampling import Region
from page_training.datasets.layout import BopLayout

MODELS_FILES = ("models/models_info.json", "../models/models_info.json", "../../models/models_info.json")


@dataclass(frozen=True, eq=False, slots=True)
class PartModel:
    """name: of the part. T_model_part: (4,4) from its canonical frame to the model's, metres. extents_m: (3,) of its
    box along the part's axes."""

    name: str
    T_model_part: Array
    extents_m: Array


def in_order_of(layout: BopLayout, category: Category) -> BopLayout:
    """The layout with its parts in the category's order; SourceError unless these are the category's."""
    wanted, named = [part.name for part in category.parts], [part.part for part in layout.frames.parts]
    if layout.frames.category != category.name or sorted(wanted) != sorted(named):
        raise SourceError(
            f"layout {layout.name}: expected the parts {', '.join(wanted)} of {category.name!r}, got "
            f"{', '.join(named)} of {layout.frames.category!r}; write a copy that says which obj_id is which part"
        )
    order = [named.index(name) for name in wanted]
    parts = tuple(layout.frames.parts[k] for k in order)
    frames = replace(layout.frames, parts=parts)
    return replace(layout, obj_ids=tuple(layout.obj_ids[k] for k in order), frames=frames)


def models_file_of(path: Path, layout: BopLayout | None) -> Path | None:
    """The models_info.json of a scene: the layout's, or that at one of BOP's places; None where there is none."""
    places = MODELS_FILES if layout is None else (layout.models,)
    return next((path / place for place in places if (path / place).is_file()), None)


def read_models(path: Path, layout: BopLayout | None) -> dict[int, PartModel]:
    """By obj_id; without a layout every object is one part in axes of its model. SourceError where there are none."""
    file = models_file_of(path, layout)
    if file is None:
        where = "models/ beside the scene's split" if layout is None else str((path / layout.models).resolve())
        raise SourceError(f"{path}: no models_info.json; expected the boxes of its objects in {where}")
    document = read_object(file)
    if layout is None:
        numbered = {key: value for key, value in document.items() if key.isascii() and key.isdigit()}
        return {
            int(key): _model(value, f"object {key}", np.eye(3), f"{file}, {key}") for key, value in numbered.items()
        }
    return {
        obj_id: _model(field(document, str(obj_id), where=str(file)), part.part, part.R_rest_part, f"{file}, {obj_id}")
        for obj_id, part in zip(layout.obj_ids, layout.frames.parts, strict=True)
    }


def _model(entry: Any, name: str, R_model_part: Array, where: str) -> PartModel:
    low, size = (
        METRES_PER_MM * np.array([number(field(entry, f"{of}_{axis}", where=where), where=where) for axis in "xyz"])
        for of in ("min", "size")
    )
    if not (size > 0).all():
        raise SourceError(f"{where}: expected size_x, size_y and size_z in mm, above 0, got {(1e3 * size).tolist()}")
    return PartModel(name, transform_from(R_model_part, low + size / 2), np.abs(R_model_part.T @ size))


def read_bop_parts(
    path: Path, layout: BopLayout | None, on_problem: Refuse = refuse
) -> tuple[Source, PartMasks | None]:
    """The scene with true poses and, where it has mask_visib/, masks. on_problem hears of frames that cannot be read.

    Of several objects of the category in a picture the first has the first entry of each part's obj_id, and so on.
    """
    models = read_models(path, layout)
    scene = open_scene(path, on_problem)
    groups: dict[int, tuple[tuple[int, ...], ...]] = {}

    def entry_of(scene: BopScene, key: int) -> FrameEntry:
        where = f"{scene.path / 'scene_gt.json'}, frame {key}"
        objects = listed(scene.gt.get(key, []), where=where)
        ids = [round(number(field(one, "obj_id", where=where), where=f"{where}, obj_id")) for one in objects]
        grouped = _singles(ids, models) if layout is None else _grouped(ids, layout.obj_ids)
        instances = tuple(_instance(scene, key, [(ids[k], k) for k in group], models) for group in grouped)
        groups[key] = grouped
        return replace(scene.entry(key), instances=instances)

    entries = scene.entries(entry_of, on_problem)
    names = None if layout is None else tuple(part.part for part in layout.frames.parts)
    category = None if layout is None else layout.frames.category
    source = require_playable(Source(path, FORMAT, entries, category, names), on_problem)
    folder = path / "mask_visib"
    return source, PartMasks(folder, groups) if folder.is_dir() else None


def _singles(ids: Sequence[int], models: dict[int, PartModel]) -> tuple[tuple[int, ...], ...]:
    return tuple((k,) for k, one in enumerate(ids) if one in models)


def _grouped(ids: Sequence[int], wanted: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """Entries of scene_gt for each object that has all its parts."""
    of_part = [[k for k, one in enumerate(ids) if one == obj_id] for obj_id in wanted]
    return tuple(zip(*of_part, strict=False))


def _instance(scene: BopScene, key: int, members: list[tuple[int, int]], models: dict[int, PartModel]) -> Instance:
    truths, regions = [], []
    info = scene.gt_info.get(key, [])
    for obj_id, k in members:
        where = f"{scene.path}, frame {key}, scene_gt.json entry {k}"
        seen = info[k] if isinstance(info, list) and k < len(info) and isinstance(info[k], dict) else {}
        regions.append(visible_box(seen, where=where))
        share, model = seen.get("visib_fract"), models[obj_id]
        try:
            pose = pose_of(scene.gt[key][k], where=where) @ model.T_model_part
            truths.append(PartTruth(model.name, pose, model.extents_m, None if share is None else float(share)))
        except (TypeError, ValueError) as error:
            raise error if isinstance(error, SourceError) else SourceError(f"{where}: {error}") from error
    return Instance(_around([region for region in regions if region is not None]), tuple(truths))


def _around(regions: list[Region]) -> Region | None:
    if not regions:
        return None
    corners = np.array([(x, y, x + w, y + h) for x, y, w, h in regions])
    x, y, *_ = corners.min(axis=0)
    *_, right, bottom = corners.max(axis=0)
    return int(x), int(y), int(right - x), int(bottom - y)
