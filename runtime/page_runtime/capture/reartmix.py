"""ReArtMix: real RGB-D pictures with several articulated objects in each, and the poses of their parts.

Its `transformation` maps the object's rest frame to the camera, carries the instance's scale s = cbrt(det), and the
rest pose of a box is lying open flat: base and lid side by side, y along the hinge, the lid at negative x, insides up
(+z). Ours is another frame for each part (origin in the part's box, axes by function), and closed is state 0. Which
way the rest frame lies was checked on the data, not taken from words: tests/test_reartmix.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.capture.color_depth import depth_unit, folder_camera, paired_pictures, region_of_corners
from page_runtime.capture.documents import field, frame_numbers, listed, number, numbers, read_object, require_folder
from page_runtime.geometry import Array, require_rigid, transform_from
from page_runtime.image_files import SourceError
from page_runtime.joints import turned_about
from page_runtime.recorded import FrameEntry, Instance, PartTruth, Source, require_playable

FORMAT = "ReArtMix folder"
CATEGORY = "box"
PART_NAMES = ("base", "lid")
LINK_ID_OF_FIRST_PART = 1
# Columns: our x, y, z in the rest frame. The lid lies turned by 180 degrees about the hinge.
R_REST_PART = (
    np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
)


def read_reartmix(path: Path) -> Source:
    """The folder as a source with truths; every annotated object of a picture is an instance."""
    models = _models(path / "urdf_metas.json")
    require_folder(path / "annotations", holding="annotation files")
    color, depth = paired_pictures(path)
    files = {
        file.relative_to(path / "annotations").with_suffix("").as_posix(): file
        for file in sorted((path / "annotations").rglob("*.json"))
    }
    missing = sorted(set(files) - set(color))
    if missing:
        some = f"{len(missing)} of {len(files)} annotations"
        raise SourceError(f"{path}: {some} have no color/ picture, the first is {missing[0]}")
    metres_per_unit = depth_unit(path)
    entries = tuple(
        FrameEntry(
            color_path=color[name],
            depth_path=depth[name],
            metres_per_unit=metres_per_unit,
            camera=folder_camera(path, color[name]),
            instances=_instances(file, models),
            index=index,
        )
        for index, (name, file) in zip(frame_numbers(list(files)), files.items(), strict=True)
    )
    return require_playable(Source(path, FORMAT, entries, CATEGORY, PART_NAMES))


def _models(file: Path) -> dict[float, dict[str, Any]]:
    entries = listed(field(read_object(file), "urdf_metas", where=str(file)), where=f"{file}, urdf_metas")
    return {number(field(entry, "id", where=str(file)), where=f"{file}, id"): entry for entry in entries}


def _instances(file: Path, models: dict[float, dict[str, Any]]) -> tuple[Instance, ...]:
    found = []
    for i, entry in enumerate(listed(field(read_object(file), "instances", where=str(file)), where=str(file))):
        where = f"{file}, instance {i}"
        urdf_id = number(field(entry, "urdf_id", where=where), where=f"{where}, urdf_id")
        model = models.get(urdf_id)
        if model is None:
            raise SourceError(f"{where}: urdf_id {urdf_id:g} is not in urdf_metas.json")
        if model.get("category_name") != CATEGORY:
            raise SourceError(
                f"{where}: expected objects of the category {CATEGORY!r}, got {model.get('category_name')!r}, "
                "whose rest frames this reader does not know"
            )
        region = region_of_corners(field(entry, "bbox", where=where), where=f"{where}, bbox")
        try:
            found.append(Instance(region, _truths(entry, model, where=where)))
        except (TypeError, IndexError, ValueError) as error:
            if isinstance(error, SourceError):
                raise
            raise SourceError(f"{where}: not understood ({error})") from error
    return tuple(found)


def _truths(entry: dict[str, Any], model: dict[str, Any], *, where: str) -> tuple[PartTruth, ...]:
    links = {
        number(field(link, "link_category_id", where=where), where=f"{where}, link_category_id"): link
        for link in listed(field(entry, "links", where=where), where=f"{where}, links")
    }
    placed = []
    for k, name in enumerate(PART_NAMES):
        link = links.get(k + LINK_ID_OF_FIRST_PART)
        if link is None:
            raise SourceError(f"{where}: no link with link_category_id {k + LINK_ID_OF_FIRST_PART} ({name})")
        matrix = np.array([
            numbers(row, 4, where=f"{where}, {name}, transformation")
            for row in field(link, "transformation", where=where)
        ])  # fmt: skip
        corners = np.array(field(model, "corner_pts", where=where), dtype=float)[k + 1].reshape(2, 3)
        if not np.isfinite(corners).all():
            raise SourceError(f"{where}: expected finite corner_pts in urdf_metas.json, got {corners.tolist()}")
        placed.append(part_from_rest(matrix, corners, R_REST_PART[k], where=f"{where}, {name}"))
    state = opening_angle(placed[0][0][:3, :3], placed[1][0][:3, :3])
    states = (None, state)
    return tuple(
        PartTruth(name, T_camera_part, extents_m, visible_share=None, joint_state=joint_state)
        for name, (T_camera_part, extents_m), joint_state in zip(PART_NAMES, placed, states, strict=True)
    )


def part_from_rest(matrix: Array, corners_rest: Array, R_rest_part: Array, *, where: str) -> tuple[Array, Array]:
    """T_camera_part (4,4) and extents_m (3,) in our canonical axes.

    matrix: (4,4) rest frame to camera with the scale in it. corners_rest: (2,3) smallest and largest corner of the
    part's box in the rest frame, metres before scaling. R_rest_part: (3,3) our axes in the rest frame.
    """
    if matrix.shape != (4, 4) or not np.linalg.det(matrix[:3, :3]) > 0:
        raise SourceError(f"{where}: expected a 4x4 similarity transform, got {matrix.tolist()}")
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    R_camera_rest = matrix[:3, :3] / scale
    center_camera = matrix[:3, :3] @ corners_rest.mean(axis=0) + matrix[:3, 3]
    T_camera_part = transform_from(R_camera_rest @ R_rest_part, center_camera)
    try:
        T_camera_part = require_rigid(T_camera_part, name=f"{where}, transformation without its scale")
    except ValueError as error:
        raise SourceError(str(error)) from error
    return T_camera_part, scale * np.abs(R_rest_part.T @ (corners_rest[1] - corners_rest[0]))


def opening_angle(R_camera_base: Array, R_camera_lid: Array) -> float:
    """Angle, rad, by which the lid is turned from closed about -x of the base; in (-pi/2, 3 pi/2]."""
    angle = turned_about(np.array([-1.0, 0.0, 0.0]), R_camera_base.T @ R_camera_lid)
    return angle if angle > -np.pi / 2 else angle + 2 * np.pi
