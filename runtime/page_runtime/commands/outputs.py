"""What the commands write: whole files that appear when all of it is there, and nothing after an error."""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from page_runtime.commands.usage import UsageError
from page_runtime.image_files import write_color

OVERLAY_SUFFIX = ".jpg"


def require_file_place(path: Path | None, *, option: str) -> None:
    """UsageError unless a file can be made at `path`."""
    if path is None:
        return
    if path.is_dir():
        raise UsageError(f"{option}: expected the name of a file, got the folder {path}")
    if path.exists() and not path.is_file():
        raise UsageError(f"{option}: expected the name of a file, got {path}, which is something else")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"{option}: no folder {path.resolve().parent} to write {path.name} into")
    _require_writable(path.resolve().parent, option=option)


def require_folder_place(path: Path | None, *, option: str) -> None:
    """UsageError unless `path` is a folder or can be made one."""
    if path is None:
        return
    if path.exists() and not path.is_dir():
        raise UsageError(f"{option}: expected a folder, got the file {path}")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"{option}: no folder {path.resolve().parent} to make {path.name} in")
    _require_writable(path if path.is_dir() else path.resolve().parent, option=option)


def _require_writable(folder: Path, *, option: str) -> None:
    """By trying: permissions alone say nothing about a read-only or foreign file system."""
    try:
        tempfile.TemporaryDirectory(prefix=".page-runtime.", suffix=".partial", dir=folder).cleanup()
    except OSError as error:
        raise UsageError(f"{option}: cannot write into {folder} ({error.strerror})") from error


@contextmanager
def text_output(path: Path | None) -> Iterator[TextIO]:
    """A text file that takes its name when the block ends well; standard output, line by line, for None."""
    if path is None:
        yield sys.stdout
        return
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".partial", dir=path.resolve().parent)
    partial = Path(name)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            yield file
        partial.chmod(0o666 & ~_umask())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_json(path: Path, document: dict[str, Any]) -> None:
    """The document in a file, whole or not at all."""
    with text_output(path) as file:
        file.write(json.dumps(document, indent=1, allow_nan=False) + "\n")


class OverlayFolder:
    """Pictures that are moved into their folder together."""

    def __init__(self, staging: Path) -> None:
        self.staging = staging

    def add(self, index: int, picture: NDArray[np.uint8]) -> None:
        """Keep the picture (H,W,3) uint8 RGB of frame `index`."""
        write_color(self.staging / f"{index:06d}{OVERLAY_SUFFIX}", picture)


@contextmanager
def overlay_output(path: Path | None) -> Iterator[OverlayFolder | None]:
    """A folder of pictures that is filled when the block ends well; None for None."""
    if path is None:
        yield None
        return
    # Inside the folder where there is one, which may be a file system of its own: files cannot be moved into that.
    inside = path if path.is_dir() else path.resolve().parent
    staging = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".partial", dir=inside))
    try:
        yield OverlayFolder(staging)
        path.mkdir(exist_ok=True)
        for file in sorted(staging.iterdir()):
            file.replace(path / file.name)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
