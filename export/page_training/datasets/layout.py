"""How an annotated data set lies on disk: a TOML file, so that another one needs no code.

The form is that of ArtImage, ReArtMix and what is made like them: a JSON file a picture with the objects in it and the
matrices of their links, and urdf_metas.json with each object's part boxes and joints in its rest frame.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path

import numpy as np

from page_runtime.geometry import Array
from page_runtime.image_files import SourceError

POLYGONS = "polygons"
AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Layout:
    """Folders and files are relative to the data set's; {folder} in `models` is that folder's name.

    verified: read and checked on real data. masks: "polygons" of each link, or a folder of pictures whose first channel
    is the part's index where there is depth. metres_per_unit: of the depth pictures. first_link: link_category_id of
    the first part; first_link_of_joints: its number in joint_parents and joint_children. joint_order: the file's
    components that are our x, y, z, each of "x", "y", "z", with "-" before it where the sign differs.
    """

    name: str
    verified: bool
    categories: list[str]
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

    @property
    def joint_map(self) -> Array:
        """(3,3) from the file's components to ours."""
        return signed_permutation(self.joint_order)


def signed_permutation(order: list[str]) -> Array:
    """(3,3) of components like ["y", "-z", "x"]."""
    matrix = np.zeros((3, 3))
    for row, name in zip(matrix, order, strict=True):
        row[AXES.index(name.removeprefix("-"))] = -1.0 if name.startswith("-") else 1.0
    return matrix


def layout_names() -> list[str]:
    """Those that come with the package."""
    return sorted(entry.name.removesuffix(".toml") for entry in _folder().iterdir() if entry.name.endswith(".toml"))


def read_layout(name_or_path: str) -> Layout:
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
    return _checked(document, name_or_path)


def _folder():
    return files("page_training.datasets") / "layouts"


def _checked(document: dict, where: str) -> Layout:
    known = {field.name: str(field.type) for field in fields(Layout)}
    if set(document) != set(known):
        missing, unknown = sorted(set(known) - set(document)), sorted(set(document) - set(known))
        raise SourceError(f"layout {where}: missing {missing or 'nothing'}, unknown {unknown or 'nothing'}")
    kinds = {"str": str, "bool": bool, "int": int, "float": float, "list[str]": list}
    for name, kind in known.items():
        value = document[name]
        number_for_float = kind == "float" and isinstance(value, int) and not isinstance(value, bool)
        if not isinstance(value, kinds[kind]) and not number_for_float:
            raise SourceError(f"layout {where}, {name}: expected {kind}, got {value!r}")
    try:
        document["models"].format(folder="")
    except (KeyError, IndexError, ValueError) as error:
        raise SourceError(
            f"layout {where}, models: expected no placeholder but {{folder}}, got {document['models']!r}"
        ) from error
    order = document["joint_order"]
    if sorted(str(name).removeprefix("-") for name in order) != list(AXES):
        raise SourceError(f"layout {where}, joint_order: expected x, y and z in some order, got {order}")
    if not document["metres_per_unit"] > 0:
        raise SourceError(f"layout {where}, metres_per_unit: expected > 0, got {document['metres_per_unit']}")
    return Layout(**document)
