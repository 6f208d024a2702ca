"""Metadata that a bundle must not have, with a right checksum: what each does to a sound one, and why it is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import onnx

from page_runtime.bundle import METADATA_KEY, METADATA_VERSION
from page_runtime.category import MAX_PARTS


def with_metadata(change: Callable[[dict[str, Any]], Any]) -> Callable[[onnx.ModelProto], None]:
    def apply(model: onnx.ModelProto) -> None:
        (entry,) = [entry for entry in model.metadata_props if entry.key == METADATA_KEY]
        document = json.loads(entry.value)
        entry.value = change(document) or json.dumps(document)

    return apply


def add_entry(model: onnx.ModelProto) -> None:
    entry = model.metadata_props.add()
    entry.key, entry.value = "surprise", "x"


METADATA_ATTACKS: dict[str, tuple[Callable[[onnx.ModelProto], Any], str]] = {
    "more metadata": (add_entry, "not understood: .*surprise"),
    "metadata twice": (lambda m: m.metadata_props.append(m.metadata_props[0]), "given twice"),
    "metadata of another version": (
        with_metadata(lambda d: d.update(version=99)),
        f"version {METADATA_VERSION}, got 99",
    ),
    "metadata with a field more": (with_metadata(lambda d: d.update(surprise=1)), "not understood .*surprise"),
    "metadata of another opset": (with_metadata(lambda d: d.update(opset=17)), "opset 17"),
    "metadata nested deeply": (with_metadata(lambda _: "[" * 200_000), "expected JSON"),
    "metadata with a long number": (with_metadata(lambda _: "9" * 100_000), "expected JSON"),
    "metadata with an infinite number": (with_metadata(lambda d: d.update(num_points=float("inf"))), "bundle metadata"),
    "metadata with a field twice": (with_metadata(lambda _: '{"version": 4, "version": 4}'), "given twice"),
    "a chain of many parts": (
        with_metadata(lambda d: d.update(parts=[dict(d["parts"][0], name=str(k)) for k in range(MAX_PARTS + 1)])),
        f"parts: expected at most {MAX_PARTS}, got {MAX_PARTS + 1}",
    ),
    "a joint for each pair of parts": (
        with_metadata(lambda d: d.update(joints=[None] * MAX_PARTS)),
        f"joints: expected at most {MAX_PARTS - 1}, got {MAX_PARTS}",
    ),
    "commands to a terminal": (
        with_metadata(lambda d: d["provenance"].update({"\x1b[2J": 1})),
        "provenance: expected printable names",
    ),
    "metadata without end": (with_metadata(lambda _: "{" + " " * (5 << 20)), "at most"),
}
