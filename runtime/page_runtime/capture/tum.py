"""TUM RGB-D sequences: rgb/, depth/ and their lists with a timestamp for each picture, paired within the window.

rgb.txt and depth.txt hold "timestamp path" lines; where they are missing, associations.txt holds both in a line. Depth
is 5000 units a metre and registered to colour. The camera is camera_intrinsic.json where there is one (Open3D's, as in
plain folders, which may give another depth_scale); otherwise, in folders named freiburg1, 2 or 3, the benchmark's own
calibration, with the lens distortion taken out.
Format and calibration: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from page_runtime.camera import Camera
from page_runtime.capture.color_depth import INTRINSICS_FILE, depth_unit, folder_camera
from page_runtime.capture.documents import read_object
from page_runtime.capture.pairing import Stream, pair_recorded
from page_runtime.capture.undistortion import lens_of, undistorted
from page_runtime.image_files import SourceError, read_color, read_depth, read_header
from page_runtime.lens import NO_DISTORTION, Distortion
from page_runtime.recorded import FrameEntry, Pixels, Source, camera_of_picture, require_playable

FORMAT = "TUM RGB-D sequence"
METRES_PER_UNIT = 1 / 5000
LISTS = ("rgb.txt", "depth.txt")
ASSOCIATIONS = ("associations.txt", "associate.txt", "associated.txt")
# fx, fy, cx, cy and k1, k2, p1, p2, k3 of the colour cameras, as the benchmark publishes them.
CALIBRATIONS = {
    "freiburg1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": ((535.4, 539.2, 320.1, 247.6), ()),
}


def is_tum(path: Path) -> bool:
    """Whether the folder has TUM's lists."""
    return all((path / name).is_file() for name in LISTS) or any((path / name).is_file() for name in ASSOCIATIONS)


def read_tum(path: Path, *, window_s: float) -> Source:
    """The sequence as a source, without truths."""
    readings: list[tuple[float, Stream, Path]] = []
    associations = next((path / name for name in ASSOCIATIONS if (path / name).is_file()), None)
    if all((path / name).is_file() for name in LISTS):
        streams: tuple[tuple[str, Stream], ...] = (("rgb.txt", "color"), ("depth.txt", "depth"))
        for name, stream in streams:
            for place, (stamp, file) in _lines(path / name, columns=2):
                readings.append((_stamp(stamp, where=place), stream, path / file))
    elif associations is not None:
        for place, (color_s, color, depth_s, depth) in _lines(associations, columns=4):
            readings.append((_stamp(color_s, where=place), "color", path / color))
            readings.append((_stamp(depth_s, where=place), "depth", path / depth))
    pairs, counts = pair_recorded(readings, window_s=window_s)
    if not pairs:
        raise SourceError(f"{path}: no frames in this {FORMAT}")
    has_intrinsics = (path / INTRINSICS_FILE).is_file()
    has_scale = has_intrinsics and "depth_scale" in read_object(path / INTRINSICS_FILE)
    metres_per_unit = depth_unit(path) if has_scale else METRES_PER_UNIT
    entries = []
    for index, pair in enumerate(pairs):
        camera, distortion = (folder_camera(path, pair.color), None) if has_intrinsics else _known(path, pair.color)
        decode = None
        if distortion is not None:
            decode = partial(_decode, pair.color, pair.depth, metres_per_unit, camera, distortion)
        entries.append(
            FrameEntry(
                color_path=pair.color,
                depth_path=pair.depth,
                metres_per_unit=metres_per_unit,
                camera=camera,
                timestamp_s=pair.timestamp_s,
                index=index,
                skew_s=pair.skew_s,
                decode=decode,
            )
        )
    return require_playable(Source(path, FORMAT, tuple(entries), pairing=counts))


def _lines(file: Path, *, columns: int) -> list[tuple[str, list[str]]]:
    """(place, columns) of every line that is no comment."""
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"{file}: cannot read it ({error})") from error
    found = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < columns or "\0" in line:
            raise SourceError(f"{file}, line {number}: expected {columns} columns, got {line.strip()!r}")
        found.append((f"{file}, line {number}", words[:columns]))
    return found


def _stamp(text: str, *, where: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise SourceError(f"{where}: expected a time in seconds, got {text!r}") from error


def _known(path: Path, color: Path) -> tuple[Camera, Distortion]:
    """The benchmark's calibration by the sequence's name."""
    for name, ((fx, fy, cx, cy), coefficients) in CALIBRATIONS.items():
        if name in path.resolve().name:
            K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
            camera = camera_of_picture(K, color, where=str(path), declared_size=(640, 480))
            return camera, lens_of("plumb_bob", coefficients, where=name) if coefficients else NO_DISTORTION
    raise SourceError(
        f"{path}: no {INTRINSICS_FILE}, and the folder's name has none of {', '.join(CALIBRATIONS)} in it; "
        "write width, height and intrinsic_matrix (column by column) into that file"
    )


def _decode(
    color_path: Path, depth_path: Path, metres_per_unit: float, camera: Camera, distortion: Distortion
) -> Pixels:
    header = read_header(color_path)
    if (header.width, header.height) != (camera.width, camera.height):
        raise SourceError(f"{color_path}: expected {camera.width}x{camera.height} like the first, got {header}")
    return undistorted(
        read_color(color_path), read_depth(depth_path, metres_per_unit=metres_per_unit), camera, distortion
    )
