"""Reading protobuf's wire format in bounded time and memory, with nothing but what a message may hold.

Stricter than protobuf itself, which skips unknown fields, merges repeated ones and lets the last of two win: bytes that
two readers could understand differently are refused, so that what was checked is what onnxruntime then reads.
Format: https://protobuf.dev/programming-guides/encoding
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5


class WireError(ValueError):
    """The bytes are not a message of the expected kind; the message says where and why."""


@dataclass(frozen=True, slots=True)
class Field:
    """What a field of a message may be. kind: integer, float, text, bytes, integers or floats; many: may repeat."""

    name: str
    kind: str
    many: bool = False


@dataclass(frozen=True, slots=True)
class Message:
    """A closed kind of message. fields: by number. refused: numbers that exist in the format, and why not here."""

    name: str
    fields: Mapping[int, Field]
    refused: Mapping[int, str] = field(default_factory=dict)


class Budget:
    """Fields that may still be read; shared by all messages of one file."""

    def __init__(self, fields: int) -> None:
        self.limit = self.left = fields

    def spend(self, fields: int) -> None:
        self.left -= fields
        if self.left < 0:
            raise WireError(f"more than {self.limit} fields; no bundle has so many")


_WIRE_TYPES = {
    "integer": VARINT,
    "float": FIXED32,
    "text": BYTES,
    "bytes": BYTES,
}


def read(message: Message, data: memoryview, budget: Budget) -> dict[str, Any]:
    """The fields of `data`, by name: repeated ones as lists, absent ones left out, bytes as views into `data`.

    WireError for anything that `message` does not know, for a field given twice that may not be, and for lengths that
    reach beyond the data.
    """
    found: dict[str, Any] = {}
    at, end = 0, len(data)
    while at < end:
        budget.spend(1)
        key, at = _varint(data, at)
        number, wire_type = key >> 3, key & 7
        known = message.fields.get(number)
        if known is None:
            raise WireError(f"{message.name}: {message.refused.get(number, f'unknown field {number}')}")
        if known.kind == "integers" or known.kind == "floats":
            value, at = _numbers(known, wire_type, data, at, budget)
            found.setdefault(known.name, []).extend(value)
            continue
        if wire_type != _WIRE_TYPES[known.kind]:
            raise WireError(f"{message.name}: {known.name} is encoded as wire type {wire_type}")
        if wire_type == BYTES:
            value, at = _bytes(data, at)
            if known.kind == "text":
                value = _text(value, message, known)
        elif wire_type == VARINT:
            value, at = _varint(data, at)
            value = _signed(value)
        else:
            value, at = _float(data, at)
        if known.many:
            found.setdefault(known.name, []).append(value)
        elif known.name in found:
            raise WireError(f"{message.name}: {known.name} is given twice")
        else:
            found[known.name] = value
    return found


def top_level(data: memoryview, budget: Budget) -> list[tuple[int, int, int, int]]:
    """(number, start of the field, start of its value, end) of each field, none of them read."""
    found = []
    at, end = 0, len(data)
    while at < end:
        budget.spend(1)
        start = at
        key, at = _varint(data, at)
        wire_type = key & 7
        if wire_type == BYTES:
            value, at = _bytes(data, at)
            found.append((key >> 3, start, at - len(value), at))
        elif wire_type == VARINT:
            before = at
            _, at = _varint(data, at)
            found.append((key >> 3, start, before, at))
        else:
            raise WireError(f"unexpected wire type {wire_type}")
    return found


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """A number of at most 64 bits and where it ends."""
    value = shift = 0
    try:
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                break
            shift += 7
            if shift > 63:
                raise WireError("a number longer than 64 bits")
    except IndexError:
        raise WireError("the data ends within a number; the file is cut short") from None
    if value >> 64:
        raise WireError("a number longer than 64 bits")
    return value, at


def _signed(value: int) -> int:
    return value - (1 << 64) if value >> 63 else value


def _bytes(data: memoryview, at: int) -> tuple[memoryview, int]:
    length, at = _varint(data, at)
    if length > len(data) - at:
        raise WireError(f"a field of {length} bytes where {len(data) - at} are left; the file is cut short")
    return data[at : at + length], at + length


def _float(data: memoryview, at: int) -> tuple[float, int]:
    if len(data) - at < 4:
        raise WireError("the data ends within a float; the file is cut short")
    return struct.unpack_from("<f", data, at)[0], at + 4


def _text(value: memoryview, message: Message, known: Field) -> str:
    try:
        return str(value, "utf-8")
    except UnicodeDecodeError:
        raise WireError(f"{message.name}: {known.name} is not UTF-8 text") from None


def _numbers(known: Field, wire_type: int, data: memoryview, at: int, budget: Budget) -> tuple[list[Any], int]:
    """The numbers of a repeated field, one by one or packed."""
    whole = known.kind == "integers"
    if wire_type == BYTES:
        packed, at = _bytes(data, at)
        values, inside = [], 0
        while inside < len(packed):
            budget.spend(1)
            value, inside = _varint(packed, inside) if whole else _float(packed, inside)
            values.append(_signed(value) if whole else value)  # pyright: ignore[reportArgumentType]
        return values, at
    if wire_type != (VARINT if whole else FIXED32):
        raise WireError(f"{known.name} is encoded as wire type {wire_type}")
    if whole:
        value, at = _varint(data, at)
        return [_signed(value)], at
    value, at = _float(data, at)
    return [value], at
