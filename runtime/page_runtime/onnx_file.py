"""A bundle's file, read and judged before onnxruntime sees a byte of it: a bundle is untrusted input.

Refused are: a wrong or missing checksum, data outside the file, tensors whose declared size is not that of their data,
graphs inside nodes, functions, foreign domains, and any field that is not understood. Time and memory are bounded by
the size of the file and MAX_FIELDS. How large what it computes becomes: `graph_limits`.
Format: https://github.com/onnx/onnx/blob/main/onnx/onnx.proto3
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from page_runtime.bundle import METADATA_KEY
from page_runtime.wire import Budget, Field, Message, WireError, read, top_level

CHECKSUM_KEY = "page.sha256"
MAX_FIELDS = 1 << 17
MAX_METADATA_BYTES = 4 << 20
OPSETS = range(17, 23)
# Initializers up to this size are read: they are the axes, shapes and bounds that decide on the size of other values.
MAX_READ_ELEMENTS = 64

_METADATA_PROPS = 14
_ENTRY = Message("metadata", {1: Field("key", "text"), 2: Field("value", "text")})
_OPSET = Message("opset_import", {1: Field("domain", "text"), 2: Field("version", "integer")})
_MODEL = Message(
    "model",
    {
        1: Field("ir_version", "integer"),
        2: Field("producer_name", "text"),
        3: Field("producer_version", "text"),
        4: Field("domain", "text"),
        5: Field("model_version", "integer"),
        6: Field("doc_string", "text"),
        7: Field("graph", "bytes"),
        8: Field("opset_import", "bytes", many=True),
        _METADATA_PROPS: Field("metadata_props", "bytes", many=True),
    },
    {20: "training graphs are not allowed", 25: "functions are not allowed", 26: "device settings are not allowed"},
)
_GRAPH = Message(
    "graph",
    {
        1: Field("node", "bytes", many=True),
        2: Field("name", "text"),
        5: Field("initializer", "bytes", many=True),
        10: Field("doc_string", "text"),
        11: Field("input", "bytes", many=True),
        12: Field("output", "bytes", many=True),
    },
    {
        13: "declared shapes of inner values (value_info) are not allowed: they are computed here",
        14: "quantization annotations are not allowed",
        15: "sparse initializers are not allowed",
        16: "metadata of the graph is not allowed",
    },
)
_NODE = Message(
    "node",
    {
        1: Field("input", "text", many=True),
        2: Field("output", "text", many=True),
        3: Field("name", "text"),
        4: Field("op_type", "text"),
        5: Field("attribute", "bytes", many=True),
        7: Field("domain", "text"),
    },
    {
        6: "documentation of nodes is not allowed",
        8: "overloads are not allowed",
        9: "metadata of nodes is not allowed",
        10: "device settings are not allowed",
    },
)
_ATTRIBUTE = Message(
    "attribute",
    {
        1: Field("name", "text"),
        2: Field("f", "float"),
        3: Field("i", "integer"),
        4: Field("s", "text"),
        7: Field("floats", "floats"),
        8: Field("ints", "integers"),
        20: Field("type", "integer"),
    },
    {
        5: "a tensor inside a node is not allowed; constants are initializers",
        6: "a graph inside a node is not allowed",
        9: "lists of strings are not allowed",
        10: "tensors inside a node are not allowed; constants are initializers",
        11: "graphs inside a node are not allowed",
        13: "documentation of attributes is not allowed",
        14: "types as attributes are not allowed",
        15: "types as attributes are not allowed",
        21: "attributes of functions are not allowed",
        22: "sparse tensors are not allowed",
        23: "sparse tensors are not allowed",
    },
)
# AttributeProto.type and the field it says.
_ATTRIBUTE_FIELDS = {1: "f", 2: "i", 3: "s", 6: "floats", 7: "ints"}
_TENSOR = Message(
    "initializer",
    {
        1: Field("dims", "integers"),
        2: Field("data_type", "integer"),
        8: Field("name", "text"),
        9: Field("raw_data", "bytes"),
    },
    {
        3: "segments are not allowed",
        13: "data outside the file is not allowed",
        14: "data outside the file is not allowed",
        16: "metadata of tensors is not allowed",
    }
    | dict.fromkeys((4, 5, 6, 7, 10, 11), "expected its values as raw data"),
)
_VALUE = Message("value", {1: Field("name", "text"), 2: Field("type", "bytes")})
_TYPE = Message("type", {1: Field("tensor_type", "bytes")}, {4: "sequences are not allowed", 5: "maps are not allowed"})
_TENSOR_TYPE = Message("tensor type", {1: Field("elem_type", "integer"), 2: Field("shape", "bytes")})
_SHAPE = Message("shape", {1: Field("dim", "bytes", many=True)})
_DIM = Message("dimension", {1: Field("dim_value", "integer"), 2: Field("dim_param", "text")})

# TensorProto.DataType: bytes of an element; float32, uint8, int8, int32, int64, bool, float16, float64.
_ELEMENT_BYTES = {1: 4, 2: 1, 3: 1, 6: 4, 7: 8, 9: 1, 10: 2, 11: 8}
_READABLE = {6: "<i4", 7: "<i8", 1: "<f4"}


@dataclass(frozen=True, eq=False, slots=True)
class Node:
    """One operator. attributes: numbers, texts, or lists of numbers."""

    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class Tensor:
    """An initializer. values: None where it has more than MAX_READ_ELEMENTS."""

    shape: tuple[int, ...]
    values: NDArray[np.generic] | None


@dataclass(frozen=True, eq=False, slots=True)
class OnnxGraph:
    """inputs and outputs: the declared shape of each, a text where it is not fixed."""

    inputs: dict[str, tuple[int | str, ...]]
    outputs: dict[str, tuple[int | str, ...]]
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
    return body + _field(_METADATA_PROPS, entry)


def read_onnx(data: bytes) -> OnnxFile:
    """Parse a whole file; WireError with the reason for what is refused."""
    view, budget = memoryview(data), Budget(MAX_FIELDS)
    model = read(_MODEL, view, budget)
    metadata: dict[str, str] = {}
    for raw in model.get("metadata_props", []):
        if len(raw) > MAX_METADATA_BYTES:
            raise WireError(f"metadata: expected at most {MAX_METADATA_BYTES} bytes, got {len(raw)}")
        entry = read(_ENTRY, raw, budget)
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
        entry = read(_OPSET, raw, budget)
        if entry.get("domain", "") not in ("", "ai.onnx"):
            raise WireError(f"operators of the domain {entry['domain']!r} are not allowed, only standard ones")
        versions.append(entry.get("version", 0))
    if len(versions) != 1 or versions[0] not in OPSETS:
        raise WireError(f"expected one opset from {OPSETS[0]} to {OPSETS[-1]}, got {versions}")
    return versions[0]


def _graph(raw: memoryview, opset: int, budget: Budget) -> OnnxGraph:
    graph = read(_GRAPH, raw, budget)
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
    node = read(_NODE, raw, budget)
    kind = node.get("op_type", "")
    if node.get("domain", "") not in ("", "ai.onnx"):
        raise WireError(f"operator {kind!r} of the domain {node['domain']!r} is not allowed, only standard ones")
    attributes: dict[str, Any] = {}
    for one in node.get("attribute", []):
        attribute = read(_ATTRIBUTE, one, budget)
        name = attribute.pop("name", "")
        told = _ATTRIBUTE_FIELDS.get(attribute.pop("type", 0))
        if name in attributes:
            raise WireError(f"operator {kind!r}: attribute {name!r} is given twice")
        if told is None or not set(attribute) <= {told}:
            raise WireError(f"operator {kind!r}: attribute {name!r} is not of one known type")
        # An absent value is the type's zero or an empty list.
        attributes[name] = attribute.get(told, {"f": 0.0, "i": 0, "s": ""}.get(told, []))
    return Node(kind, tuple(node.get("input", ())), tuple(node.get("output", ())), attributes)


def _tensor(raw: memoryview, budget: Budget) -> tuple[str, Tensor]:
    tensor = read(_TENSOR, raw, budget)
    name, kind = tensor.get("name", ""), tensor.get("data_type", 0)
    shape = tuple(tensor.get("dims", ()))
    size = _ELEMENT_BYTES.get(kind)
    if size is None:
        raise WireError(f"initializer {name!r}: data type {kind} is not allowed")
    count = _count(name, shape)
    data = tensor.get("raw_data", memoryview(b""))
    if len(data) != count * size:
        raise WireError(f"initializer {name!r}: {list(shape)} needs {count * size} bytes, got {len(data)}")
    values = None
    if count <= MAX_READ_ELEMENTS and kind in _READABLE:
        values = np.frombuffer(data, _READABLE[kind]).reshape(shape)
    return name, Tensor(shape, values)


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


def _values(raws: list[memoryview], budget: Budget) -> dict[str, tuple[int | str, ...]]:
    found: dict[str, tuple[int | str, ...]] = {}
    for raw in raws:
        value = read(_VALUE, raw, budget)
        name = value.get("name", "")
        if name in found:
            raise WireError(f"value {name!r} is given twice")
        kind = read(_TYPE, value.get("type", memoryview(b"")), budget)
        tensor = read(_TENSOR_TYPE, kind.get("tensor_type", memoryview(b"")), budget)
        dims = [
            read(_DIM, one, budget) for one in read(_SHAPE, tensor.get("shape", memoryview(b"")), budget).get("dim", [])
        ]
        shape = tuple(dim.get("dim_param") or dim.get("dim_value", 0) for dim in dims)
        _count(name, tuple(length for length in shape if isinstance(length, int)))
        found[name] = shape
    return found


def _outside_checksum(view: memoryview) -> list[tuple[int, int]]:
    """The parts of a model's bytes that are not the checksum's entry."""
    budget = Budget(MAX_FIELDS)
    marker = _field(1, CHECKSUM_KEY.encode())
    return [
        (start, end)
        for number, start, value, end in top_level(view, budget)
        if number != _METADATA_PROPS or view[value : value + len(marker)] != marker
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
