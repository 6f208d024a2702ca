"""The element type of what each ONNX operator gives, and which types operators may compute with.

Types are TensorProto.DataType's numbers, those of `onnx_messages.ELEMENT_BYTES` only: texts and complex numbers take
more memory than their count says, and no bundle has any.
"""

from __future__ import annotations

from collections.abc import Sequence

from page_runtime.onnx_file import Node
from page_runtime.onnx_messages import BOOL, DOUBLE, ELEMENT_BYTES, FLOAT, HALF, INT8, INT32, TYPE_NAMES, UINT8
from page_runtime.wire import WireError

# Other products have no kernels made for the processor: int64 takes ten times as long as float.
MULTIPLIED = frozenset({FLOAT, HALF, UINT8, INT8})
# What takes double, to make something else of it. No bundle computes in it, and it takes twice the time and memory.
TAKE_DOUBLE = frozenset({"Cast", "Identity"})


# Types of all outputs.
_FIXED: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("Equal", "Greater", "Less"), (BOOL,)),
    **dict.fromkeys(("MatMulInteger", "ConvInteger"), (INT32,)),
    "DynamicQuantizeLinear": (UINT8, FLOAT, UINT8),
}
# The input whose type outputs have; of operators that are in no table, the first.
_AS_INPUT = {"Where": 1, "DequantizeLinear": 1, "QuantizeLinear": 2, "QLinearMatMul": 7, "QLinearConv": 7}


def types_given(node: Node, types: Sequence[int | None], *, multiplies: bool) -> list[int]:
    """The type of each output of a node, or one for all.

    types: of its inputs, None for one left out. multiplies: whether it is a product or a convolution. WireError for
    types that no bundle computes with.
    """
    if DOUBLE in types and node.kind not in TAKE_DOUBLE:
        raise WireError(f"it computes in {named(DOUBLE)}, which no bundle does; cast to {named(FLOAT)} before")
    if multiplies and _taken(types, 0) not in MULTIPLIED:
        raise WireError(f"products of {named(_taken(types, 0))}; expected one of {named(*sorted(MULTIPLIED))}")
    if node.kind == "Cast":
        return [_cast(node)]
    if node.kind == "QuantizeLinear" and len(types) < 3:
        return [UINT8]
    return list(_FIXED.get(node.kind) or [_taken(types, _AS_INPUT.get(node.kind, 0))])


def named(*types: int) -> str:
    """Types as onnxruntime calls them."""
    return ", ".join(TYPE_NAMES[one] for one in types)


def _taken(types: Sequence[int | None], index: int) -> int:
    found = types[index] if index < len(types) else None
    if found is None:
        raise WireError(f"input {index} is missing")
    return found


def _cast(node: Node) -> int:
    to = node.attributes.get("to")
    if to not in ELEMENT_BYTES:
        raise WireError(f"a cast to data type {to}; expected one of {dict(sorted(TYPE_NAMES.items()))}")
    return to
