"""Fields of the JSON that a bundle carries, one by one: there, of their kind, and none besides."""

from __future__ import annotations

from collections.abc import Set
from typing import Any


class BundleError(ValueError):
    """The file is not a bundle this version can run; the message says why."""


def closed(entry: Any, what: str, expected: set[str], allowed: Set[str] = frozenset()) -> dict[str, Any]:
    """The entry, an object with the fields `expected` and maybe some of `allowed`; `what` it is, for the message."""
    if not isinstance(entry, dict):
        raise BundleError(f"bundle metadata: expected each {what} to be an object, got {type(entry).__name__}")
    missing, extra = expected - entry.keys(), entry.keys() - expected - allowed
    if missing or extra:
        raise BundleError(f"bundle metadata, {what}: missing {sorted(missing)}, not understood {sorted(extra)}")
    return entry


def listed(entry: dict[str, Any], name: str, most: int) -> list[Any]:
    """The list of this name, of at most so many."""
    if not isinstance(entry[name], list):
        raise BundleError(f"bundle metadata, {name}: expected a list, got {type(entry[name]).__name__}")
    if len(entry[name]) > most:
        raise BundleError(f"bundle metadata, {name}: expected at most {most}, got {len(entry[name])}")
    return entry[name]


def whole(entry: dict[str, Any], name: str) -> int:
    """The whole number of this name; ValueError for anything else."""
    if not isinstance(entry[name], int) or isinstance(entry[name], bool):
        raise ValueError(f"{name}: expected a whole number, got {entry[name]!r}")
    return entry[name]


def yes_or_no(entry: dict[str, Any], name: str) -> bool:
    """The truth value of this name; ValueError for anything else."""
    if not isinstance(entry[name], bool):
        raise ValueError(f"{name}: expected true or false, got {entry[name]!r}")
    return entry[name]


def triple(entry: dict[str, Any], name: str) -> tuple[float, float, float]:
    """The three numbers of this name; ValueError for anything else."""
    x, y, z = (float(value) for value in entry[name])
    return x, y, z


def each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; two readers would take different ones of a field that is given twice."""
    entry = dict(pairs)
    if len(entry) != len(pairs):
        raise ValueError("a field that is given twice")
    return entry
