"""Files with a right checksum that a bundle must not be: what each does to a sound one, and why it is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def initializer(model: onnx.ModelProto, name: str, value: Any, dtype: type = np.float32) -> str:
    model.graph.initializer.append(numpy_helper.from_array(np.asarray(value, dtype), name))
    return name


def operator(model: onnx.ModelProto, kind: str, inputs: list[str], output: str = "bomb", **attributes: Any) -> None:
    model.graph.node.append(helper.make_node(kind, inputs, [output], **attributes))


def some_graph() -> onnx.GraphProto:
    value = helper.make_tensor_value_info("inner", TensorProto.FLOAT, [1])
    node = helper.make_node("Identity", ["points"], ["inner"])
    return helper.make_graph([node], "inner", [], [value])


def external_data(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"


def giant_tensor(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    del tensor.dims[:]
    tensor.dims.extend([1 << 40])


def overflowing_tensor(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    del tensor.dims[:]
    tensor.dims.extend([1 << 32, 1 << 32])
    tensor.raw_data = b""


def column_times_row(model: onnx.ModelProto) -> None:
    column, row = np.ones((1 << 17, 1)), np.ones((1, 1 << 17))
    operator(model, "MatMul", [initializer(model, "column", column), initializer(model, "row", row)])


def column_plus_row(model: onnx.ModelProto) -> None:
    column, row = np.ones((1 << 17, 1)), np.ones((1, 1 << 17))
    operator(model, "Add", [initializer(model, "column", column), initializer(model, "row", row)])


def doubled_forty_times(model: onnx.ModelProto) -> None:
    name = initializer(model, "single", [1.0])
    for step in range(40):
        operator(model, "Concat", [name, name], f"twice{step}", axis=0)
        name = f"twice{step}"


def expanded(model: onnx.ModelProto) -> None:
    operator(model, "Expand", [initializer(model, "single", [1.0]), initializer(model, "wide", [1 << 40], np.int64)])


def expanded_to_a_computed_shape(model: onnx.ModelProto) -> None:
    operator(model, "Cast", ["up1"], "computed", to=TensorProto.INT64)
    operator(model, "Expand", [initializer(model, "single", [1.0]), "computed"])


def enlarged(model: onnx.ModelProto) -> None:
    operator(model, "Resize", ["image", "", initializer(model, "scales", [1, 1, 60, 60])])


def gathered(model: onnx.ModelProto) -> None:
    rows = initializer(model, "rows", np.ones((1, 1 << 16)))
    operator(model, "Gather", [rows, initializer(model, "index", np.zeros(1 << 16), np.int64)])


def padded_convolution(model: onnx.ModelProto) -> None:
    kernel = initializer(model, "kernel", np.ones((1, 3, 1, 1)))
    operator(model, "Conv", ["image", kernel], pads=[1 << 20] * 4)


def many_multiplications(model: onnx.ModelProto) -> None:
    name = initializer(model, "square", np.ones((1 << 11, 1 << 11)))
    for step in range(10):
        operator(model, "MatMul", [name, name], f"product{step}")
        name = f"product{step}"


def large(model: onnx.ModelProto, elements: int = 1 << 23) -> str:
    """A constant of so many numbers that takes few bytes of the file."""
    single, wide = initializer(model, "single", [1.0]), initializer(model, "wide", [elements], np.int64)
    operator(model, "Expand", [single, wide], "large")
    return "large"


def cast_to_texts(model: onnx.ModelProto) -> None:
    operator(model, "Cast", [large(model)], to=TensorProto.STRING)


def many_reductions(model: onnx.ModelProto) -> None:
    name = large(model)
    axes = initializer(model, "all", [0], np.int64)
    for step in range(200):
        operator(model, "ReduceSum", [name, axes], f"sum{step}")


def many_large_values(model: onnx.ModelProto) -> None:
    name = large(model)
    for step in range(40):
        operator(model, "Neg", [name], f"negative{step}")


def many_dear_values(model: onnx.ModelProto) -> None:
    """Within the limit if they were copies."""
    shape = initializer(model, "shape", [8, 8, 8, 8, 4, 4, 8, 8], np.int64)
    operator(model, "Reshape", [large(model, 1 << 22), shape], "cube")
    for step in range(12):
        operator(model, "Transpose", ["cube"], f"turned{step}")


def many_short_rows(model: onnx.ModelProto) -> None:
    shape = initializer(model, "shape", [1 << 22, 1], np.int64)
    operator(model, "Cast", [large(model, 1 << 22)], "flags", to=TensorProto.BOOL)
    operator(model, "Reshape", ["flags", shape], "rows")
    for step in range(9):
        operator(model, "Equal", ["rows", "rows"], f"equal{step}")


def many_small_products(model: onnx.ModelProto) -> None:
    shape = initializer(model, "shape", [1 << 22, 1, 1], np.int64)
    operator(model, "Reshape", [large(model, 1 << 22), shape], "matrices")
    operator(model, "MatMul", ["matrices", "matrices"])


def products_of(kind: type) -> Callable[[onnx.ModelProto], None]:
    """Of floats they would be within the limit."""

    def apply(model: onnx.ModelProto) -> None:
        name = initializer(model, "square", np.ones((1 << 9, 1 << 9)), kind)
        for step in range(50):
            operator(model, "MatMul", [name, name], f"product{step}")
            name = f"product{step}"

    return apply


def scales_of_each(model: onnx.ModelProto) -> None:
    name = large(model, 1 << 21)
    for step in range(40):
        operator(model, "QuantizeLinear", [name, name], f"quantized{step}", axis=0)


def expanding_convolution(model: onnx.ModelProto) -> None:
    """Input and result are small, what is between them is 2^32 bytes."""
    operator(
        model,
        "Expand",
        [initializer(model, "single", [1], np.uint8), initializer(model, "wide", [1, 1, 2048, 2048], np.int64)],
    )
    kernel = initializer(model, "kernel", np.ones((1, 1, 32, 32)), np.int8)
    operator(model, "ConvInteger", ["bomb", kernel], "small")


def many_operators(model: onnx.ModelProto) -> None:
    for step in range(5000):
        operator(model, "Relu", ["points"], f"many{step}")


ATTACKS: dict[str, tuple[Callable[[onnx.ModelProto], Any], str]] = {
    "data outside the file": (external_data, "data outside the file"),
    "a tensor larger than its data": (giant_tensor, "needs .* bytes, got"),
    "a tensor whose size overflows": (overflowing_tensor, "needs .* bytes, got 0"),
    "a tensor of texts": (
        lambda m: m.graph.initializer.append(numpy_helper.from_array(np.array(["x"], object), "t")),
        "raw data",
    ),
    "column times row": (column_times_row, r"'MatMul'\): 'bomb' would be .*\[131072, 131072\]"),
    "column plus row": (column_plus_row, r"'Add'\): 'bomb' would be"),
    "doubled forty times": (doubled_forty_times, "'Concat'.* would be"),
    "expanded": (expanded, "'Expand'.* would be"),
    "expanded to a computed shape": (expanded_to_a_computed_shape, "decides on sizes"),
    "enlarged": (enlarged, "'Resize'.* would be"),
    "gathered": (gathered, "'Gather'.* would be"),
    "a padded convolution": (padded_convolution, "'Conv'.* would be"),
    "many multiplications": (many_multiplications, "the graph multiplies"),
    "a cast to texts": (cast_to_texts, r"'Cast'\): a cast to data type 8"),
    "many reductions": (many_reductions, "'ReduceSum'.* the graph reads and writes"),
    "many large values": (many_large_values, "'Neg'.* the graph makes"),
    "many dear values": (many_dear_values, "'Transpose'.* the graph reads and writes"),
    "many short rows": (many_short_rows, "'Equal'.* the graph reads and writes"),
    "many small products": (many_small_products, "'MatMul'.* the graph multiplies"),
    "products of doubles": (products_of(np.float64), r"'MatMul'\): it computes in double"),
    "products of long integers": (products_of(np.int64), r"'MatMul'\): products of int64"),
    "sums of doubles": (
        lambda m: operator(m, "Add", [initializer(m, "double", [1.0], np.float64), "double"]),
        r"'Add'\): it computes in double",
    ),
    "an expanding convolution": (expanding_convolution, "'ConvInteger'.* beside' would be"),
    "a convolution of seven dimensions": (
        lambda m: operator(m, "Conv", [initializer(m, "x", np.ones([1] * 7)), initializer(m, "k", np.ones([1] * 7))]),
        "a convolution over 5 dimensions",
    ),
    "a resizing of five dimensions": (
        lambda m: operator(m, "Resize", [initializer(m, "x", np.ones([1] * 5)), "", initializer(m, "s", [2.0] * 5)]),
        "expected at most 4",
    ),
    "a smooth resizing": (
        lambda m: operator(m, "Resize", ["image", "", initializer(m, "scales", [1, 1, 2, 2])], mode="cubic"),
        "the modes 'nearest' and 'linear'",
    ),
    "a scale for each number": (scales_of_each, "'QuantizeLinear'.* the graph reads and writes"),
    "an output of another size": (
        lambda m: m.graph.output[0].type.tensor_type.shape.dim[1].__setattr__("dim_value", 7),
        "output 'part_logits' is declared to be .* 7, .*, but the operators give",
    ),
    "an output of another type": (
        lambda m: m.graph.output[0].type.tensor_type.__setattr__("elem_type", TensorProto.INT32),
        "output 'part_logits' is declared to be .*, but the operators give",
    ),
    "an input of texts": (
        lambda m: m.graph.input[0].type.tensor_type.__setattr__("elem_type", TensorProto.STRING),
        "value 'image': data type 8 is not allowed",
    ),
    "many operators": (many_operators, "at most 4096 operators"),
    "a giant input": (lambda m: m.graph.input[0].type.tensor_type.shape.dim[2].__setattr__("dim_value", 1 << 40), "be"),
    "an input without a size": (lambda m: m.graph.input[1].type.tensor_type.shape.dim[1].ClearField("value"), "fixed"),
    "a graph in a node": (
        lambda m: operator(m, "If", ["points"], then_branch=some_graph(), else_branch=some_graph()),
        "a graph inside a node",
    ),
    "a tensor in a node": (
        lambda m: operator(m, "Constant", [], value=numpy_helper.from_array(np.ones(3, np.float32))),
        "a tensor inside a node",
    ),
    "an unknown operator": (lambda m: operator(m, "Frobnicate", ["points"]), "not an operator that bundles use"),
    "an operator without a bound": (lambda m: operator(m, "NonZero", ["points"]), "not an operator that bundles use"),
    "an operator of another domain": (
        lambda m: operator(m, "Gelu", ["points"], domain="com.microsoft"),
        "of the domain 'com.microsoft'",
    ),
    "another domain": (lambda m: m.opset_import.append(helper.make_opsetid("evil", 1)), "domain 'evil'"),
    "another opset": (lambda m: m.opset_import[0].__setattr__("version", 7), "expected one opset"),
    "an unknown attribute": (lambda m: operator(m, "Relu", ["points"], surprise=1), "not understood"),
    "a value from nowhere": (lambda m: operator(m, "Relu", ["nowhere"]), "is not there before it"),
    "a value given twice": (lambda m: operator(m, "Relu", ["points"], "points"), "is given twice"),
    "a cycle": (lambda m: operator(m, "Relu", ["bomb"]), "is not there before it"),
    "a sparse tensor": (lambda m: m.graph.sparse_initializer.add(), "sparse initializers"),
    "declared inner shapes": (
        lambda m: m.graph.value_info.append(helper.make_tensor_value_info("x", 1, [1])),
        "declared shapes",
    ),
    "a function": (lambda m: m.functions.add(), "functions are not allowed"),
    "a training graph": (lambda m: m.training_info.add(), "training graphs are not allowed"),
}
