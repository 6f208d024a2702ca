"""A bundle whose graph is not what the runtime feeds and reads is refused when it is loaded."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper

from page_runtime.bundle_fields import BundleError
from page_runtime.network import Network
from page_runtime.onnx_file import sealed
from page_runtime.signature import INPUT_NAMES, OUTPUT_NAMES


def rewired(bundle: Path, path: Path, name: str, dtype: type, shape: list[Any]) -> Path:
    """The bundle with its input or output `name` of this type and shape; constants make the graph valid again."""
    model = onnx.load(bundle)
    graph = model.graph
    (value,) = [value for value in (*graph.input, *graph.output) if value.name == name]
    given = [dim.dim_value for dim in value.type.tensor_type.shape.dim]
    if name in INPUT_NAMES:
        kind = helper.tensor_dtype_to_np_dtype(value.type.tensor_type.elem_type)
        graph.initializer.append(numpy_helper.from_array(np.zeros(given, kind), "constant"))
        for node in graph.node:
            node.input[:] = ["constant" if each == name else each for each in node.input]
    else:
        graph.initializer.append(numpy_helper.from_array(np.zeros(shape, dtype), "constant"))
        for node in graph.node:
            node.output[:] = ["unused" if each == name else each for each in node.output]
        graph.node.append(helper.make_node("Identity", ["constant"], [name]))
    value.CopyFrom(helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), shape))
    onnx.checker.check_model(model)
    path.write_bytes(sealed(model.SerializeToString()))
    return path


def signature(bundle: Path) -> dict[str, tuple[type, list[Any]]]:
    graph = onnx.load(bundle).graph
    return {
        value.name: (
            helper.tensor_dtype_to_np_dtype(value.type.tensor_type.elem_type).type,
            [dim.dim_value for dim in value.type.tensor_type.shape.dim],
        )
        for value in (*graph.input, *graph.output)
    }


@pytest.mark.parametrize("name", [*INPUT_NAMES, *OUTPUT_NAMES])
def test_a_signature_of_other_types_and_shapes_is_refused_by_name(
    oracle_bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    dtype, shape = signature(oracle_bundle)[name]
    path = rewired(oracle_bundle, tmp_path / "same.onnx", name, dtype, shape)
    assert Network(path, threads=1).metadata.category.name == "box"

    def never(*_: object, **__: object) -> None:
        raise AssertionError("onnxruntime has seen it")

    monkeypatch.setattr("page_runtime.sessions.ort.InferenceSession", never)
    changes: list[tuple[type, list[Any]]] = [
        (np.float64 if dtype is np.float32 else np.int64, shape),
        (dtype, [*shape[:-1], shape[-1] + 1]),
        (dtype, [shape[0], shape[1] + 1, *shape[2:]]),
        (dtype, shape[:-1]),
    ]
    if name in INPUT_NAMES:
        changes.append((dtype, ["batch", *shape[1:]]))
    for other_dtype, other_shape in changes:
        path = rewired(oracle_bundle, tmp_path / "other.onnx", name, other_dtype, other_shape)
        expected = rf"other\.onnx: expected {name} to be .* {re.escape(str(shape))} .*, got .* "
        with pytest.raises(BundleError, match=expected + re.escape(str(other_shape))):
            Network(path, threads=1)
