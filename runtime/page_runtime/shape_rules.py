"""The shape of what each ONNX operator gives, from the shapes of its inputs and without computing it.

A rule takes what is `Known` of a node's inputs and returns a shape for each of its outputs, in their order. It raises
WireError for inputs that do not fit each other, and for a shape that depends on values only a run of the graph gives.
Which operator has which rule: `allowed_operators`. How large shapes may be: `graph_limits`.
Operators: https://onnx.ai/onnx/operators
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from page_runtime.onnx_file import Node, Tensor
from page_runtime.wire import WireError

Shape = tuple[int, ...]

# Pieces of a Split: its num_outputs may be any number, whatever outputs it names.
MAX_SPLIT = 4096


@dataclass(frozen=True, eq=False, slots=True)
class Known:
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


def same(known: Known) -> list[Shape]:
    """As the first input."""
    return [known.shape(0)]


def broadcast(known: Known) -> list[Shape]:
    """All inputs, broadcast as numpy does."""
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


def matmul(known: Known) -> list[Shape]:
    """MatMul: the inputs' batched product."""
    return [_product(known.shape(0), known.shape(1))]


def quantized_matmul(known: Known) -> list[Shape]:
    """QLinearMatMul: as `matmul`, of the inputs 0 and 3."""
    return [_product(known.shape(0), known.shape(3))]


def gemm(known: Known) -> list[Shape]:
    """Gemm: the product of two matrices, either transposed."""
    left, right = known.shape(0), known.shape(1)
    left = left[::-1] if known.attribute("transA", 0) else left
    right = right[::-1] if known.attribute("transB", 0) else right
    if len(left) != 2 or len(right) != 2:
        raise WireError("expected two matrices")
    return [_product(left, right)]


def convolution(known: Known, kernel_input: int = 1) -> list[Shape]:
    """Conv: images (N,C,...) by kernels (M,C/group,...), to (N,M,...)."""
    image, kernel = known.shape(0), known.shape(kernel_input)
    group = known.attribute("group", 1)
    space = len(image) - 2
    # Those over more dimensions take ten times as long.
    if space not in (1, 2):
        raise WireError(f"a convolution over {space} dimensions, expected 1 or 2")
    if len(kernel) != len(image) or group < 1 or image[1] != kernel[1] * group or kernel[0] % group:
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


def quantized_convolution(known: Known) -> list[Shape]:
    """QLinearConv: as `convolution`, the kernel being input 3."""
    return convolution(known, 3)


def reduced(known: Known) -> list[Shape]:
    """Reduce...: axes from the attribute or, in newer opsets, from input 1."""
    shape = known.shape(0)
    axes = known.attribute("axes", None)
    axes = known.whole(1, []) if axes is None else axes
    if not axes:
        axes = [] if known.attribute("noop_with_empty_axes", 0) else list(range(len(shape)))
    over = {_axis(axis, len(shape)) for axis in axes}
    if known.attribute("keepdims", 1):
        return [tuple(1 if i in over else n for i, n in enumerate(shape))]
    return [tuple(n for i, n in enumerate(shape) if i not in over)]


def reshaped(known: Known) -> list[Shape]:
    """Reshape: 0 keeps a length, -1 is what is left."""
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


def transposed(known: Known) -> list[Shape]:
    """Transpose: without perm, in reverse."""
    shape = known.shape(0)
    order = known.attribute("perm", list(range(len(shape)))[::-1])
    if sorted(order) != list(range(len(shape))):
        raise WireError(f"an order {order} of {len(shape)} dimensions")
    return [tuple(shape[i] for i in order)]


def concatenated(known: Known) -> list[Shape]:
    """Concat: the inputs may differ along its axis only."""
    first = known.shape(0)
    axis = _axis(known.attribute("axis", 0), len(first))
    shapes = [known.shape(i) for i in range(len(known.shapes))]
    if any(len(s) != len(first) or s[:axis] + s[axis + 1 :] != first[:axis] + first[axis + 1 :] for s in shapes):
        raise WireError(f"a concatenation of {[list(s) for s in shapes]}")
    return [(*first[:axis], sum(s[axis] for s in shapes), *first[axis + 1 :])]


