"""How large the values of a graph become and how much it computes, found without computing it.

A file of a few bytes can ask for a matrix of 10^12 elements: a column times a row, or thirty concatenations of a value
with itself. onnxruntime would make it while it loads, as both are constants. Here each operator a bundle may use says
the shape of what it gives; an operator without such a rule is refused, and so is what is too large.
Operators: https://onnx.ai/onnx/operators
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from page_runtime.onnx_file import Node, OnnxGraph, Tensor
from page_runtime.wire import WireError

Shape = tuple[int, ...]

MAX_NODES = 4096
MAX_RANK = 8
# Per value and of all together. The shipped networks' largest value has 5e5 elements, all of them 1e7.
MAX_ELEMENTS = 1 << 24
MAX_TOTAL_ELEMENTS = 1 << 28
# The shipped networks multiply 4e8 times.
MAX_MULTIPLICATIONS = 1 << 36
# What a first dimension that is given at run time is taken for.
MAX_BATCH = 16


@dataclass(frozen=True, eq=False, slots=True)
class _Known:
    """What is known of a node's inputs. shapes: None for an input left out."""

    node: Node
    shapes: tuple[Shape | None, ...]
    constants: Mapping[str, Tensor]

    def shape(self, index: int) -> Shape:
        shape = self.shapes[index] if index < len(self.shapes) else None
        if shape is None:
            raise WireError(f"input {index} is missing")
        return shape

    def whole(self, index: int, default: list[int] | None = None) -> list[int]:
        """The whole numbers of an input that decides on sizes; it must be an initializer."""
        name = self.node.inputs[index] if index < len(self.node.inputs) else ""
        if not name:
            if default is None:
                raise WireError(f"input {index} is missing")
            return default
        tensor = self.constants.get(name)
        if tensor is None or tensor.values is None or tensor.values.dtype.kind != "i":
            raise WireError(f"input {index} ({name!r}) decides on sizes: expected an initializer of few whole numbers")
        return [int(value) for value in tensor.values.ravel()]

    def numbers(self, index: int) -> list[float]:
        """The same for an input of float32."""
        name = self.node.inputs[index] if index < len(self.node.inputs) else ""
        tensor = self.constants.get(name)
        if tensor is None or tensor.values is None:
            raise WireError(f"input {index} ({name!r}) decides on sizes: expected an initializer of few numbers")
        return [float(value) for value in tensor.values.ravel()]

    def attribute(self, name: str, default: Any) -> Any:
        return self.node.attributes.get(name, default)


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
    known = _Known(node, tuple(inputs), constants)
    given = give(known)
    if len(node.outputs) > len(given):
        raise WireError(f"{len(node.outputs)} outputs, expected at most {len(given)}")
    results = {name: shape for name, shape in zip(node.outputs, given, strict=False) if name}
    multiplies = _MULTIPLIES.get(node.kind)
    return results, 0 if multiplies is None else prod(given[0]) * multiplies(known)


def _same(known: _Known) -> list[Shape]:
    return [known.shape(0)]


def _broadcast(known: _Known) -> list[Shape]:
    given = [shape for shape in known.shapes if shape is not None]
    if len(given) != len(known.shapes) or not given:
        raise WireError("an input is missing")
    return [tuple(int(n) for n in np.broadcast_shapes(*given))]


def _axis(axis: int, rank: int) -> int:
    if not -rank <= axis < rank:
        raise WireError(f"axis {axis} of {rank} dimensions")
    return axis % rank


def _product(left: Shape, right: Shape) -> Shape:
    if not left or not right or left[-1] != right[-2 if len(right) > 1 else 0]:
        raise WireError(f"a product of {list(left)} and {list(right)}")
    batch = tuple(int(n) for n in np.broadcast_shapes(left[:-2], right[:-2]))
    return batch + left[-2:-1] + (right[-1:] if len(right) > 1 else ())


def _matmul(known: _Known) -> list[Shape]:
    return [_product(known.shape(0), known.shape(1))]


def _quantized_matmul(known: _Known) -> list[Shape]:
    return [_product(known.shape(0), known.shape(3))]


def _gemm(known: _Known) -> list[Shape]:
    left, right = known.shape(0), known.shape(1)
    left = left[::-1] if known.attribute("transA", 0) else left
    right = right[::-1] if known.attribute("transB", 0) else right
    if len(left) != 2 or len(right) != 2:
        raise WireError("expected two matrices")
    return [_product(left, right)]


