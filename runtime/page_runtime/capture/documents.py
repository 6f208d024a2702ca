"""JSON files and folders of pictures as sources find them, with errors that name file and field."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from page_runtime.image_files import COLOR_SUFFIXES, SourceError

MAX_NAMES_SHOWN = 8
METRES_PER_MM = 1e-3
TIMES_FILE = "timestamps_s.txt"


def read_json(path: Path) -> Any:
    """The document, or a SourceError."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SourceError(f"{path}: cannot read it ({error.strerror})") from error
    except ValueError as error:
        raise SourceError(f"{path}: expected JSON, got something else ({error})") from error


def read_object(path: Path) -> dict[str, Any]:
    """The document, which must be a JSON object."""
    document = read_json(path)
    if not isinstance(document, dict):
        raise SourceError(f"{path}: expected a JSON object, got {type(document).__name__}")
    return document


def field(entry: Any, name: str, *, where: str) -> Any:
    """entry[name], or a SourceError that says which field is missing where."""
    if not isinstance(entry, dict) or name not in entry:
        raise SourceError(f"{where}: expected a field {name!r}, found none")
    return entry[name]


def numbers(value: Any, count: int, *, where: str) -> list[float]:
    """`count` finite numbers, or a SourceError."""
    values = value if isinstance(value, list) else []
    if len(values) != count or not all(_is_number(number) for number in values):
        raise SourceError(f"{where}: expected {count} numbers, got {_shortened(value)}")
    return [float(number) for number in values]


def number(value: Any, *, where: str) -> float:
    """A finite number, or a SourceError."""
    if not _is_number(value):
        raise SourceError(f"{where}: expected a number, got {_shortened(value)}")
    return float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def listed(value: Any, *, where: str) -> list[Any]:
    """`value` when it is a list, else a SourceError."""
    if not isinstance(value, list):
        raise SourceError(f"{where}: expected a list, got {_shortened(value)}")
    return value


def _shortened(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def require_folder(path: Path, *, holding: str) -> Path:
    """`path` when it is a folder, else a SourceError saying what should have been in it."""
    if not path.is_dir():
        raise SourceError(f"{path.parent}: no {path.name}/ folder; expected {holding} in it")
    return path


def pictures(folder: Path) -> dict[str, Path]:
    """Pictures of a folder and its subfolders by relative name without suffix, in order."""
    found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in COLOR_SUFFIXES)
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in found}


def frame_numbers(names: list[str]) -> list[int]:
    """The numbers in the files' names when they tell the frames apart, else 0, 1, 2 ..."""
    stems = [name.rsplit("/", 1)[-1] for name in names]
    if all(stem.isascii() and stem.isdigit() for stem in stems):
        values = [int(stem) for stem in stems]
        if len(set(values)) == len(values):
            return values
    return list(range(len(names)))


def frame_times(folder: Path, count: int) -> list[float] | None:
    """The times, s, in the folder's timestamps_s.txt, one for each frame; None where there is no such file."""
    file = folder / TIMES_FILE
    if not file.exists():
        return None
    try:
        times_s = [float(line) for line in file.read_text(encoding="utf-8").split()]
    except (OSError, ValueError) as error:
        raise SourceError(f"{file}: expected one time in seconds a line ({error})") from error
    if len(times_s) != count or not all(math.isfinite(time_s) for time_s in times_s):
        raise SourceError(f"{file}: expected {count} times, one for each frame, got {len(times_s)}")
    return times_s


def found_in(folder: Path) -> str:
    """What is in a folder, in words."""
    names = sorted(path.name + ("/" if path.is_dir() else "") for path in folder.iterdir())
    shown = ", ".join(names[:MAX_NAMES_SHOWN])
    return f"{shown} and {len(names) - MAX_NAMES_SHOWN} more" if len(names) > MAX_NAMES_SHOWN else shown or "nothing"
