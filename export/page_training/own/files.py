"""The files of a category of the user's own: what `from-urdf` writes and every later command reads.

A folder of two: category.json, the description and what is random about its scenes, and models.npz, the surfaces. The
files it came from are not needed any more.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.bundle_fields import BundleError
from page_runtime.category_document import category_document, category_from
from page_training.own.category import OwnCategory, T_part_link
from page_training.own.model import OwnJoint, OwnModel, OwnPart, Surface
from page_training.records import SPLITS

VERSION = 2
CATEGORY_FILE, MODELS_FILE = "category.json", "models.npz"


def write_own(own: OwnCategory, folder: Path) -> None:
    """Write the category's two files into `folder`, which is made; those of an earlier one are replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {}
    for m, model in enumerate(own.models):
        for k, part in enumerate(model.parts):
            for field in ("vertices", "triangles", "color", "palette"):
                arrays[f"{m}.{k}.{field}"] = getattr(part.surface, field)
    document = {
        "version": VERSION,
        "description": category_document(own.category),
        "rest": own.rest,
        "scale_sigma": own.scale_sigma,
        "models": [
            {
                "source": model.source,
                "split": split,
                "parts": [
                    {"name": part.name, "links": {link: T.tolist() for link, T in part.links.items()}}
                    for part in model.parts
                ],
                "joints": [asdict(joint) for joint in model.joints],
            }
            for model, split in zip(own.models, own.splits, strict=True)
        ],
        "T_part_link": {
            model.source: {
                part: {link: T.tolist() for link, T in links.items()} for part, links in T_part_link(model).items()
            }
            for model in own.models
        },
    }
    with (folder / MODELS_FILE).open("wb") as file:
        np.savez_compressed(file, **arrays)
    (folder / CATEGORY_FILE).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def read_own(folder: Path) -> OwnCategory:
    """The category that `write_own` wrote; ValueError when the folder holds something else."""
    path = folder / CATEGORY_FILE
    return _read(folder, path.stat().st_mtime_ns) if path.exists() else _read(folder, 0)


@lru_cache(maxsize=8)
def _read(folder: Path, _: int) -> OwnCategory:
    try:
        document = json.loads((folder / CATEGORY_FILE).read_text(encoding="utf-8"))
        if document["version"] != VERSION:
            raise ValueError(f"expected version {VERSION}, got {document['version']}")
        models: list[OwnModel] = []
        with np.load(folder / MODELS_FILE) as arrays:
            for m, entry in enumerate(document["models"]):
                parts = tuple(
                    OwnPart(
                        part["name"],
                        Surface(
                            *(arrays[f"{m}.{k}.{field}"] for field in ("vertices", "triangles", "color", "palette"))
                        ),
                        {link: np.array(T, float) for link, T in part["links"].items()},
                    )
                    for k, part in enumerate(entry["parts"])
                )
                joints = tuple(
                    OwnJoint(**{**joint, **{name: tuple(joint[name]) for name in ("axis", "point", "limits")}})
                    for joint in entry["joints"]
                )
                models.append(OwnModel(entry["source"], parts, joints))
        category = category_from(document["description"])
        splits = tuple(str(entry["split"]) for entry in document["models"])
        if SPLITS[0] not in splits or not set(splits) <= set(SPLITS):
            raise ValueError(f"models of the splits {', '.join(sorted(set(splits))) or 'none'}")
        return OwnCategory(category, tuple(models), document["rest"], float(document["scale_sigma"]), splits)
    except (OSError, KeyError, TypeError, ValueError, BundleError) as error:
        raise ValueError(
            f"{folder}: expected a category of page-train from-urdf, got {error}; make it again"
        ) from error