def _convolution(known: _Known, kernel_input: int = 1) -> list[Shape]:
    image, kernel = known.shape(0), known.shape(kernel_input)
    group = known.attribute("group", 1)
    space = len(image) - 2
    if space < 1 or len(kernel) != len(image) or group < 1 or image[1] != kernel[1] * group or kernel[0] % group:
        raise WireError(f"a convolution of {list(image)} by {list(kernel)}, group {group}")
    if known.attribute("auto_pad", "NOTSET") not in ("NOTSET", "") or min(kernel[2:]) < 1:
        raise WireError("auto_pad or an empty kernel")
    strides = known.attribute("strides", [1] * space)
    dilations = known.attribute("dilations", [1] * space)
    pads = known.attribute("pads", [0] * 2 * space)
    if len(strides) != space or len(dilations) != space or len(pads) != 2 * space:
        raise WireError("strides, dilations or pads of other dimensions")
    if min(strides) < 1 or min(dilations) < 1 or min(pads) < 0:
        raise WireError("strides and dilations from 1, pads from 0 are expected")
    if known.attribute("kernel_shape", list(kernel[2:])) != list(kernel[2:]):
        raise WireError("kernel_shape is not the kernel's")
    size = tuple(
        (image[2 + i] + pads[i] + pads[space + i] - dilations[i] * (kernel[2 + i] - 1) - 1) // strides[i] + 1
        for i in range(space)
    )
    return [(image[0], kernel[0], *size)]


def _quantized_convolution(known: _Known) -> list[Shape]:
    return _convolution(known, 3)


def _reduced(known: _Known) -> list[Shape]:
    shape = known.shape(0)
    axes = known.attribute("axes", None)
    axes = known.whole(1, []) if axes is None else axes
    if not axes:
        axes = [] if known.attribute("noop_with_empty_axes", 0) else list(range(len(shape)))
    over = {_axis(axis, len(shape)) for axis in axes}
    if known.attribute("keepdims", 1):
        return [tuple(1 if i in over else n for i, n in enumerate(shape))]
    return [tuple(n for i, n in enumerate(shape) if i not in over)]


