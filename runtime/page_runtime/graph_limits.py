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

from page_runtime.allowed_operators import MULTIPLIES, RULES
from page_runtime.onnx_file import Node, OnnxGraph, Tensor
from page_runtime.shape_rules import Known, Shape
from page_runtime.wire import WireError

MAX_NODES = 4096
MAX_RANK = 8
# Per value and of all together. The shipped networks' largest value has 5e5 elements, all of them 1e7.
MAX_ELEMENTS = 1 << 24
MAX_TOTAL_ELEMENTS = 1 << 28
# The shipped networks multiply 4e8 times.
MAX_MULTIPLICATIONS = 1 << 36
# What a first dimension that is given at run time is taken for.
MAX_BATCH = 16


@dataclass(frozen=True, slots=True)
class Size:
    """elements: of all values but the initializers; multiplications: of products and convolutions."""

    operators: int
    elements: int
    multiplications: int


def size_of(graph: OnnxGraph) -> Size:
    """How much one run makes and multiplies; WireError for what no bundle does, with the node that does it."""
    if len(graph.nodes) > MAX_NODES:
        raise WireError(f"expected at most {MAX_NODES} operators, got {len(graph.nodes)}")
    shapes: dict[str, Shape] = {name: tensor.shape for name, tensor in graph.initializers.items()}
    for name, declared in graph.inputs.items():
        if name in shapes:
            raise WireError(f"{name!r} is both an input and an initializer")
        shapes[name] = _bound(name, declared)
    elements = sum(prod(shapes[name]) for name in graph.inputs)
    multiplications = 0
    for index, node in enumerate(graph.nodes):
        try:
            results, cost = _results(node, shapes, graph.initializers)
            for name, shape in results.items():
                if name in shapes:
                    raise WireError(f"{name!r} is given twice")
                elements += _checked(name, shape)
                shapes[name] = shape
        except (WireError, IndexError, ValueError, TypeError, OverflowError) as error:
            raise WireError(f"operator {index} ({node.kind!r}): {error}") from error
        multiplications += cost
        if elements > MAX_TOTAL_ELEMENTS or multiplications > MAX_MULTIPLICATIONS:
            raise WireError(
                f"operator {index} ({node.kind!r}): the graph makes more than {MAX_TOTAL_ELEMENTS} elements or "
                f"multiplies more than {MAX_MULTIPLICATIONS} times"
            )
    missing = sorted(graph.outputs.keys() - shapes.keys())
    if missing:
        raise WireError(f"no operator gives the outputs {missing}")
    return Size(len(graph.nodes), elements, multiplications)


def _bound(name: str, declared: tuple[int | str, ...]) -> Shape:
    """The largest shape an input may have."""
    shape = tuple(MAX_BATCH if axis == 0 and isinstance(n, str) else n for axis, n in enumerate(declared))
    if not shape or not all(isinstance(n, int) and n > 0 for n in shape):
        raise WireError(f"input {name!r}: expected fixed dimensions but for the first, got {list(declared)}")
    _checked(name, shape)  # pyright: ignore[reportArgumentType]
    return shape  # pyright: ignore[reportReturnType]


def _checked(name: str, shape: Shape) -> int:
    count = prod(shape)
    if len(shape) > MAX_RANK or any(n < 0 for n in shape) or count > MAX_ELEMENTS:
        raise WireError(f"{name!r} would be {list(shape)}; expected at most {MAX_ELEMENTS} elements")
    return count


def _results(node: Node, shapes: Mapping[str, Shape], constants: Mapping[str, Tensor]) -> tuple[dict[str, Shape], int]:
    """The shapes a node gives, by name, and its multiplications."""
    rule = RULES.get(node.kind)
    if rule is None:
        raise WireError("not an operator that bundles use")
    give, understood = rule
    unknown = sorted(node.attributes.keys() - understood)
    if unknown:
        raise WireError(f"attributes {unknown} are not understood")
    inputs: list[Shape | None] = []
    for name in node.inputs:
        if name and name not in shapes:
            raise WireError(f"its input {name!r} is not there before it")
        inputs.append(shapes[name] if name else None)
    known = Known(node, tuple(inputs), constants)
    given = give(known)
    if len(node.outputs) > len(given):
        raise WireError(f"{len(node.outputs)} outputs, expected at most {len(given)}")
    results = {name: shape for name, shape in zip(node.outputs, given, strict=False) if name}
    multiplies = MULTIPLIES.get(node.kind)
    return results, 0 if multiplies is None else prod(given[0]) * multiplies(known)
