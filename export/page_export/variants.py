"""Smaller and quicker forms of a bundle: half precision, and whole numbers of 8 bits in several ways."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, numpy_helper
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_dynamic, quantize_static

from page_export.parity import Inputs
from page_runtime.bundle import BundleMetadata
from page_runtime.network import feeds

CALIBRATION_FRAMES = 32
# Layers with fewer inputs are places, frames and indices of points: geometry, which needs its digits.
LEAST_INPUTS = 32
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


@dataclass(frozen=True, slots=True)
class Layer:
    """An operator with weights. works_on: the size of the map or the rows it gives, in words; multiplications: of a
    pass."""

    name: str
    works_on: str
    multiplications: float


class Forms:
    """The forms of one bundle, with what they share: its layers, and the ranges that its values have on samples."""

    def __init__(self, bundle: Path, metadata: BundleMetadata, calibration: Sequence[Inputs], folder: Path) -> None:
        """folder: where the ranges are kept."""
        self.bundle = bundle
        self.layers = _layers(bundle)
        self._given = [feeds(metadata, sample, neighbours) for sample, neighbours in calibration]
        self._ranges = folder / "ranges.json"

    def half(self) -> onnx.ModelProto:
        """The layers' weights stored in half precision."""
        return _half(onnx.load(self.bundle), [one.name for one in self.layers])

    def dynamic(self) -> onnx.ModelProto:
        """All layers in 8 bits, ranges of what they take found in each pass."""
        names = [one.name for one in self.layers]
        # On its way it transposes what no layer shares, too.
        products = [node.name for node in _named(onnx.load(self.bundle)).graph.node]
        return _converted(self.bundle, products, lambda source, target: _dynamic(source, target, names))

    def static(self, layers: Sequence[str] | None = None) -> onnx.ModelProto:
        """Layers (all by default) in 8 bits, ranges as on the samples."""
        names = [one.name for one in self.layers] if layers is None else list(layers)
        return _converted(
            self.bundle, names, lambda source, target: _static(source, target, self._given, names, self._ranges)
        )


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


def _half(model: onnx.ModelProto, layers: list[str]) -> onnx.ModelProto:
    """Stored only, and computed with in float32: CPUs have few kernels for halves, and a conversion of what is between
    the layers cannot even count the pixels of a map."""
    model = _named(model)
    graph = model.graph
    weights = {node.input[1] for node in graph.node if node.name in layers}
    for tensor in [tensor for tensor in graph.initializer if tensor.name in weights]:
        half = numpy_helper.from_array(numpy_helper.to_array(tensor).astype(np.float16), f"{tensor.name}_half")
        graph.node.insert(0, helper.make_node("Cast", [half.name], [tensor.name], to=onnx.TensorProto.FLOAT))
        graph.initializer.remove(tensor)
        graph.initializer.append(half)
    return model


def _dynamic(source: Path, target: Path, layers: list[str]) -> None:
    # Gemm becomes MatMul and Add on the way, by these names.
    names = [*layers, *(f"{name}_MatMul" for name in layers)]
    quantize_dynamic(
        source, target, weight_type=QuantType.QInt8, nodes_to_quantize=names, extra_options=_UNTYPED_IS_FLOAT
    )


def _static(
    source: Path, target: Path, given: list[dict[str, NDArray[np.generic]]], layers: list[str], ranges: Path
) -> None:
    quantize_static(
        source,
        target,
        _Frames(given),
        quant_format=QuantFormat.QDQ,
        op_types_to_quantize=["Conv", "Gemm", "MatMul"],
        nodes_to_quantize=layers,
        per_channel=True,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
        extra_options=_UNTYPED_IS_FLOAT,
        calibration_cache_path=ranges,
    )


def _converted(bundle: Path, layers: Collection[str], convert: Callable[[Path, Path], Any]) -> onnx.ModelProto:
    with TemporaryDirectory() as folder:
        source, target = Path(folder) / "source.onnx", Path(folder) / "target.onnx"
        model = _named(onnx.load(bundle))
        _weights_of_their_own(model.graph, layers)
        onnx.save(onnx.shape_inference.infer_shapes(model, data_prop=True), source)
        convert(source, target)
        return without_dead_ends(onnx.load(target))


def _weights_of_their_own(graph: onnx.GraphProto, layers: Collection[str]) -> None:
    """A copy of each weight for every layer that shares it with others: the converter transposes a shared one once."""
    tensors = {tensor.name: tensor for tensor in graph.initializer}
    products = [node for node in graph.node if node.op_type in ("Conv", "Gemm", "MatMul")]
    uses = Counter(name for node in products for name in node.input if name in tensors)
    for node in products:
        for place, name in enumerate(node.input):
            if node.name in layers and uses[name] > 1:
                copy = graph.initializer.add()
                copy.CopyFrom(tensors[name])
                copy.name = node.input[place] = f"{name}_of_{node.name}"


def _named(model: onnx.ModelProto) -> onnx.ModelProto:
    for index, node in enumerate(model.graph.node):
        node.name = f"{node.op_type}_{index}"
    return model


def _layers(bundle: Path) -> list[Layer]:
    """Layers with weights, by the name `_named` gives them."""
    model = _named(onnx.shape_inference.infer_shapes(onnx.load(bundle), data_prop=True))
    graph = model.graph
    weights = {tensor.name: tensor.dims for tensor in graph.initializer}
    shapes = {
        value.name: [dim.dim_value for dim in value.type.tensor_type.shape.dim]
        for value in (*graph.value_info, *graph.output)
    }
    found = []
    for node in graph.node:
        if node.op_type not in ("Conv", "Gemm", "MatMul") or node.input[1] not in weights:
            continue
        kernel, shape = weights[node.input[1]], shapes[node.output[0]]
        if node.op_type == "Conv":
            maps = "x".join(map(str, shape[2:]))
            found.append(Layer(node.name, f"maps of {maps}", float(np.prod(shape) * np.prod(kernel[1:]))))
            continue
        transposed = any(attribute.name == "transB" and attribute.i for attribute in node.attribute)
        inputs = kernel[-1] if transposed else kernel[-2]
        if inputs >= LEAST_INPUTS:
            rows = int(np.prod(shape[:-1]))
            found.append(Layer(node.name, f"products of {rows}", float(np.prod(shape) * inputs)))
    return found