def _reshaped(known: _Known) -> list[Shape]:
    shape, wanted = known.shape(0), known.whole(1)
    if not known.attribute("allowzero", 0):
        wanted = [shape[i] if n == 0 else n for i, n in enumerate(wanted)]
    if wanted.count(-1) > 1 or any(n < -1 for n in wanted):
        raise WireError(f"reshaped to {wanted}")
    rest = prod(n for n in wanted if n != -1)
    if -1 in wanted:
        if rest == 0 or prod(shape) % rest:
            raise WireError(f"{list(shape)} reshaped to {wanted}")
        wanted = [prod(shape) // rest if n == -1 else n for n in wanted]
    if prod(wanted) != prod(shape):
        raise WireError(f"{list(shape)} reshaped to {wanted}")
    return [tuple(wanted)]


def _transposed(known: _Known) -> list[Shape]:
    shape = known.shape(0)
    order = known.attribute("perm", list(range(len(shape)))[::-1])
    if sorted(order) != list(range(len(shape))):
        raise WireError(f"an order {order} of {len(shape)} dimensions")
    return [tuple(shape[i] for i in order)]


def _concatenated(known: _Known) -> list[Shape]:
    first = known.shape(0)
    axis = _axis(known.attribute("axis", 0), len(first))
    shapes = [known.shape(i) for i in range(len(known.shapes))]
    if any(len(s) != len(first) or s[:axis] + s[axis + 1 :] != first[:axis] + first[axis + 1 :] for s in shapes):
        raise WireError(f"a concatenation of {[list(s) for s in shapes]}")
    return [(*first[:axis], sum(s[axis] for s in shapes), *first[axis + 1 :])]


def _split(known: _Known) -> list[Shape]:
    shape = known.shape(0)
    axis = _axis(known.attribute("axis", 0), len(shape))
    count = known.attribute("num_outputs", len(known.node.outputs))
    if not 0 < count <= MAX_NODES:
        raise WireError(f"{count} outputs")
    each = -(-shape[axis] // count)
    even = [min(each, max(shape[axis] - i * each, 0)) for i in range(count)]
    lengths = known.whole(1, even)
    if sum(lengths) != shape[axis] or min(lengths) < 0:
        raise WireError(f"{shape[axis]} split into {lengths}")
    return [(*shape[:axis], n, *shape[axis + 1 :]) for n in lengths]


def _sliced(known: _Known) -> list[Shape]:
    shape = list(known.shape(0))
    starts, ends = known.whole(1), known.whole(2)
    axes = known.whole(3, list(range(len(starts))))
    steps = known.whole(4, [1] * len(starts))
    for start, end, axis, step in zip(starts, ends, axes, steps, strict=True):
        axis = _axis(axis, len(shape))
        shape[axis] = len(range(*slice(start, end, step).indices(shape[axis])))
    return [tuple(shape)]


def _gathered(known: _Known) -> list[Shape]:
    data, index = known.shape(0), known.shape(1)
    axis = _axis(known.attribute("axis", 0), len(data))
    return [data[:axis] + index + data[axis + 1 :]]


def _gathered_by_batch(known: _Known) -> list[Shape]:
    data, index = known.shape(0), known.shape(1)
    batch = known.attribute("batch_dims", 0)
    if not index or not 0 <= batch < min(len(data), len(index)) or index[-1] + batch > len(data):
        raise WireError(f"{list(index)} gathered from {list(data)}")
    return [index[:-1] + data[batch + index[-1] :]]


def _unsqueezed(known: _Known) -> list[Shape]:
    shape = list(known.shape(0))
    axes = known.whole(1)
    rank = len(shape) + len(axes)
    for axis in sorted({_axis(axis, rank) for axis in axes}):
        shape.insert(axis, 1)
    return [tuple(shape)]


def _squeezed(known: _Known) -> list[Shape]:
    shape = known.shape(0)
    axes = {_axis(axis, len(shape)) for axis in known.whole(1, [i for i, n in enumerate(shape) if n == 1])}
    if any(shape[axis] != 1 for axis in axes):
        raise WireError(f"{list(shape)} squeezed at {sorted(axes)}")
    return [tuple(n for i, n in enumerate(shape) if i not in axes)]


def _expanded(known: _Known) -> list[Shape]:
    wanted = known.whole(1)
    if any(n < 1 for n in wanted):
        raise WireError(f"expanded to {wanted}")
    return [tuple(int(n) for n in np.broadcast_shapes(known.shape(0), tuple(wanted)))]


def _resized(known: _Known) -> list[Shape]:
    shape = known.shape(0)
    if known.attribute("keep_aspect_ratio_policy", "stretch") != "stretch":
        raise WireError("only sizes that are stretched to are understood")
    if len(known.node.inputs) > 3:
        sizes = known.whole(3)
    else:
        scales = known.numbers(2)
        if len(scales) != len(shape) or not all(0 < s <= 64 for s in scales):
            raise WireError(f"{list(shape)} resized by {scales}")
        sizes = [int(n * s) for n, s in zip(shape, scales, strict=True)]
    if len(sizes) != len(shape):
        raise WireError(f"{list(shape)} resized to {sizes}")
    return [tuple(sizes)]


def _dynamically_quantized(known: _Known) -> list[Shape]:
    return [known.shape(0), (), ()]


Rule = tuple[Callable[[_Known], list[Shape]], frozenset[str]]
_CONVOLUTION = ("auto_pad", "dilations", "group", "kernel_shape", "pads", "strides")
_RESIZE = (
    *("antialias", "coordinate_transformation_mode", "cubic_coeff_a", "exclude_outside", "extrapolation_value"),
    *("keep_aspect_ratio_policy", "mode", "nearest_mode"),
)


def _rules(give: Callable[[_Known], list[Shape]], kinds: str, *attributes: str) -> dict[str, Rule]:
    return dict.fromkeys(kinds.split(), (give, frozenset(attributes)))


# What bundles may use: the operators of the exported networks, whole and quantised, and a few of their kind.
RULES: dict[str, Rule] = {
    **_rules(_same, "Abs Clip Exp Floor Identity Log Neg Reciprocal Relu Sigmoid Sqrt"),
    **_rules(_same, "Cast", "to", "saturate"),
    **_rules(_same, "Softmax", "axis"),
    **_rules(_same, "LayerNormalization", "axis", "epsilon", "stash_type"),
    **_rules(_same, "QuantizeLinear", "axis", "saturate"),
    **_rules(_same, "DequantizeLinear", "axis"),
    **_rules(_dynamically_quantized, "DynamicQuantizeLinear"),
    **_rules(_broadcast, "Add Div Equal Greater Less Max Min Mul Pow Sub Where"),
    **_rules(_matmul, "MatMul MatMulInteger"),
    **_rules(_quantized_matmul, "QLinearMatMul"),
    **_rules(_gemm, "Gemm", "alpha", "beta", "transA", "transB"),
    **_rules(_convolution, "Conv ConvInteger", *_CONVOLUTION),
    **_rules(_quantized_convolution, "QLinearConv", *_CONVOLUTION),
    **_rules(_reduced, "ReduceL2 ReduceMax ReduceMean ReduceMin ReduceSum", "axes", "keepdims", "noop_with_empty_axes"),
    **_rules(_reshaped, "Reshape", "allowzero"),
    **_rules(_transposed, "Transpose", "perm"),
    **_rules(_concatenated, "Concat", "axis"),
    **_rules(_split, "Split", "axis", "num_outputs"),
    **_rules(_sliced, "Slice"),
    **_rules(_gathered, "Gather", "axis"),
    **_rules(_gathered_by_batch, "GatherND", "batch_dims"),
    **_rules(_unsqueezed, "Unsqueeze"),
    **_rules(_squeezed, "Squeeze"),
    **_rules(_expanded, "Expand"),
    **_rules(_resized, "Resize", *_RESIZE),
}


def _inner(known: _Known) -> int:
    return known.shape(0)[-2 if known.attribute("transA", 0) else -1]


# Multiplications for each element of the first output.
_MULTIPLIES: dict[str, Callable[[_Known], int]] = {
    **dict.fromkeys(("MatMul", "MatMulInteger", "QLinearMatMul", "Gemm"), _inner),
    **dict.fromkeys(("Conv", "ConvInteger"), lambda known: prod(known.shape(1)[1:])),
    "QLinearConv": lambda known: prod(known.shape(3)[1:]),
}
