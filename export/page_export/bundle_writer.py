"""Writing a bundle in the one form the runtime reads: nothing in it but what the graph needs, and a checksum."""

from __future__ import annotations

from pathlib import Path
from secrets import token_hex

import numpy as np
import onnx
from onnx import helper, numpy_helper

from page_runtime.bundle import METADATA_KEY, BundleMetadata
from page_runtime.onnx_file import sealed


def bundle_bytes(model: onnx.ModelProto, metadata: BundleMetadata | None) -> bytes:
    """The file of a model and its metadata; without metadata (for tests of refusals) it is no bundle. ValueError for
    a graph of other than standard operators."""
    plain = onnx.ModelProto()
    plain.CopyFrom(model)
    foreign = {node.domain for node in plain.graph.node} - {"", "ai.onnx"}
    if foreign:
        raise ValueError(f"bundle: expected standard operators only, got domains {sorted(foreign)}")
    graph = plain.graph
    _constants_as_initializers(graph)
    _in_order(graph)
    # Converters note stack traces, paths and shapes: half the file, and paths of this machine.
    for owner in (plain, graph, *graph.node, *graph.input, *graph.output, *graph.initializer):
        del owner.metadata_props[:]
        owner.ClearField("doc_string")
    for node in graph.node:
        for attribute in node.attribute:
            attribute.ClearField("doc_string")
    _short_names(graph)
    del graph.value_info[:]
    del graph.quantization_annotation[:]
    tensors = [numpy_helper.from_array(numpy_helper.to_array(tensor), tensor.name) for tensor in graph.initializer]
    del graph.initializer[:]
    graph.initializer.extend(tensors)
    opset = next(entry.version for entry in plain.opset_import if entry.domain in ("", "ai.onnx"))
    del plain.opset_import[:]
    plain.opset_import.append(helper.make_opsetid("", opset))
    if metadata is not None:
        entry = plain.metadata_props.add()
        entry.key, entry.value = METADATA_KEY, metadata.to_json()
    return sealed(plain.SerializeToString(deterministic=True))


def _constants_as_initializers(graph: onnx.GraphProto) -> None:
    constants = [node for node in graph.node if node.op_type == "Constant"]
    for node in constants:
        (attribute,) = node.attribute
        value = helper.get_attribute_value(attribute)
        array = (
            numpy_helper.to_array(value)
            if attribute.name == "value"
            else np.array(value, np.float32 if attribute.name.startswith("value_float") else np.int64)
        )
        graph.initializer.append(numpy_helper.from_array(array, node.output[0]))
        graph.node.remove(node)


def _short_names(graph: onnx.GraphProto) -> None:
    """Weights by their place in the network, without what torch's exporter puts before it: 7 kB less."""
    prefix = "frames.network."
    kept = {value.name for value in (*graph.input, *graph.output)}
    kept |= {name for node in graph.node for name in node.output}
    found = [tensor for tensor in graph.initializer if tensor.name.startswith(prefix)]
    names = {tensor.name: tensor.name.removeprefix(prefix) for tensor in found}
    names = {long: short for long, short in names.items() if short not in kept}
    for tensor in found:
        tensor.name = names.get(tensor.name, tensor.name)
    for node in graph.node:
        node.input[:] = [names.get(name, name) for name in node.input]


def _in_order(graph: onnx.GraphProto) -> None:
    """Every operator after those it takes from; some converters append them as they come. ValueError for a cycle."""
    known = {"", *(value.name for value in graph.input), *(tensor.name for tensor in graph.initializer)}
    waiting = [onnx.NodeProto.FromString(node.SerializeToString()) for node in graph.node]
    del graph.node[:]
    while waiting:
        later = []
        for node in waiting:
            if known.issuperset(node.input):
                known.update(node.output)
                graph.node.append(node)
            else:
                later.append(node)
        if len(later) == len(waiting):
            raise ValueError(f"bundle: the operator {later[0].name!r} takes what no other gives")
        waiting = later


def write_file(data: bytes, path: Path) -> None:
    """Write the file whole or not at all. Of a link, what it leads to; a file that was there keeps its permissions."""
    target = path.resolve()
    target.parent.mkdir(parents=True, exist_ok=True)
    mode = target.stat().st_mode & 0o777 if target.is_file() else None
    partial = target.with_name(f".{target.name}.{token_hex(8)}.partial")
    try:
        with partial.open("xb") as file:
            file.write(data)
        if mode is not None:
            partial.chmod(mode)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
