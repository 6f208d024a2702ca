"""The operators a bundle may use: for each its shape rule, the attributes that are understood, and what it multiplies.

What is not in the tables is refused by `graph_limits`.
"""

from __future__ import annotations

from collections.abc import Callable
from math import prod

from page_runtime import shape_rules
from page_runtime.shape_rules import Known, Shape

Rule = tuple[Callable[[Known], list[Shape]], frozenset[str]]
_CONVOLUTION = ("auto_pad", "dilations", "group", "kernel_shape", "pads", "strides")
_RESIZE = (
    *("antialias", "coordinate_transformation_mode", "cubic_coeff_a", "exclude_outside", "extrapolation_value"),
    *("keep_aspect_ratio_policy", "mode", "nearest_mode"),
)


def _rules(give: Callable[[Known], list[Shape]], kinds: str, *attributes: str) -> dict[str, Rule]:
    return dict.fromkeys(kinds.split(), (give, frozenset(attributes)))


# What bundles may use: the operators of the exported networks, whole and quantised, and a few of their kind.
RULES: dict[str, Rule] = {
    **_rules(shape_rules.same, "Abs Clip Exp Floor Identity Log Neg Reciprocal Relu Sigmoid Sqrt"),
    **_rules(shape_rules.same, "Cast", "to", "saturate"),
    **_rules(shape_rules.same, "Softmax", "axis"),
    **_rules(shape_rules.same, "LayerNormalization", "axis", "epsilon", "stash_type"),
    **_rules(shape_rules.same, "QuantizeLinear", "axis", "saturate"),
    **_rules(shape_rules.same, "DequantizeLinear", "axis"),
    **_rules(shape_rules.dynamically_quantized, "DynamicQuantizeLinear"),
    **_rules(shape_rules.broadcast, "Add Div Equal Greater Less Max Min Mul Pow Sub Where"),
    **_rules(shape_rules.matmul, "MatMul MatMulInteger"),
    **_rules(shape_rules.quantized_matmul, "QLinearMatMul"),
    **_rules(shape_rules.gemm, "Gemm", "alpha", "beta", "transA", "transB"),
    **_rules(shape_rules.convolution, "Conv ConvInteger", *_CONVOLUTION),
    **_rules(shape_rules.quantized_convolution, "QLinearConv", *_CONVOLUTION),
    **_rules(
        shape_rules.reduced,
        "ReduceL2 ReduceMax ReduceMean ReduceMin ReduceSum",
        "axes",
        "keepdims",
        "noop_with_empty_axes",
    ),
    **_rules(shape_rules.reshaped, "Reshape", "allowzero"),
    **_rules(shape_rules.transposed, "Transpose", "perm"),
    **_rules(shape_rules.concatenated, "Concat", "axis"),
    **_rules(shape_rules.split, "Split", "axis", "num_outputs"),
    **_rules(shape_rules.sliced, "Slice"),
    **_rules(shape_rules.gathered, "Gather", "axis"),
    **_rules(shape_rules.gathered_by_batch, "GatherND", "batch_dims"),
    **_rules(shape_rules.unsqueezed, "Unsqueeze"),
    **_rules(shape_rules.squeezed, "Squeeze"),
    **_rules(shape_rules.expanded, "Expand"),
    **_rules(shape_rules.resized, "Resize", *_RESIZE),
}


def _inner(known: Known) -> int:
    return known.shape(0)[-2 if known.attribute("transA", 0) else -1]


def _expanded(known: Known, kernel_input: int = 1) -> Shape:
    """The matrix that a convolution is a product with: its input, repeated for each place of the kernel."""
    (given,) = shape_rules.convolution(known, kernel_input)
    kernel = known.shape(kernel_input)
    return (prod(kernel[1:]) * known.attribute("group", 1), given[0] * prod(given[2:]))


def _channels(known: Known) -> Shape:
    """A row of one for each run of elements of the same scale, where there are several scales."""
    shape, scales = known.shape(0), prod(known.shape(1))
    axis = known.attribute("axis", 1)
    return (1,) if scales == 1 or not shape else (prod(shape[: axis % len(shape) + 1]), 1)


# What an operator moves beside its inputs and outputs: float32 of this shape.
BESIDE: dict[str, Callable[[Known], Shape]] = {
    **dict.fromkeys(("Conv", "ConvInteger"), _expanded),
    "QLinearConv": lambda known: _expanded(known, 3),
    **dict.fromkeys(("QuantizeLinear", "DequantizeLinear"), _channels),
}

# Operators whose kernels take longer for a byte than those that copy or add, by about how much (onnxruntime 1.31, one
# thread, their dearest shapes): 2^32 bytes take additions 1.2 s, transposing eight dimensions 33.
DEARER: dict[str, int] = {
    "Gather": 4,
    "GatherND": 8,
    "LayerNormalization": 2,
    "Pow": 4,
    "Resize": 8,
    "Softmax": 8,
    "Transpose": 16,
}

# Multiplications for each element of the first output.
MULTIPLIES: dict[str, Callable[[Known], int]] = {
    **dict.fromkeys(("MatMul", "MatMulInteger", "QLinearMatMul", "Gemm"), _inner),
    **dict.fromkeys(("Conv", "ConvInteger"), lambda known: prod(known.shape(1)[1:])),
    "QLinearConv": lambda known: prod(known.shape(3)[1:]),
}
