"""How large the values of a graph become and how much it computes, found without computing it.

A file of a few bytes can ask for a matrix of 10^12 elements: a column times a row, or thirty concatenations of a value
with itself. onnxruntime would make it while it loads, as both are constants. Here each operator a bundle may use
(`allowed_operators`) says the shape of what it gives (`shape_rules`); an operator without such a rule is refused, and
so is what is too large.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import prod

from page_runtime.allowed_operators import BESIDE, DEARER, MULTIPLIES, RULES
from page_runtime.element_types import types_given
from page_runtime.onnx_file import Declared, Node, OnnxGraph, Tensor
from page_runtime.onnx_messages import ELEMENT_BYTES, FLOAT
from page_runtime.shape_rules import Known, Shape
from page_runtime.wire import WireError

MAX_NODES = 4096
MAX_RANK = 8
# In brackets what the shipped networks need; one of 8,192 points, 448 pixels and ten parts, four times as much.
# Of one value or what a convolution takes beside (3.6e6).
MAX_VALUE_BYTES = 1 << 26
# Of all values, which a run might keep (7e7; 1.2e8 as int8).
MAX_MADE_BYTES = 1 << 30
# Read and written by all operators, as `Size` says.
MAX_MOVED_BYTES = 1 << 32
# As `Size` says (4.4e8).
MAX_MULTIPLICATIONS = 1 << 33
# What a row, the elements of the last dimension, costs at least to read or write: many kernels begin anew with each.
LEAST_ROW_BYTES = 64
# What an element costs at least: kernels take no less time for smaller ones.
LEAST_ELEMENT_BYTES = 4
# A product of two matrices of one element takes as long as so many multiplications in a large one.
PRODUCT_STARTS = 1 << 12
# What a first dimension that is given at run time is taken for.
MAX_BATCH = 16


@dataclass(frozen=True, slots=True)
class Size:
    """elements, made_bytes: of all values but the initializers. moved_bytes: what all operators read and write, rows
    and elements no less than LEAST_ROW_BYTES and LEAST_ELEMENT_BYTES, dearer operators a multiple of it
    (`allowed_operators.DEARER`). multiplications: of products and convolutions, with PRODUCT_STARTS for each single
    product."""

    operators: int
    elements: int
    made_bytes: int
    moved_bytes: int
    multiplications: int


@dataclass(frozen=True, slots=True)
class _Value:
    type: int
    shape: Shape

    @property
    def bytes(self) -> int:
        return prod(self.shape) * ELEMENT_BYTES[self.type]

    @property
    def moved_bytes(self) -> int:
        row = self.shape[-1] if self.shape else 1
        each = max(ELEMENT_BYTES[self.type], LEAST_ELEMENT_BYTES)
        return prod(self.shape[:-1]) * max(row * each, LEAST_ROW_BYTES)


def size_of(graph: OnnxGraph) -> Size:
    """How much one run makes, moves and multiplies; WireError for what no bundle does, with the node that does it, and
    for outputs that are not what they are declared to be."""
    if len(graph.nodes) > MAX_NODES:
        raise WireError(f"expected at most {MAX_NODES} operators, got {len(graph.nodes)}")
    values = {name: _Value(tensor.type, tensor.shape) for name, tensor in graph.initializers.items()}
    for name, declared in graph.inputs.items():
        if name in values:
            raise WireError(f"{name!r} is both an input and an initializer")
        values[name] = _bound(name, declared)
    elements = sum(prod(values[name].shape) for name in graph.inputs)
    made = sum(values[name].bytes for name in graph.inputs)
    moved = multiplications = 0
    for index, node in enumerate(graph.nodes):
        try:
            results, workspace, products = _results(node, values, graph.initializers)
            for name, value in results.items():
                if name in values:
                    raise WireError(f"{name!r} is given twice")
                values[name] = _checked(name, value)
                elements += prod(value.shape)
                made += value.bytes
        except (WireError, IndexError, ValueError, TypeError, OverflowError) as error:
            raise WireError(f"operator {index} ({node.kind!r}): {error}") from error
        touched = sum(values[name].moved_bytes for name in (*node.inputs, *results) if name)
        moved += (touched + workspace) * DEARER.get(node.kind, 1)
        multiplications += products
        for what, count, most in (
            ("makes {} bytes", made, MAX_MADE_BYTES),
            ("reads and writes {} bytes", moved, MAX_MOVED_BYTES),
            ("multiplies {} times", multiplications, MAX_MULTIPLICATIONS),
        ):
            if count > most:
                raise WireError(
                    f"operator {index} ({node.kind!r}): up to here the graph {what.format(count)}, at most {most} are "
                    "expected"
                )
    for name, declared in graph.outputs.items():
        if name not in values:
            raise WireError(f"no operator gives the output {name!r}")
        _check_output(name, declared, values[name])
    return Size(len(graph.nodes), elements, made, moved, multiplications)


def _check_output(name: str, declared: Declared, value: _Value) -> None:
    given = Declared(value.type, value.shape)
    fixed = all(isinstance(n, int) for n in declared.shape)
    if given.type != declared.type or (fixed and given.shape != declared.shape):
        raise WireError(f"output {name!r} is declared to be {declared}, but the operators give {given}")


def _bound(name: str, declared: Declared) -> _Value:
    """The largest value that an input may be."""
    shape = tuple(MAX_BATCH if axis == 0 and isinstance(n, str) else n for axis, n in enumerate(declared.shape))
    if not shape or not all(isinstance(n, int) and n > 0 for n in shape):
        raise WireError(f"input {name!r}: expected fixed dimensions but for the first, got {list(declared.shape)}")
    return _checked(name, _Value(declared.type, shape))  # pyright: ignore[reportArgumentType]


def _checked(name: str, value: _Value) -> _Value:
    if len(value.shape) > MAX_RANK or any(n < 0 for n in value.shape) or value.bytes > MAX_VALUE_BYTES:
        raise WireError(
            f"{name!r} would be {Declared(value.type, value.shape)}; expected at most {MAX_VALUE_BYTES} bytes in "
            f"{MAX_RANK} dimensions"
        )
    return value


def _results(
    node: Node, values: Mapping[str, _Value], constants: Mapping[str, Tensor]
) -> tuple[dict[str, _Value], int, int]:
    """What a node gives, by name; the bytes it takes beside; its multiplications."""
    rule = RULES.get(node.kind)
    if rule is None:
        raise WireError("not an operator that bundles use")
    give, understood = rule
    unknown = sorted(node.attributes.keys() - understood)
    if unknown:
        raise WireError(f"attributes {unknown} are not understood")
    inputs: list[_Value | None] = []
    for name in node.inputs:
        if name and name not in values:
            raise WireError(f"its input {name!r} is not there before it")
        inputs.append(values[name] if name else None)
    known = Known(node, tuple(None if one is None else one.shape for one in inputs), constants)
    shapes = give(known)
    if len(node.outputs) > len(shapes):
        raise WireError(f"{len(node.outputs)} outputs, expected at most {len(shapes)}")
    multiplies = MULTIPLIES.get(node.kind)
    types = types_given(node, [None if one is None else one.type for one in inputs], multiplies=multiplies is not None)
    types += types[-1:] * (len(shapes) - len(types))
    given = (_Value(*one) for one in zip(types, shapes, strict=True))
    results = {name: value for name, value in zip(node.outputs, given, strict=False) if name}
    beside = BESIDE.get(node.kind)
    workspace = 0 if beside is None else _checked("what it takes beside", _Value(FLOAT, beside(known))).moved_bytes
    if multiplies is None:
        return results, workspace, 0
    # One for each image and group, or for each matrix of a batch.
    starts = shapes[0][0] * known.attribute("group", 1) if node.kind in BESIDE else prod(shapes[0][:-2])
    return results, workspace, prod(shapes[0]) * multiplies(known) + starts * PRODUCT_STARTS
