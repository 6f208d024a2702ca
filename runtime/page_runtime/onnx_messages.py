"""What an ONNX file may hold: the fields of each of its messages that are understood, and why others are refused.

Numbers and names are those of the format; the refusals are what a bundle has no need of.
Format: https://github.com/onnx/onnx/blob/main/onnx/onnx.proto3
"""

from page_runtime.wire import Field, Message

METADATA_PROPS = 14
ENTRY = Message("metadata", {1: Field("key", "text"), 2: Field("value", "text")})
OPSET = Message("opset_import", {1: Field("domain", "text"), 2: Field("version", "integer")})
MODEL = Message(
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
        METADATA_PROPS: Field("metadata_props", "bytes", many=True),
    },
    {20: "training graphs are not allowed", 25: "functions are not allowed", 26: "device settings are not allowed"},
)
GRAPH = Message(
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
NODE = Message(
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
ATTRIBUTE = Message(
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
ATTRIBUTE_FIELDS = {1: "f", 2: "i", 3: "s", 6: "floats", 7: "ints"}
TENSOR = Message(
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
VALUE = Message("value", {1: Field("name", "text"), 2: Field("type", "bytes")})
TYPE = Message("type", {1: Field("tensor_type", "bytes")}, {4: "sequences are not allowed", 5: "maps are not allowed"})
TENSOR_TYPE = Message("tensor type", {1: Field("elem_type", "integer"), 2: Field("shape", "bytes")})
SHAPE = Message("shape", {1: Field("dim", "bytes", many=True)})
DIM = Message("dimension", {1: Field("dim_value", "integer"), 2: Field("dim_param", "text")})

# TensorProto.DataType: those that are understood, the bytes of an element, and what onnxruntime calls them.
FLOAT, UINT8, INT8, INT32, INT64, BOOL, HALF, DOUBLE = 1, 2, 3, 6, 7, 9, 10, 11
ELEMENT_BYTES = {FLOAT: 4, UINT8: 1, INT8: 1, INT32: 4, INT64: 8, BOOL: 1, HALF: 2, DOUBLE: 8}
TYPE_NAMES = {
    FLOAT: "float",
    UINT8: "uint8",
    INT8: "int8",
    INT32: "int32",
    INT64: "int64",
    BOOL: "bool",
    HALF: "float16",
    DOUBLE: "double",
}
# Of those, what may decide on sizes and is read, as numpy calls it.
READABLE = {INT32: "<i4", INT64: "<i8", FLOAT: "<f4"}
