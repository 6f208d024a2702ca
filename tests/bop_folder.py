"""An object of a category as a BOP scene: each part an object with a model of its own axes, right or with a fault."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from category_objects import posed_object, seen_object
from page_runtime.geometry import Array, invert, transform_from
from page_runtime.recorded import Instance, PartTruth, RecordedFrame
from page_runtime.recording import RECORDING_FILE, RecordingWriter
from page_training.categories import CATEGORIES
from page_training.datasets.layout import BopLayout


def bop_layout(category: str, *, axes: tuple[str, ...] = ("x", "y", "z"), first_id: int = 1) -> str:
    """TOML of a layout whose models all have these axes, numbered from first_id against the category's order."""
    names = [part.name for part in CATEGORIES[category].parts][::-1]
    parts = ", ".join(f"{{part = {json.dumps(name)}, axes = {json.dumps(list(axes))}}}" for name in names)
    return (
        f'format = "bop"\nname = "BOP"\nverified = false\nmodels = "../models/models_info.json"\n'
        f'category = "{category}"\nobj_ids = {[first_id + k for k in range(len(names))]}\nparts = [{parts}]\n'
    )


def model_offset(obj_id: int) -> Array:
    """(3,) m, the middle of a model's box in its own frame, which BOP leaves to the model."""
    return np.array([0.01 * obj_id, -0.02, 0.005])


def write_bop_scene(root: Path, layout: BopLayout, *, frames: int = 2) -> Path:
    """A folder of `frames` equal pictures of one object, its models in models/ beside it."""
    category = CATEGORIES[layout.frames.category]
    recorded, masks = seen_object(posed_object(category))
    number = {part.part: obj_id for obj_id, part in zip(layout.obj_ids, layout.frames.parts, strict=True)}
    R = {part.part: part.R_rest_part for part in layout.frames.parts}
    truths = recorded.instances[0].truths or ()
    T_model_part = {t.name: transform_from(R[t.name], model_offset(number[t.name])) for t in truths}
    models = {}
    for truth in truths:
        size_mm = 1e3 * np.abs(R[truth.name]) @ truth.extents_m
        low_mm = 1e3 * model_offset(number[truth.name]) - size_mm / 2
        box = {f"min_{a}": low for a, low in zip("xyz", low_mm, strict=True)}
        models[str(number[truth.name])] = box | {f"size_{a}": s for a, s in zip("xyz", size_mm, strict=True)}
    (root / "models").mkdir(parents=True)
    (root / "models" / "models_info.json").write_text(json.dumps(models))
    posed = tuple(
        PartTruth(t.name, t.T_camera_part @ invert(T_model_part[t.name]), t.extents_m, t.visible_share) for t in truths
    )
    path = root / "scene"
    with RecordingWriter(path, category=category.name, part_names=[t.name for t in truths]) as writer:
        scene = RecordedFrame(recorded.frame, (Instance(recorded.instances[0].region, posed),))
        for _ in range(frames):
            writer.write(scene, masks=(masks,))
    (path / RECORDING_FILE).unlink()
    document = json.loads((path / "scene_gt.json").read_text())
    for objects in document.values():
        for entry, truth in zip(objects, truths, strict=True):
            entry["obj_id"] = number[truth.name]
    (path / "scene_gt.json").write_text(json.dumps(document))
    return path
