"""Smaller and quicker forms of a bundle: half precision, and whole numbers of 8 bits in several ways."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_dynamic, quantize_static

from page_export.parity import Inputs
from page_runtime.bundle import BundleMetadata
from page_runtime.network import feeds
from page_runtime.onnx_file import read_onnx

CALIBRATION_FRAMES = 32
# Smaller products stay in float32 in the mixed form: heads and frames of parts decide on poses, and converting to and
# from 8 bits costs as much as they do.
MIXED_MULTIPLICATIONS = 4_000_000

# The converter replaces Gemm by MatMul and Add and then looks in vain for the type of what is between them.
_UNTYPED_IS_FLOAT = {"DefaultTensorType": onnx.TensorProto.FLOAT}


class _Frames(CalibrationDataReader):
    def __init__(self, given: list[dict[str, NDArray[np.generic]]]) -> None:
        self.rest = iter(given)

    def get_next(self) -> dict[str, Any]:
        return next(self.rest, None)  # pyright: ignore[reportReturnType]


def chosen_for_calibration(samples: Sequence[Inputs], count: int = CALIBRATION_FRAMES) -> list[Inputs]:
    """The `count` samples that differ most: by farthest-first traversal of brightness, contrast, distance, spread and
    number of points, from the one nearest their mean."""
    described = np.array(
        [
            (
                sample.image.mean(),
                sample.image.std(),
                np.linalg.norm(sample.center_camera),
                (sample.points_camera - sample.center_camera).std(),
                sample.num_distinct,
            )
            for sample, _ in samples
        ]
    )
    spread = described.std(axis=0)
    described = (described - described.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    chosen = [int(np.argmin((described**2).sum(axis=1)))]
    distance = np.full(len(samples), np.inf)
    while len(chosen) < min(count, len(samples)):
        distance = np.minimum(distance, ((described - described[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(distance)))
    return [samples[i] for i in chosen]


def variants(
    bundle: Path, metadata: BundleMetadata, calibration: Sequence[Inputs]
) -> dict[str, Callable[[], onnx.ModelProto]]:
    """By name, each made when called: fp16, int8-dynamic, int8-static and int8-mixed."""
    logging.getLogger().setLevel(logging.ERROR)
    given = [feeds(metadata, sample, neighbours) for sample, neighbours in calibration]
    return {
        "fp16": lambda: _half(bundle),
        "int8-dynamic": lambda: _converted(
            bundle,
            lambda source, target: quantize_dynamic(
                source, target, weight_type=QuantType.QInt8, extra_options=_UNTYPED_IS_FLOAT
            ),
        ),
        "int8-static": lambda: _static(bundle, given, None),
        "int8-mixed": lambda: _static(bundle, given, _large_products(bundle)),
    }


def without_dead_ends(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same outputs without operators and constants that none of them needs."""
    graph = model.graph
    needed = {value.name for value in graph.output}
    kept = []
    for node in reversed(graph.node):
        if needed & set(node.output):
            needed |= set(node.input)
            kept.append(node)
    nodes = [onnx.NodeProto.FromString(node.SerializeToString()) for node in reversed(kept)]
    constants = [tensor for tensor in graph.initializer if tensor.name in needed]
    del graph.node[:]
    graph.node.extend(nodes)
    constants = [onnx.TensorProto.FromString(tensor.SerializeToString()) for tensor in constants]
    del graph.initializer[:]
    graph.initializer.extend(constants)
    return model


def _half(bundle: Path) -> onnx.ModelProto:
    from onnxruntime.transformers.float16 import convert_float_to_float16

    return convert_float_to_float16(onnx.load(bundle), keep_io_types=True)


def _static(bundle: Path, given: list[dict[str, NDArray[np.generic]]], nodes: list[str] | None) -> onnx.ModelProto:
    def convert(source: Path, target: Path) -> None:
        quantize_static(
            source,
            target,
            _Frames(given),
            quant_format=QuantFormat.QDQ,
            op_types_to_quantize=["Conv", "Gemm", "MatMul"],
            nodes_to_quantize=nodes,
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            extra_options=_UNTYPED_IS_FLOAT,
        )

    return _converted(bundle, convert)


def _converted(bundle: Path, convert: Callable[[Path, Path], Any]) -> onnx.ModelProto:
    with TemporaryDirectory() as folder:
        source, target = Path(folder) / "source.onnx", Path(folder) / "target.onnx"
        model = onnx.load(bundle)
        for index, node in enumerate(model.graph.node):
            node.name = f"{node.op_type}_{index}"
        onnx.save(onnx.shape_inference.infer_shapes(model, data_prop=True), source)
        convert(source, target)
        return without_dead_ends(onnx.load(target))


def _large_products(bundle: Path) -> list[str]:
    """Names, as `_converted` gives them, of products and convolutions worth converting."""
    graph = read_onnx(bundle.read_bytes()).graph
    weights = {name: tensor.shape for name, tensor in graph.initializers.items()}
    model = onnx.shape_inference.infer_shapes(onnx.load(bundle), data_prop=True)
    shapes = {
        value.name: [dim.dim_value for dim in value.type.tensor_type.shape.dim] for value in model.graph.value_info
    }
    large = []
    for index, node in enumerate(graph.nodes):
        if node.kind not in ("Conv", "Gemm", "MatMul") or node.inputs[1] not in weights:
            continue
        out, kernel = shapes.get(node.outputs[0]), weights[node.inputs[1]]
        if out and np.prod(out) * np.prod(kernel) / max(out[1] if node.kind == "Conv" else out[-1], 1) >= (
            MIXED_MULTIPLICATIONS
        ):
            large.append(f"{node.kind}_{index}")
    return large
