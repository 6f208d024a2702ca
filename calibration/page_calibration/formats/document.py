"""Files of other programs, parsed: JSON, YAML and its OpenCV dialect, INI; all as lists and dictionaries."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from page_calibration.calibration import CalibrationError

Size = tuple[int, int]
_MAX_BYTES = 10_000_000
_OPENCV_HEADER = re.compile(r"\A%YAML[: ]1\.[0-9][^\n]*\n(---\s*\n)?")


@dataclass(frozen=True, slots=True)
class Document:
    """A parsed file. data: a dictionary, a list, or None where it is of no kind known here; size: (width, height) given
    beside it, for files that do not say."""

    path: Path
    text: str
    data: Any
    size: Size | None = None

    def has(self, *names: str) -> bool:
        """Whether it is a dictionary with all these keys."""
        return isinstance(self.data, dict) and all(name in self.data for name in names)

    def size_of(self, stated: Size | None, *, hint: str = "") -> Size:
        """The picture size: stated in the file, or given; CalibrationError for neither, or for both and different."""
        if stated is None and self.size is None:
            raise CalibrationError(
                f"{self.path}: it does not say for which picture size K is; give --size WIDTHxHEIGHT{hint}"
            )
        if stated is not None and self.size is not None and stated != self.size:
            raise CalibrationError(
                f"{self.path}: it is for {stated[0]}x{stated[1]}, but --size says {self.size[0]}x{self.size[1]}"
            )
        size = stated or self.size
        assert size is not None
        if min(size) <= 0:
            raise CalibrationError(f"{self.path}: expected a picture size in pixels, got {size[0]}x{size[1]}")
        return size


def open_document(path: Path, *, size: Size | None = None) -> Document:
    """Read and parse; CalibrationError when there is nothing to read or it is not text."""
    try:
        if path.is_dir():
            raise CalibrationError(f"{path}: expected the file of a calibration, got a folder")
        if path.stat().st_size > _MAX_BYTES:
            raise CalibrationError(f"{path}: expected a calibration, got a file of {path.stat().st_size / 1e6:.0f} MB")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{path}: cannot read it ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{path}: expected text, got something else") from error
    if not text.strip():
        raise CalibrationError(f"{path}: the file is empty")
    return Document(path, text, parse_document(path, text), size)


def parse_document(path: Path, text: str) -> Any:
    """The contents of a file as lists and dictionaries, None where they are of no kind known here."""
    start = text.lstrip()
    if start.startswith(("{", "[{")):
        try:
            return json.loads(text)
        except ValueError as error:
            raise CalibrationError(f"{path}: expected JSON, the file is cut off or damaged ({error})") from error
    if start.startswith("<?xml"):
        return _by_opencv(text)
    if start.startswith("["):
        return parse_ini(text)
    header = _OPENCV_HEADER.match(text)
    try:
        return parse_yaml(text[header.end() :] if header else text)
    except CalibrationError:
        return _by_opencv(text) if header else None


def parse_yaml(text: str) -> Any:
    """The YAML document, OpenCV's matrices as dictionaries; CalibrationError when it is none."""
    try:
        import yaml
    except ImportError as error:
        raise CalibrationError("YAML needs the extra: pip install 'page-edge[calibration]'") from error

    class Loader(yaml.SafeLoader):
        """Takes OpenCV's own tags, which are dictionaries."""

    def _mapping(loader: Loader, node: Any) -> dict[Any, Any]:
        return loader.construct_mapping(node, deep=True)

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _mapping)
    try:
        return yaml.load(text, Loader)
    except yaml.YAMLError as error:
        raise CalibrationError(f"expected YAML ({error})") from error


def parse_ini(text: str) -> dict[str, dict[str, list[str]]]:
    """Videre's INI: sections of names, each followed by lines of values."""
    sections: dict[str, dict[str, list[str]]] = {}
    section: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in (line.strip() for line in text.splitlines()):
        if not line or line[0] in "#;":
            continue
        if line.startswith("["):
            section = sections.setdefault(line.strip("[]"), {})
        elif line[0].isalpha():
            lines = section.setdefault(line, [])
        else:
            lines.append(line)
    return sections


def _by_opencv(text: str) -> Any:
    """What cv2.FileStorage reads, which takes the YAML that other parsers refuse; None when it refuses too."""
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        return {key: _value(root.getNode(key)) for key in root.keys()} if not root.empty() else None  # noqa: SIM118
    except cv2.error:
        return None


def _value(node: cv2.FileNode) -> Any:
    if node.isMap():
        keys = node.keys()
        if {"rows", "cols", "data"} <= set(keys):
            return {key: _value(node.getNode(key)) for key in ("rows", "cols", "data")}
        return {key: _value(node.getNode(key)) for key in keys}
    if node.isSeq():
        return [_value(node.at(i)) for i in range(node.size())]
    if node.isString():
        return node.string()
    return int(node.real()) if node.isInt() else node.real() if node.isReal() else None
