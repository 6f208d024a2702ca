"""A bundle's file, read and judged before onnxruntime sees a byte of it: a bundle is untrusted input.

Refused are: a wrong or missing checksum, data outside the file, tensors whose declared size is not that of their data,
graphs inside nodes, functions, foreign domains, and any field that is not understood. Time and memory are bounded by
the size of the file and MAX_FIELDS. Which fields there are: `onnx_messages`. How large what it computes becomes:
`graph_limits`.
Format: https://github.com/onnx/onnx/blob/main/onnx/onnx.proto3
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from page_runtime import onnx_messages
from page_runtime.bundle import METADATA_KEY
from page_runtime.wire import Budget, WireError, read, top_level

CHECKSUM_KEY = "page.sha256"
MAX_FIELDS = 1 << 16
MAX_METADATA_BYTES = 1 << 20
OPSETS = range(17, 23)
# Initializers up to this size are read: they are the axes, shapes and bounds that decide on the size of other values.
MAX_READ_ELEMENTS = 64


@dataclass(frozen=True, eq=False, slots=True)
class Node:
    """One operator. attributes: numbers, texts, or lists of numbers."""

    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class Tensor:
    """An initializer. type: its elements', of `onnx_messages.ELEMENT_BYTES`. values: None where it has more than
    MAX_READ_ELEMENTS."""

    type: int
    shape: tuple[int, ...]
    values: NDArray[np.generic] | None


@dataclass(frozen=True, slots=True)
class Declared:
    """What the file says of an input or output. type: as of `Tensor`. shape: a text where a length is not fixed."""

    type: int
    shape: tuple[int | str, ...]

    def __str__(self) -> str:
        return f"tensor({onnx_messages.TYPE_NAMES[self.type]}) {list(self.shape)}"


@dataclass(frozen=True, eq=False, slots=True)
class OnnxGraph:
    """inputs and outputs: in the file's order."""

    inputs: dict[str, Declared]
    outputs: dict[str, Declared]
    nodes: tuple[Node, ...]
    initializers: dict[str, Tensor]
    opset: int


@dataclass(frozen=True, eq=False, slots=True)
class OnnxFile:
    """A file that was understood whole. metadata: its text entries, the checksum left out."""

    graph: OnnxGraph
    metadata: dict[str, str]


def checksum_of(data: bytes | memoryview) -> str:
    """SHA-256 (hex) of a serialised model without its checksum entry, of all its other bytes in their order."""
    view = memoryview(data)
    digest = hashlib.sha256()
    for start, end in _outside_checksum(view):
        digest.update(view[start:end])
    return digest.hexdigest()


def sealed(data: bytes) -> bytes:
    """A serialised model with its checksum, in the place of one that it may have."""
    view = memoryview(data)
    body = b"".join(view[start:end] for start, end in _outside_checksum(view))
    entry = _field(1, CHECKSUM_KEY.encode()) + _field(2, checksum_of(body).encode())
    return body + _field(onnx_messages.METADATA_PROPS, entry)


def read_onnx(data: bytes) -> OnnxFile:
    """Parse a whole file; WireError with the reason for what is refused."""
    view, budget = memoryview(data), Budget(MAX_FIELDS)
    model = read(onnx_messages.MODEL, view, budget)
    metadata: dict[str, str] = {}
    for raw in model.get("metadata_props", []):
        if len(raw) > MAX_METADATA_BYTES:
            raise WireError(f"metadata: expected at most {MAX_METADATA_BYTES} bytes, got {len(raw)}")
        entry = read(onnx_messages.ENTRY, raw, budget)
        key = entry.get("key", "")
        if key in metadata:
            raise WireError(f"metadata: {key!r} is given twice")
        metadata[key] = entry.get("value", "")
    stated = metadata.pop(CHECKSUM_KEY, None)
    if METADATA_KEY not in metadata:
        raise WireError(f"no {METADATA_KEY!r} in the metadata of this ONNX model; use page-export")
    if stated is None:
        raise WireError(f"no checksum ({CHECKSUM_KEY!r} in the metadata); export it again with this release")
    if stated != checksum_of(view):
        raise WireError("its checksum is wrong: the file was damaged or changed after its export")
    if "graph" not in model:
        raise WireError("model: no graph")
    return OnnxFile(_graph(model["graph"], _opset(model, budget), budget), metadata)


def _opset(model: dict[str, Any], budget: Budget) -> int:
    """The version of the standard operators; all other domains are refused."""
    versions = []
    for raw in model.get("opset_import", []):
        entry = read(onnx_messages.OPSET, raw, budget)
        if entry.get("domain", "") not in ("", "ai.onnx"):
            raise WireError(f"operators of the domain {entry['domain']!r} are not allowed, only standard ones")
        versions.append(entry.get("version", 0))
    if len(versions) != 1 or versions[0] not in OPSETS:
        raise WireError(f"expected one opset from {OPSETS[0]} to {OPSETS[-1]}, got {versions}")
    return versions[0]


