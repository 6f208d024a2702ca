"""Where a bundle's forward pass takes its time, operator by operator."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import onnxruntime as ort

from page_export.parity import Inputs
from page_runtime.bundle_file import read_bundle
from page_runtime.network import SLOWER, feeds
from page_runtime.sessions import session_options
from page_runtime.signature import OUTPUT_NAMES

WARM_UP = 5


@dataclass(frozen=True, slots=True)
class OperatorTime:
    """All operators of a kind, or one. count: how many; ms: median of a pass, of all of them together; shapes: of the
    inputs and the first output of one, for people."""

    name: str
    count: int
    ms: float
    shapes: str = ""


@dataclass(frozen=True, slots=True)
class Profile:
    """pass_ms: median of whole passes, profiling on, which is more than the operators' sum."""

    pass_ms: float
    kinds: tuple[OperatorTime, ...]
    operators: tuple[OperatorTime, ...]


def profiled(bundle: Path, samples: Sequence[Inputs], *, threads: int, passes: int = 100) -> Profile:
    """Run the samples in turn, so many passes, with onnxruntime's profiler on."""
    file = read_bundle(bundle)
    given = [feeds(file.metadata, sample, neighbours) for sample, neighbours in samples]
    with TemporaryDirectory() as folder:
        options = session_options(threads)
        options.enable_profiling = True
        options.profile_file_prefix = str(Path(folder) / "profile")
        session = ort.InferenceSession(
            file.data, options, providers=["CPUExecutionProvider"], disabled_optimizers=SLOWER
        )
        for number in range(WARM_UP + passes):
            session.run(OUTPUT_NAMES, given[number % len(given)])
        events = json.loads(Path(session.end_profiling()).read_text())
    times: dict[str, list[float]] = defaultdict(list)
    facts: dict[str, tuple[str, str]] = {}
    whole: list[float] = []
    for event in events:
        name = event["name"]
        if name == "model_run":
            whole.append(event["dur"] * 1e-3)
        elif event.get("cat") == "Node" and name.endswith("_kernel_time"):
            name = name.removesuffix("_kernel_time")
            times[name].append(event["dur"] * 1e-3)
            facts[name] = event["args"]["op_name"], _shapes(event["args"])
    single = [
        OperatorTime(f"{facts[name][0]} {name}", 1, float(np.median(values[WARM_UP:])), facts[name][1])
        for name, values in times.items()
    ]
    by_kind: dict[str, list[float]] = defaultdict(list)
    for one in single:
        by_kind[one.name.split()[0]].append(one.ms)
    kinds = [OperatorTime(kind, len(values), sum(values)) for kind, values in by_kind.items()]
    return Profile(float(np.median(whole[WARM_UP:])), _slowest(kinds), _slowest(single))


def _slowest(times: list[OperatorTime]) -> tuple[OperatorTime, ...]:
    return tuple(sorted(times, key=lambda one: -one.ms))


def _shapes(arguments: dict[str, list[dict[str, list[int]]]]) -> str:
    def text(key: str) -> str:
        return " ".join("x".join(map(str, shape)) for value in arguments.get(key, []) for shape in value.values())

    return f"{text('input_type_shape')} -> {text('output_type_shape')}"
