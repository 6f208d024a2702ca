"""A graph with all that can be computed beforehand computed, by onnxruntime's machine-independent optimisations."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import onnx
import onnxruntime as ort

from page_runtime.network import SLOWER


def simplified(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same function with constants folded and twins merged, in standard operators: fewer to check and to load."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "simplified.onnx"
        options = ort.SessionOptions()
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_BASIC
        options.optimized_model_filepath = str(path)
        options.log_severity_level = 3
        ort.InferenceSession(
            model.SerializeToString(), options, providers=["CPUExecutionProvider"], disabled_optimizers=SLOWER
        )
        return onnx.load(path)
