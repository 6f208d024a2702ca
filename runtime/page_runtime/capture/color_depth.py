"""A plain folder of RGB-D pictures: color/, depth/, camera_intrinsic.json and, where known, det_bboxes.json.

What RealSense and Open3D recorders leave behind. camera_intrinsic.json is Open3D's: width, height, intrinsic_matrix of
nine numbers column by column; depth is in millimetres unless it has a `depth_scale` (mm per unit). det_bboxes.json is a
list of {"image_file_name", "bbox": [x1, y1, x2, y2]}, any number for each picture. timestamps_s.txt, where it is there,
has the time of each picture, one a line, in order of their names.
"""

from __future__ import annotations

from pathlib import Path

from page_runtime.camera import Camera
from page_runtime.capture.documents import (
    METRES_PER_MM,
    field,
    frame_numbers,
    frame_times,
    listed,
    number,
    numbers,
    pictures,
    read_json,
    read_object,
    require_folder,
)
from page_runtime.image_files import SourceError
from page_runtime.recorded import FrameEntry, Instance, Source, camera_of_picture, require_playable
from page_runtime.sampling import Region

FORMAT = "folder of colour and depth pictures"
INTRINSICS_FILE = "camera_intrinsic.json"
BOXES_FILE = "det_bboxes.json"


def read_color_depth(path: Path) -> Source:
    """The folder as a source, without truths."""
    color, depth = paired_pictures(path)
    boxes = _boxes(path / BOXES_FILE) if (path / BOXES_FILE).exists() else {}
    metres_per_unit = depth_unit(path)
    unknown = sorted(set(boxes) - {file.name for file in color.values()})
    if unknown:
        raise SourceError(f"{path / BOXES_FILE}: {unknown[0]!r} is not a picture in color/")
    times_s = frame_times(path, len(color)) or [0.0] * len(color)
    entries = tuple(
        FrameEntry(
            color_path=file,
            depth_path=depth[name],
            metres_per_unit=metres_per_unit,
            camera=folder_camera(path, file),
            instances=tuple(Instance(region) for region in boxes.get(file.name, ())),
            timestamp_s=time_s,
            index=index,
        )
        for index, (name, file), time_s in zip(frame_numbers(list(color)), color.items(), times_s, strict=True)
    )
    return require_playable(Source(path, FORMAT, entries))


def paired_pictures(path: Path) -> tuple[dict[str, Path], dict[str, Path]]:
    """Pictures in color/ and depth/ by name; SourceError when one has no partner."""
    color = pictures(require_folder(path / "color", holding="colour pictures"))
    depth = pictures(require_folder(path / "depth", holding="16-bit depth pictures of the same names"))
    if not color:
        raise SourceError(f"{path / 'color'}: no pictures; expected .png or .jpg")
    missing = sorted(set(color) - set(depth))
    if missing:
        some = f"{len(missing)} of {len(color)} pictures"
        raise SourceError(f"{path}: {some} have no depth/ picture, the first is {missing[0]}")
    return color, depth


def folder_camera(path: Path, color_path: Path) -> Camera:
    """The camera of one picture by the folder's camera_intrinsic.json."""
    rows, size = folder_intrinsics(path)
    return camera_of_picture(rows, color_path, where=str(path / INTRINSICS_FILE), declared_size=size)


def folder_intrinsics(path: Path) -> tuple[list[list[float]], tuple[int, int]]:
    """K, row by row, and the (width, height) it is for, from the folder's camera_intrinsic.json."""
    file = path / INTRINSICS_FILE
    if not file.is_file():
        raise SourceError(f"{path}: no {INTRINSICS_FILE}; expected width, height and intrinsic_matrix in it")
    document = read_object(file)
    size = numbers([field(document, name, where=str(file)) for name in ("width", "height")], 2, where=f"{file}, size")
    columns = numbers(field(document, "intrinsic_matrix", where=str(file)), 9, where=f"{file}, intrinsic_matrix")
    return [columns[i::3] for i in range(3)], (round(size[0]), round(size[1]))


def depth_unit(path: Path) -> float:
    """Metres of one unit of the folder's depth pictures."""
    file = path / INTRINSICS_FILE
    scale = read_object(file).get("depth_scale", 1.0) if file.is_file() else 1.0
    return number(scale, where=f"{file}, depth_scale") * METRES_PER_MM


def _boxes(file: Path) -> dict[str, list[Region]]:
    boxes: dict[str, list[Region]] = {}
    for i, entry in enumerate(listed(read_json(file), where=str(file))):
        where = f"{file}, entry {i}"
        region = region_of_corners(field(entry, "bbox", where=where), where=f"{where}, bbox")
        boxes.setdefault(str(field(entry, "image_file_name", where=where)), []).append(region)
    return boxes


def region_of_corners(box: object, *, where: str) -> Region:
    """(x,y,w,h) px of a box [x1, y1, x2, y2]."""
    x1, y1, x2, y2 = (round(value) for value in numbers(box, 4, where=where))
    return x1, y1, x2 - x1, y2 - y1
