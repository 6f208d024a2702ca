"""Open recorded frames, whatever their format, which the path itself tells."""

from __future__ import annotations

from pathlib import Path

from page_runtime.capture.bop import read_bop
from page_runtime.capture.color_depth import INTRINSICS_FILE, read_color_depth
from page_runtime.capture.color_video import VIDEO_NAMES, color_video, read_color_video
from page_runtime.capture.depthai_mcap import is_depthai, read_depthai
from page_runtime.capture.documents import found_in
from page_runtime.capture.layouts import WINDOW_S
from page_runtime.capture.mcap_file import McapFile
from page_runtime.capture.own_recording import read_recording
from page_runtime.capture.reartmix import read_reartmix
from page_runtime.capture.ros_bag import SqliteFile, bag_files, read_stores
from page_runtime.capture.ros_topics import MessageStore
from page_runtime.capture.sensor_recordings import is_kinect_video, is_realsense_bag, read_kinect, read_realsense
from page_runtime.capture.tum import is_tum, read_tum
from page_runtime.image_files import SourceError
from page_runtime.recorded import Source
from page_runtime.recording import RECORDING_FILE

UNDERSTOOD = (
    f"a page-edge recording ({RECORDING_FILE}, rgb/, depth/, scene_camera.json), "
    "a BOP scene (rgb/, depth/, scene_camera.json), "
    "a TUM RGB-D sequence (rgb.txt, depth.txt), "
    "ReArtMix (annotations/, color/, depth/, urdf_metas.json), "
    f"colour and depth pictures (color/, depth/, {INTRINSICS_FILE}), "
    f"a colour video and depth pictures ({VIDEO_NAMES[0]}, depth/, {INTRINSICS_FILE}), "
    "a ROS 2 bag or depthai recording (.mcap, .db3, or a folder of them), "
    "a RealSense recording (.bag), "
    "an Azure Kinect recording (.mkv)"
)


def open_source(path: Path | str, *, window_s: float = WINDOW_S) -> Source:
    """The frames in the folder or file `path`, checked whole; window_s: of the pairing, where readings are stored.

    SourceError says what is wrong and what would be understood.
    """
    place = Path(path)
    if not place.exists():
        raise SourceError(f"{place}: no such folder or file")
    if place.is_dir() and not any(place.iterdir()):
        raise SourceError(f"{place}: the folder is empty; expected {UNDERSTOOD}")
    source = _read_file(place, window_s) if place.is_file() else _read_folder(place, window_s)
    if source is None:
        found = found_in(place) if place.is_dir() else "a file of another kind"
        raise SourceError(f"{place}: expected {UNDERSTOOD}; found {found}")
    return source


def _read_folder(folder: Path, window_s: float) -> Source | None:
    def has(*names: str) -> bool:
        return any((folder / name).exists() for name in names)

    if has(RECORDING_FILE):
        return read_recording(folder)
    if bag_files(folder):
        return _read_messages(folder, window_s)
    if has("metadata.yaml"):
        raise SourceError(f"{folder}: a ROS 2 bag without its .mcap or .db3 file; decompress or copy that too")
    if has("scene_camera.json"):
        return read_bop(folder)
    if is_tum(folder):
        return read_tum(folder, window_s=window_s)
    if has("rgb"):
        return read_bop(folder)
    if has("annotations") and has("color", "urdf_metas.json"):
        return read_reartmix(folder)
    if color_video(folder) is not None:
        return read_color_video(folder)
    if has("color", INTRINSICS_FILE):
        return read_color_depth(folder)
    return None


def _read_file(file: Path, window_s: float) -> Source | None:
    if bag_files(file):
        return _read_messages(file, window_s)
    if is_realsense_bag(file):
        return read_realsense(file)
    if is_kinect_video(file):
        return read_kinect(file)
    return None


def _read_messages(path: Path, window_s: float) -> Source:
    files = bag_files(path)
    stores: list[MessageStore] = [McapFile(f) if f.suffix.lower() == ".mcap" else SqliteFile(f) for f in files]
    recorded = [store for store in stores if isinstance(store, McapFile)]
    if len(recorded) == len(stores) and is_depthai(recorded):
        return read_depthai(path, recorded, window_s=window_s)
    return read_stores(path, stores, window_s=window_s)
