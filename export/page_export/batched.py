"""The network for several objects at once, for accelerators and programs of one's own.

The runtime does not load it: on a CPU the form for one object, run for one after the other, is quicker (figures in
export/README.md).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
import torch
from numpy.typing import NDArray
from onnxruntime.tools.onnx_model_utils import make_dim_param_fixed

from page_export.onnx_export import RuntimeSignature, example_inputs, exported, folded
from page_export.parity import Inputs, Run
from page_export.simplified import simplified
from page_runtime.bundle import BundleMetadata
from page_runtime.graph_limits import MAX_BATCH
from page_runtime.neighbours import LEVELS
from page_runtime.network import SLOWER, feeds
from page_runtime.sessions import session_options
from page_runtime.signature import INPUT_NAMES, OUTPUT_NAMES
from page_training.network import PageNetwork

DYNAMIC = "dynamic"
# The name of the free dimension in the file.
_ROWS = "batch"


@dataclass(frozen=True, slots=True)
class Batch:
    """size: objects in each run; None for 1 to MAX_BATCH, known when it runs."""

    size: int | None

    @staticmethod
    def parsed(text: str) -> Batch:
        """From "dynamic" or a number of 2 or more; ValueError for others."""
        if text == DYNAMIC:
            return Batch(None)
        if not text.isdecimal() or not 2 <= int(text) <= MAX_BATCH:
            raise ValueError(f"--batch: expected {DYNAMIC} or 2 to {MAX_BATCH}, got {text!r}; leave it out for 1")
        return Batch(int(text))

    def __str__(self) -> str:
        return DYNAMIC if self.size is None else str(self.size)

    def graph_of(self, network: PageNetwork, num_points: int = LEVELS[0]) -> onnx.ModelProto:
        """The network for such batches of objects of so many points."""
        model = batched_graph_of(network, num_points)
        return model if self.size is None else with_rows(model, self.size)


def batched_graph_of(network: PageNetwork, num_points: int = LEVELS[0]) -> onnx.ModelProto:
    """The network as a checked ONNX model of 1 to MAX_BATCH rows in each input and output; otherwise as `graph_of`."""
    # Of one row alone, torch would not see that there may be more.
    examples = tuple(torch.cat([one, one]) for one in example_inputs(num_points))
    module = RuntimeSignature(folded(network)).eval()
    rows = {0: torch.export.Dim(_ROWS, min=1, max=MAX_BATCH)}
    return simplified(exported(module, examples, INPUT_NAMES, OUTPUT_NAMES, rows))


def with_rows(model: onnx.ModelProto, size: int) -> onnx.ModelProto:
    """A model of `batched_graph_of` for so many objects in each run, what that decides computed beforehand."""
    fixed = onnx.ModelProto.FromString(model.SerializeToString())
    make_dim_param_fixed(fixed.graph, _ROWS, size)
    return simplified(fixed)


def batched_run(model: bytes, metadata: BundleMetadata, batch: Batch) -> Run:
    """The model run with each sample among those before it, in changing places and, where that is free, in batches of
    1 to 3: what it says of the sample."""
    session: Any = ort.InferenceSession(
        model, session_options(1), providers=["CPUExecutionProvider"], disabled_optimizers=SLOWER
    )
    before: deque[Inputs] = deque(maxlen=batch.size or 3)
    calls = 0

    def run(*sample: Any) -> tuple[NDArray[np.float32], ...]:
        nonlocal calls
        rows = batch.size or 1 + calls % 3
        place = calls % rows
        calls += 1
        before.append(sample)
        others = [before[k % len(before)] for k in range(rows)]
        others[place] = sample
        given = [feeds(metadata, *one) for one in others]
        values = session.run(OUTPUT_NAMES, {name: np.concatenate([one[name] for one in given]) for name in INPUT_NAMES})
        return tuple(value[place : place + 1] for value in values)

    return run