def split(known: Known) -> list[Shape]:
    """Split: lengths from input 1, or num_outputs even ones, of which the last may be shorter."""
    shape = known.shape(0)
    axis = _axis(known.attribute("axis", 0), len(shape))
    count = known.attribute("num_outputs", len(known.node.outputs))
    if not 0 < count <= MAX_SPLIT:
        raise WireError(f"{count} outputs")
    each = -(-shape[axis] // count)
    even = [min(each, max(shape[axis] - i * each, 0)) for i in range(count)]
    lengths = known.whole(1, even)
    if sum(lengths) != shape[axis] or min(lengths) < 0:
        raise WireError(f"{shape[axis]} split into {lengths}")
    return [(*shape[:axis], n, *shape[axis + 1 :]) for n in lengths]


def sliced(known: Known) -> list[Shape]:
    """Slice: as numpy does."""
    shape = list(known.shape(0))
    starts, ends = known.whole(1), known.whole(2)
    axes = known.whole(3, list(range(len(starts))))
    steps = known.whole(4, [1] * len(starts))
    for start, end, axis, step in zip(starts, ends, axes, steps, strict=True):
        axis = _axis(axis, len(shape))
        shape[axis] = len(range(*slice(start, end, step).indices(shape[axis])))
    return [tuple(shape)]


def gathered(known: Known) -> list[Shape]:
    """Gather: the axis gives way to the dimensions of the index."""
    data, index = known.shape(0), known.shape(1)
    axis = _axis(known.attribute("axis", 0), len(data))
    return [data[:axis] + index + data[axis + 1 :]]


def gathered_by_batch(known: Known) -> list[Shape]:
    """GatherND: the index's last dimension is a place."""
    data, index = known.shape(0), known.shape(1)
    batch = known.attribute("batch_dims", 0)
    if not index or not 0 <= batch < min(len(data), len(index)) or index[-1] + batch > len(data):
        raise WireError(f"{list(index)} gathered from {list(data)}")
    return [index[:-1] + data[batch + index[-1] :]]


def unsqueezed(known: Known) -> list[Shape]:
    """Unsqueeze: axes of the result."""
    shape = list(known.shape(0))
    axes = known.whole(1)
    rank = len(shape) + len(axes)
    for axis in sorted({_axis(axis, rank) for axis in axes}):
        shape.insert(axis, 1)
    return [tuple(shape)]


def squeezed(known: Known) -> list[Shape]:
    """Squeeze: without axes, all of length 1."""
    shape = known.shape(0)
    axes = {_axis(axis, len(shape)) for axis in known.whole(1, [i for i, n in enumerate(shape) if n == 1])}
    if any(shape[axis] != 1 for axis in axes):
        raise WireError(f"{list(shape)} squeezed at {sorted(axes)}")
    return [tuple(n for i, n in enumerate(shape) if i not in axes)]


def expanded(known: Known) -> list[Shape]:
    """Expand: broadcast to the lengths of input 1."""
    wanted = known.whole(1)
    if any(n < 1 for n in wanted):
        raise WireError(f"expanded to {wanted}")
    return [tuple(int(n) for n in np.broadcast_shapes(known.shape(0), tuple(wanted)))]


def resized(known: Known) -> list[Shape]:
    """Resize: to the sizes of input 3, or by the scales of input 2."""
    shape = known.shape(0)
    if known.attribute("keep_aspect_ratio_policy", "stretch") != "stretch":
        raise WireError("only sizes that are stretched to are understood")
    if len(shape) > 4:
        raise WireError(f"{len(shape)} dimensions; expected at most 4, images: more take ten times as long")
    # The others weigh as many values of the input for each of the result as the scales say.
    if known.attribute("mode", "nearest") not in ("nearest", "linear") or known.attribute("antialias", 0):
        raise WireError("only the modes 'nearest' and 'linear' without antialias are understood")
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


def dynamically_quantized(known: Known) -> list[Shape]:
    """DynamicQuantizeLinear: the values, their scale and zero point."""
    return [known.shape(0), (), ()]
