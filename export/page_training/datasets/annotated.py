"""Reading annotated data sets: every picture with its objects, what cannot be read named and left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.camera import Camera
from page_runtime.capture.color_depth import region_of_corners
from page_runtime.capture.documents import field, listed, number, numbers, pictures, read_object, require_folder
from page_runtime.geometry import Array
from page_runtime.image_files import SourceError
from page_runtime.recorded import camera_of_picture
from page_runtime.sampling import Region
from page_training.datasets.layout import POLYGONS, Layout


@dataclass(frozen=True, eq=False, slots=True)
class ModelJoint:
    """A joint as the file has it. parent, child: parts from 0; origin, axis: (3,), components in the file's order."""

    kind: str
    parent: int
    child: int
    origin: Array
    axis: Array


@dataclass(frozen=True, eq=False, slots=True)
class ObjectModel:
    """corners: (K,2,3) smallest and largest corner of each part's box in the rest frame, metres."""

    identity: int
    category: str
    corners: Array
    joints: tuple[ModelJoint, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Link:
    """identity: link_category_id as it is in the file. matrix: (4,4) rest frame to camera, whatever it carries.
    state: as it is in the file, None without one. polygons: (n,2) px each."""

    identity: int
    matrix: Array
    state: float | None
    polygons: tuple[NDArray[np.float64], ...]


@dataclass(frozen=True, eq=False, slots=True)
class AnnotatedInstance:
    model: int
    region: Region
    links: tuple[Link, ...]


@dataclass(frozen=True, eq=False, slots=True)
class AnnotatedFrame:
    """name: as in the split files. label_path: of its mask picture, None where links have polygons."""

    name: str
    file: Path
    color_path: Path
    depth_path: Path
    label_path: Path | None
    camera: Camera
    instances: tuple[AnnotatedInstance, ...]

    def place(self, instance: int) -> str:
        """Where an instance is written, for people."""
        return f"{self.file}, instance {instance}"

    def mask(self, instance: int, link: int, first_link: int) -> NDArray[np.bool_]:
        """(H,W): where a link of an instance is marked; SourceError where its picture cannot be read."""
        shape = self.camera.height, self.camera.width
        one = self.instances[instance].links[link]
        if self.label_path is None:
            marked = np.zeros(shape, np.uint8)
            for polygon in one.polygons:
                cv2.fillPoly(marked, [np.round(polygon).astype(np.int32)], (1,))
            return marked > 0
        labels = cv2.imread(str(self.label_path), cv2.IMREAD_UNCHANGED)
        if labels is None or labels.shape[:2] != shape:
            raise SourceError(f"{self.label_path}: expected a {shape[1]}x{shape[0]} picture of part indices")
        return np.asarray((labels if labels.ndim == 2 else labels[..., 0]) == one.identity - first_link)


@dataclass(frozen=True, eq=False, slots=True)
class Annotated:
    """A data set as read. problems: what was left out, each with its file. splits: names in each split file."""

    path: Path
    layout: Layout
    models: dict[int, ObjectModel]
    frames: tuple[AnnotatedFrame, ...]
    problems: tuple[str, ...]
    splits: dict[str, tuple[str, ...]]


def read_annotated(path: Path, layout: Layout, on_frame: Callable[[], None] = lambda: None) -> Annotated:
    """The data set in folder `path`. SourceError where nothing of it can be read; a file that cannot is a problem."""
    folder = require_folder(path / layout.annotations, holding="annotation files")
    models = _models(path / layout.models.format(folder=path.resolve().name), layout)
    color = pictures(require_folder(path / layout.color, holding="colour pictures"))
    depth = pictures(require_folder(path / layout.depth, holding="depth pictures"))
    labels = (
        None if layout.masks == POLYGONS else pictures(require_folder(path / layout.masks, holding="mask pictures"))
    )
    intrinsics = _Intrinsics(path / layout.intrinsics)
    frames, problems = [], []
    for file in sorted(folder.rglob("*.json")):
        name = file.relative_to(folder).with_suffix("").as_posix()
        try:
            for kind, found in (("colour", color), ("depth", depth), ("mask", labels)):
                if found is not None and name not in found:
                    raise SourceError(f"{file}: no {kind} picture of this name")
            frames.append(
                AnnotatedFrame(
                    name=name,
                    file=file,
                    color_path=color[name],
                    depth_path=depth[name],
                    label_path=None if labels is None else labels[name],
                    camera=intrinsics.camera(color[name]),
                    instances=_instances(file, models),
                )
            )
        except SourceError as error:
            problems.append(str(error))
        on_frame()
    if not frames:
        raise SourceError(
            f"{folder}: not one annotation of {layout.name} in it" + "".join(f"; {p}" for p in problems[:1])
        )
    splits = {
        split: tuple(line.split()[0] for line in (path / split).read_text().splitlines() if line.split())
        for split in layout.splits
        if (path / split).is_file()
    }
    return Annotated(path, layout, models, tuple(frames), tuple(problems), splits)


class _Intrinsics:
    """Open3D's camera_intrinsic.json: K column by column, for pictures of its size."""

    def __init__(self, file: Path) -> None:
        document = read_object(file)
        self.file = file
        self.size = numbers(
            [field(document, name, where=str(file)) for name in ("width", "height")], 2, where=str(file)
        )
        columns = numbers(field(document, "intrinsic_matrix", where=str(file)), 9, where=f"{file}, intrinsic_matrix")
        self.rows = [columns[i::3] for i in range(3)]

    def camera(self, color_path: Path) -> Camera:
        declared = round(self.size[0]), round(self.size[1])
        return camera_of_picture(self.rows, color_path, where=str(self.file), declared_size=declared)


def _models(file: Path, layout: Layout) -> dict[int, ObjectModel]:
    models = {}
    for entry in listed(field(read_object(file), "urdf_metas", where=str(file)), where=f"{file}, urdf_metas"):
        identity = round(number(field(entry, "id", where=str(file)), where=f"{file}, id"))
        where = f"{file}, object {identity}"
        try:
            corners = np.array(field(entry, "corner_pts", where=where), dtype=float).reshape(-1, 2, 3)[1:]
            parts = [
                [
                    int(part) - layout.first_link_of_joints
                    for part in listed(field(entry, name, where=where), where=where)
                ]
                for name in ("joint_parents", "joint_children")
            ]
            places = [np.array(field(entry, name, where=where), dtype=float) for name in ("joint_xyz", "joint_rpy")]
            kinds = [str(kind) for kind in listed(field(entry, "joint_types", where=where), where=where)]
            joints = tuple(
                ModelJoint(kind, parent, child, origin.reshape(3), axis.reshape(3))
                for kind, parent, child, origin, axis in zip(kinds, *parts, *places, strict=True)
            )
        except (TypeError, ValueError) as error:
            raise SourceError(f"{where}: not understood ({error})") from error
        if not np.isfinite(corners).all() or (corners[:, 1] < corners[:, 0]).any():
            raise SourceError(f"{where}, corner_pts: expected smallest and largest corners, got {corners.tolist()}")
        if any(not 0 <= part < len(corners) for joint in joints for part in (joint.parent, joint.child)):
            raise SourceError(
                f"{where}: joints name parts beyond the {len(corners)} there are; first_link_of_joints is "
                f"{layout.first_link_of_joints} in the layout"
            )
        models[identity] = ObjectModel(identity, str(entry.get("category_name")), corners, joints)
    return models


def _instances(file: Path, models: dict[int, ObjectModel]) -> tuple[AnnotatedInstance, ...]:
    found = []
    for i, entry in enumerate(listed(field(read_object(file), "instances", where=str(file)), where=str(file))):
        where = f"{file}, instance {i}"
        model = round(number(field(entry, "urdf_id", where=where), where=f"{where}, urdf_id"))
        if model not in models:
            raise SourceError(f"{where}: urdf_id {model} is not among the models")
        region = region_of_corners(field(entry, "bbox", where=where), where=f"{where}, bbox")
        links = tuple(
            _link(link, where=f"{where}, link {n}")
            for n, link in enumerate(listed(field(entry, "links", where=where), where=f"{where}, links"))
        )
        found.append(AnnotatedInstance(model, region, links))
    return tuple(found)


def _link(entry: Any, *, where: str) -> Link:
    identity = round(number(field(entry, "link_category_id", where=where), where=f"{where}, link_category_id"))
    rows = listed(field(entry, "transformation", where=where), where=f"{where}, transformation")
    if len(rows) != 4:
        raise SourceError(f"{where}, transformation: expected four rows, got {len(rows)}")
    matrix = np.array([numbers(row, 4, where=f"{where}, transformation") for row in rows])
    state = entry.get("state")
    polygons = []
    for polygon in listed(entry.get("segmentation") or [], where=f"{where}, segmentation"):
        values = listed(polygon, where=f"{where}, segmentation")
        corners = np.reshape(numbers(values, len(values) // 2 * 2, where=f"{where}, segmentation"), (-1, 2))
        # Two corners have no inside.
        if len(corners) > 2:
            polygons.append(corners)
    return Link(identity, matrix, None if state is None else number(state, where=f"{where}, state"), tuple(polygons))