def _graph(raw: memoryview, opset: int, budget: Budget) -> OnnxGraph:
    graph = read(onnx_messages.GRAPH, raw, budget)
    initializers: dict[str, Tensor] = {}
    for one in graph.get("initializer", []):
        name, tensor = _tensor(one, budget)
        if name in initializers:
            raise WireError(f"initializer {name!r} is given twice")
        initializers[name] = tensor
    return OnnxGraph(
        inputs=_values(graph.get("input", []), budget),
        outputs=_values(graph.get("output", []), budget),
        nodes=tuple(_node(one, budget) for one in graph.get("node", [])),
        initializers=initializers,
        opset=opset,
    )


def _node(raw: memoryview, budget: Budget) -> Node:
    node = read(onnx_messages.NODE, raw, budget)
    kind = node.get("op_type", "")
    if node.get("domain", "") not in ("", "ai.onnx"):
        raise WireError(f"operator {kind!r} of the domain {node['domain']!r} is not allowed, only standard ones")
    attributes: dict[str, Any] = {}
    for one in node.get("attribute", []):
        attribute = read(onnx_messages.ATTRIBUTE, one, budget)
        name = attribute.pop("name", "")
        told = onnx_messages.ATTRIBUTE_FIELDS.get(attribute.pop("type", 0))
        if name in attributes:
            raise WireError(f"operator {kind!r}: attribute {name!r} is given twice")
        if told is None or not set(attribute) <= {told}:
            raise WireError(f"operator {kind!r}: attribute {name!r} is not of one known type")
        # An absent value is the type's zero or an empty list.
        attributes[name] = attribute.get(told, {"f": 0.0, "i": 0, "s": ""}.get(told, []))
    return Node(kind, tuple(node.get("input", ())), tuple(node.get("output", ())), attributes)


def _tensor(raw: memoryview, budget: Budget) -> tuple[str, Tensor]:
    tensor = read(onnx_messages.TENSOR, raw, budget)
    name, kind = tensor.get("name", ""), tensor.get("data_type", 0)
    shape = tuple(tensor.get("dims", ()))
    size = onnx_messages.ELEMENT_BYTES.get(kind)
    if size is None:
        raise WireError(f"initializer {name!r}: data type {kind} is not allowed")
    count = _count(name, shape)
    data = tensor.get("raw_data", memoryview(b""))
    if len(data) != count * size:
        raise WireError(f"initializer {name!r}: {list(shape)} needs {count * size} bytes, got {len(data)}")
    values = None
    if count <= MAX_READ_ELEMENTS and kind in onnx_messages.READABLE:
        values = np.frombuffer(data, onnx_messages.READABLE[kind]).reshape(shape)
    return name, Tensor(kind, shape, values)


def _count(name: str, shape: tuple[int, ...]) -> int:
    """Elements of a shape; of Python's integers, which do not overflow."""
    count = 1
    if len(shape) > 8:
        raise WireError(f"{name!r}: {len(shape)} dimensions")
    for length in shape:
        if length < 0:
            raise WireError(f"{name!r}: a dimension of {length}")
        count *= length
    return count


def _values(raws: list[memoryview], budget: Budget) -> dict[str, Declared]:
    found: dict[str, Declared] = {}
    for raw in raws:
        value = read(onnx_messages.VALUE, raw, budget)
        name = value.get("name", "")
        if name in found:
            raise WireError(f"value {name!r} is given twice")
        kind = read(onnx_messages.TYPE, value.get("type", memoryview(b"")), budget)
        tensor = read(onnx_messages.TENSOR_TYPE, kind.get("tensor_type", memoryview(b"")), budget)
        dims = [
            read(onnx_messages.DIM, one, budget)
            for one in read(onnx_messages.SHAPE, tensor.get("shape", memoryview(b"")), budget).get("dim", [])
        ]
        shape = tuple(dim.get("dim_param") or dim.get("dim_value", 0) for dim in dims)
        _count(name, tuple(length for length in shape if isinstance(length, int)))
        element = tensor.get("elem_type", 0)
        if element not in onnx_messages.ELEMENT_BYTES:
            raise WireError(f"value {name!r}: data type {element} is not allowed")
        found[name] = Declared(element, shape)
    return found


def _outside_checksum(view: memoryview) -> list[tuple[int, int]]:
    """The parts of a model's bytes that are not the checksum's entry."""
    budget = Budget(MAX_FIELDS)
    marker = _field(1, CHECKSUM_KEY.encode())
    return [
        (start, end)
        for number, start, value, end in top_level(view, budget)
        if number != onnx_messages.METADATA_PROPS or view[value : value + len(marker)] != marker
    ]


def _field(number: int, content: bytes) -> bytes:
    return _written(number << 3 | 2) + _written(len(content)) + content


def _written(value: int) -> bytes:
    """A number as a varint."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes(out) + bytes([value])
