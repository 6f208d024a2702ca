"""The overlay as pictures, one a result."""

from __future__ import annotations

from pathlib import Path

from page_runtime.image_files import PNG_FAST, write_color
from page_runtime.live.result import LiveResult
from page_runtime.sinks.picture import picture_of


class OverlayFolder:
    """000012.png for the result of frame 12, in a new or empty folder, each whole as soon as it is there."""

    def __init__(self, path: Path) -> None:
        """FileExistsError when the folder holds something."""
        path.mkdir(exist_ok=True)
        if any(path.iterdir()):
            raise FileExistsError(f"{path}: expected a new or empty folder")
        self._path, self.name = path, f"overlay {path}"

    def write(self, result: LiveResult) -> None:
        """Write one picture; OSError when the disk takes no more."""
        partial = self._path / f".{result.frame.index:06d}.png"
        write_color(partial, picture_of(result), effort=PNG_FAST)
        partial.replace(self._path / partial.name.removeprefix("."))

    def close(self) -> None:
        """Nothing is left to be finished."""
