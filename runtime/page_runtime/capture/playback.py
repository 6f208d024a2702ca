"""Open a folder of recorded frames, whatever its format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from page_runtime.capture.bop import read_bop
from page_runtime.capture.color_depth import INTRINSICS_FILE, read_color_depth
from page_runtime.capture.documents import found_in
from page_runtime.capture.reartmix import read_reartmix
from page_runtime.image_files import SourceError
from page_runtime.recorded import Source
from page_runtime.recording import RECORDING_FILE, read_recording

UNDERSTOOD = (
    f"a page-edge recording ({RECORDING_FILE}, rgb/, depth/, scene_camera.json), "
    "a BOP scene (rgb/, depth/, scene_camera.json), "
    "ReArtMix (annotations/, color/, depth/, urdf_metas.json), "
    f"colour and depth pictures (color/, depth/, {INTRINSICS_FILE})"
)


def open_source(path: Path | str) -> Source:
    """The frames in folder `path`, checked whole; SourceError says what is wrong and what would be understood."""
    folder = Path(path)
    if not folder.exists():
        raise SourceError(f"{folder}: no such folder")
    if not folder.is_dir():
        raise SourceError(f"{folder}: expected a folder, got a file; understood are {UNDERSTOOD}")
    if not any(folder.iterdir()):
        raise SourceError(f"{folder}: the folder is empty; understood are {UNDERSTOOD}")
    reader = _reader(folder)
    if reader is None:
        raise SourceError(f"{folder}: expected {UNDERSTOOD}; found {found_in(folder)}")
    return reader(folder)


def _reader(folder: Path) -> Callable[[Path], Source] | None:
    def has(*names: str) -> bool:
        return any((folder / name).exists() for name in names)

    if has(RECORDING_FILE):
        return read_recording
    if has("scene_camera.json", "rgb"):
        return read_bop
    if has("annotations") and has("color", "urdf_metas.json"):
        return read_reartmix
    if has("color", INTRINSICS_FILE):
        return read_color_depth
    return None
