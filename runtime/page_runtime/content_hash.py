"""Names for what bytes say: of a file, of a folder, of this package's own code."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path


def sha256_of(path: Path | str) -> str:
    """Of a file's bytes; of a folder, of the names and bytes of all files in it, in order, hidden ones left out."""
    place = Path(path)
    digest = hashlib.sha256()
    if place.is_file():
        _add(digest, place)
        return digest.hexdigest()
    for file in sorted(place.rglob("*")):
        relative = file.relative_to(place)
        if file.is_file() and not any(part.startswith(".") for part in relative.parts):
            digest.update(relative.as_posix().encode() + b"\0" + str(file.stat().st_size).encode() + b"\0")
            _add(digest, file)
    return digest.hexdigest()


def _add(digest: hashlib._Hash, file: Path) -> None:
    with file.open("rb") as opened:
        while block := opened.read(1 << 20):
            digest.update(block)


@cache
def own_code_sha256() -> str:
    """Of the Python sources of page_runtime: results of one version of them are not mixed with another's."""
    package = Path(__file__).resolve().parent
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()
