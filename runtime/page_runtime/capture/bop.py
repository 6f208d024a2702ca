"""Folders of one BOP scene ("scenewise" format): rgb/, depth/, scene_camera.json and, where known, scene_gt*.json.

BOP says neither what the parts of an object are nor how their canonical frames lie, so a foreign scene gives regions
(one instance for each entry of scene_gt_info.json) and no truths. The project's own recordings say it in
recording.json. A timestamp_s in scene_camera.json, which BOP does not know either, is read where it is there.
Format: https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.camera import Camera
from page_runtime.capture.documents import (
    METRES_PER_MM,
    field,
    listed,
    number,
    numbers,
    pictures,
    read_object,
    require_folder,
)
from page_runtime.geometry import Array, transform_from
from page_runtime.image_files import SourceError
from page_runtime.recorded import (
    FrameEntry,
    Instance,
    Refuse,
    Source,
    camera_of_picture,
    refuse,
    require_playable,
)
from page_runtime.sampling import Region

FORMAT = "BOP scene folder"


@dataclass(frozen=True, slots=True)
class BopScene:
    """A scene folder with its documents read; keys are frame numbers, the same in `cameras`, `color` and `depth`."""

    path: Path
    color: dict[int, Path]
    depth: dict[int, Path]
    cameras: dict[int, Any]
    gt: dict[int, Any]
    gt_info: dict[int, Any]

    def entry(self, key: int, *, declared_size: tuple[int, int] | None = None) -> FrameEntry:
        """Frame `key` without instances; declared_size: (width, height) that K is said to be for."""
        where = f"{self.path / 'scene_camera.json'}, frame {key}"
        values = self.cameras[key]
        if not isinstance(values, dict) or values.get("depth_scale") is None:
            raise SourceError(f"{where}: depth without a scale; expected 'depth_scale', mm per unit of depth")
        scale_mm = number(values["depth_scale"], where=f"{where}, depth_scale")
        K = numbers(field(values, "cam_K", where=where), 9, where=f"{where}, cam_K")
        camera = camera_of_picture(K, self.color[key], where=where, declared_size=declared_size)
        return FrameEntry(
            color_path=self.color[key],
            depth_path=self.depth[key],
            metres_per_unit=scale_mm * METRES_PER_MM,
            camera=_placed(camera, values, where=where),
            timestamp_s=number(values.get("timestamp_s", 0.0), where=f"{where}, timestamp_s"),
            index=key,
        )

    def entries(self, entry_of: Callable[[BopScene, int], FrameEntry], on_problem: Refuse) -> tuple[FrameEntry, ...]:
        """`entry_of` this scene and each frame's number; on_problem hears of those for which it raises SourceError."""
        found = []
        for key in self.cameras:
            try:
                found.append(entry_of(self, key))
            except SourceError as error:
                on_problem(error)
        return tuple(found)


def open_scene(path: Path, on_problem: Refuse = refuse) -> BopScene:
    """Read a scene folder's documents; on_problem hears where pictures and documents do not name the same frames, and
    those frames are left out. SourceError where nothing can be read."""
    color = _by_number(require_folder(path / "rgb", holding="colour pictures 000000.png ..."))
    depth = _by_number(require_folder(path / "depth", holding="16-bit depth pictures 000000.png ..."))
    if not color:
        raise SourceError(f"{path / 'rgb'}: no pictures; expected 000000.png ...")
    if not (path / "scene_camera.json").is_file():
        raise SourceError(f"{path}: no scene_camera.json; expected cam_K and depth_scale of every frame in it")
    cameras = _numbered(path, "scene_camera.json")
    for place, present, wanted in (
        ("in scene_camera.json", cameras, color),
        ("in rgb/", color, cameras),
        ("in depth/", depth, cameras),
    ):
        missing = sorted(set(wanted) - set(present))
        if missing:
            some = f"{len(missing)} of {len(wanted)} frames"
            on_problem(SourceError(f"{path}: {some} are not {place}, the first is {missing[0]}"))
    cameras = {key: cameras[key] for key in sorted(set(cameras) & set(color) & set(depth))}
    gt, gt_info = (
        _numbered(path, name) if (path / name).exists() else {} for name in ("scene_gt.json", "scene_gt_info.json")
    )
    return BopScene(path, color, depth, cameras, gt, gt_info)


def _by_number(folder: Path) -> dict[int, Path]:
    return {int(name): file for name, file in pictures(folder).items() if name.isascii() and name.isdigit()}


def _numbered(path: Path, name: str) -> dict[int, Any]:
    try:
        return {int(key): value for key, value in read_object(path / name).items()}
    except ValueError as error:
        if isinstance(error, SourceError):
            raise
        raise SourceError(f"{path / name}: expected frame numbers as keys ({error})") from error


def read_bop(path: Path, on_problem: Refuse = refuse) -> Source:
    """The scene folder as a source, without truths; on_problem hears of every frame that cannot be read."""
    scene = open_scene(path, on_problem)
    return require_playable(Source(path, FORMAT, scene.entries(_with_regions, on_problem)), on_problem)


def _with_regions(scene: BopScene, key: int) -> FrameEntry:
    where = f"{scene.path / 'scene_gt_info.json'}, frame {key}"
    regions = (visible_box(info, where=where) for info in listed(scene.gt_info.get(key, []), where=where))
    return replace(scene.entry(key), instances=tuple(Instance(region) for region in regions if region is not None))


def visible_box(info: Any, *, where: str) -> Region | None:
    """bbox_visib (x,y,w,h) px of a scene_gt_info entry, None for what cannot be seen (BOP: -1, or no size)."""
    box = info.get("bbox_visib") if isinstance(info, dict) else None
    if box is None:
        return None
    x, y, width, height = (round(value) for value in numbers(box, 4, where=f"{where}, bbox_visib"))
    return (x, y, width, height) if width > 0 and height > 0 else None


def pose_of(entry: Any, *, where: str) -> Array:
    """T_camera_part (4,4), metres, from cam_R_m2c and cam_t_m2c (mm) of a scene_gt entry."""
    return _transform(entry, "cam_R_m2c", "cam_t_m2c", where=where)


def _transform(entry: Any, rotation: str, translation: str, *, where: str) -> Array:
    R = np.reshape(numbers(field(entry, rotation, where=where), 9, where=f"{where}, {rotation}"), (3, 3))
    t_mm = np.array(numbers(field(entry, translation, where=where), 3, where=f"{where}, {translation}"))
    return transform_from(R, t_mm * METRES_PER_MM)


def _placed(camera: Camera, entry: dict[str, Any], *, where: str) -> Camera:
    """The camera with T_camera_world where the entry has it."""
    if "cam_R_w2c" not in entry:
        return camera
    try:
        return replace(camera, T_camera_world=_transform(entry, "cam_R_w2c", "cam_t_w2c", where=where))
    except ValueError as error:
        raise SourceError(f"{where}: {error}") from error
