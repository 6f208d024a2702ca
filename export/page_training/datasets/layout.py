"""How an annotated data set lies on disk: a TOML file, so that another one needs no code.

Two forms. That of ArtImage, ReArtMix and what is made like them: a JSON file a picture with the objects in it and the
matrices of their links, and urdf_metas.json with each object's part boxes and joints in its rest frame. And BOP scenes
whose objects are the parts of one category, in files with `format = "bop"`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

from page_runtime.image_files import SourceError
from page_runtime.recording import RECORDING_FILE
from page_training.datasets.part_frames import ObjectFrames, object_frames, require_order

POLYGONS = "polygons"


@dataclass(frozen=True, slots=True)
class Layout:
    """Folders and files are relative to the data set's; {folder} in `models` is that folder's name.

    objects: how the part frames of each category lie in its rest frame; of others nothing can be imported. verified:
    read and checked on real data. masks: "polygons" of each link, or a folder of pictures whose first channel is the
    part's index where there is depth. metres_per_unit: of the depth pictures. first_link: link_category_id of the first
    part; first_link_of_joints: its number in joint_parents and joint_children. joint_order: the file's components that
    are the rest frame's x, y, z, each of "x", "y", "z", with "-" before it where the sign differs.
    """

    name: str
    verified: bool
    objects: tuple[ObjectFrames, ...]
    annotations: str
    color: str
    depth: str
    masks: str
    models: str
    intrinsics: str
    metres_per_unit: float
    first_link: int
    first_link_of_joints: int
    joint_order: list[str]
    splits: list[str]


@dataclass(frozen=True, slots=True)
class BopLayout:
    """verified: read and checked on real data. models: models_info.json, relative to the scene's folder. obj_ids: of
    the parts, in the order of `frames`, whose axes are in the models' frames."""

    name: str
    verified: bool
    models: str
    obj_ids: tuple[int, ...]
    frames: ObjectFrames


def require_dataset_folder(path: Path) -> None:
    """SourceError unless `path` is a folder that a layout may describe."""
    if not path.is_dir():
        raise SourceError(f"{path}: expected the folder of a data set, got {'a file' if path.exists() else 'nothing'}")
    if not any(path.iterdir()):
        raise SourceError(f"{path}: expected the folder of a data set, got an empty one")
    if (path / RECORDING_FILE).is_file():
        raise SourceError(f"{path}: this is a recording of page-edge, which needs no --layout; leave it out")


def unverified(layout: Layout | BopLayout) -> str:
    """What to say of a layout that is not verified."""
    return f"{layout.name}: this layout was never checked on real data"


def layout_names() -> list[str]:
    """Those that come with the package."""
    return sorted(entry.name.removesuffix(".toml") for entry in _folder().iterdir() if entry.name.endswith(".toml"))


def read_layout(name_or_path: str) -> Layout | BopLayout:
    """One of `layout_names`, or a .toml file of the same fields; SourceError says what is wrong with it."""
    path = Path(name_or_path)
    if path.suffix == ".toml":
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise SourceError(f"{path}: cannot read it ({error.strerror})") from error
    elif name_or_path in layout_names():
        text = (_folder() / f"{name_or_path}.toml").read_text(encoding="utf-8")
    else:
        raise SourceError(f"layout: expected one of {', '.join(layout_names())} or a .toml file, got {name_or_path!r}")
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SourceError(f"layout {name_or_path}: expected TOML ({error})") from error
    if document.get("format") == "bop":
        return _checked_bop(document, name_or_path)
    return _checked(document, name_or_path)


def _folder():
    return files("page_training.datasets") / "layouts"


_KINDS = {"str": str, "bool": bool, "int": int, "float": float, "list[str]": list, "tuple[ObjectFrames, ...]": list}


def _checked(document: dict[str, Any], where: str) -> Layout:
    known = {field.name: str(field.type) for field in fields(Layout)}
    _require_fields(document, known, where)
    for name, kind in known.items():
        value = document[name]
        number_for_float = kind == "float" and isinstance(value, int) and not isinstance(value, bool)
        if not isinstance(value, _KINDS[kind]) and not number_for_float:
            expected = "tables [[objects]]" if name == "objects" else kind
            raise SourceError(f"layout {where}, {name}: expected {expected}, got {value!r}")
    try:
        document["models"].format(folder="")
    except (KeyError, IndexError, ValueError) as error:
        raise SourceError(
            f"layout {where}, models: expected no placeholder but {{folder}}, got {document['models']!r}"
        ) from error
    require_order(document["joint_order"], where=f"layout {where}, joint_order")
    if not document["metres_per_unit"] > 0:
        raise SourceError(f"layout {where}, metres_per_unit: expected > 0, got {document['metres_per_unit']}")
    objects = tuple(
        object_frames(entry, where=f"layout {where}, objects {i}") for i, entry in enumerate(document["objects"])
    )
    read = dict(document)
    read["objects"] = objects
    return Layout(**read)


def _checked_bop(document: dict[str, Any], where: str) -> BopLayout:
    """format, name, verified, models, category, obj_ids and parts as in [[objects]]."""
    kinds = {"name": "str", "verified": "bool", "models": "str", "category": "str", "parts": "list[str]"}
    _require_fields(document, {"format", "obj_ids", *kinds}, where)
    for name, kind in kinds.items():
        if not isinstance(document[name], _KINDS[kind]):
            raise SourceError(f"layout {where}, {name}: expected {_KINDS[kind].__name__}, got {document[name]!r}")
    category = document["category"]
    entry = {"named": category, "category": category, "parts": document["parts"]}
    frames = object_frames(entry, where=f"layout {where}")
    obj_ids = document["obj_ids"]
    whole = isinstance(obj_ids, list) and all(isinstance(one, int) for one in obj_ids)
    if not whole or len(set(obj_ids)) != len(frames.parts):
        raise SourceError(f"layout {where}, obj_ids: expected {len(frames.parts)} different numbers, got {obj_ids!r}")
    return BopLayout(document["name"], document["verified"], document["models"], tuple(obj_ids), frames)


def _require_fields(document: dict[str, Any], known: Collection[str], where: str) -> None:
    if set(document) != set(known):
        missing, unknown = sorted(set(known) - set(document)), sorted(set(document) - set(known))
        raise SourceError(f"layout {where}: missing {missing or 'nothing'}, unknown {unknown or 'nothing'}")
