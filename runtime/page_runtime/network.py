"""The exported network in an onnxruntime session; the only module that imports onnxruntime."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from page_runtime.bundle import BundleError, BundleMetadata
from page_runtime.bundle_file import BundleFile, read_bundle
from page_runtime.neighbours import (
    GROUP_SIZE,
    INTERPOLATION_SIZE,
    Neighbours,
    answered_of,
    find_neighbours,
    levels_of,
)
from page_runtime.onnx_file import Declared
from page_runtime.onnx_messages import FLOAT, INT32
from page_runtime.providers import CPU_PROVIDER, ON_CPU, ProviderChoice, ProviderError, described, resolved, short_name
from page_runtime.sampling import RegionSample

INPUT_NAMES = ("image", "points", "pixels", "group1", "group2", "group3", "up1", "up2", "up3")
OUTPUT_NAMES = ("part_logits", "radii", "side_logits", "log_extents")
# Its kernel takes much longer than an addition and a layer norm: a forward pass of the boxes' network took 17.8 ms with
# it, 14.3 without (one thread, onnxruntime 1.31, in turns). A bias that becomes part of a product is written by one
# thread before it: 2,048 x 128 by 160 took 368 us on two threads with it, 260 without.
SLOWER = ["SkipLayerNormFusion", "MatMulAddFusion"]
# The largest of the usual detectors has 270 MB.
MAX_DETECTOR_BYTES = 512 << 20


@dataclass(frozen=True, eq=False, slots=True)
class NetworkOutput:
    """Of the first A points of the sample: part_logits (A,K+1), background last; radii_m (A,n) to each point's own
    part's keypoints; side_logits (A,n_voted), positive where the keypoint is on the camera's side of the surface. And
    extents_m (K,3)."""

    part_logits: NDArray[np.float32]
    radii_m: NDArray[np.float32]
    side_logits: NDArray[np.float32]
    extents_m: NDArray[np.float32]

    @staticmethod
    def from_graph(values: tuple[NDArray[np.float32], ...], region_radius_m: float) -> NetworkOutput:
        """From the graph's outputs (OUTPUT_NAMES, batch of one), which count lengths in region radii."""
        logits, radii, sides, log_extents = values
        return NetworkOutput(logits[0], radii[0] * np.float32(region_radius_m), sides[0], np.exp(log_extents[0]))


def feeds(metadata: BundleMetadata, sample: RegionSample, neighbours: Neighbours) -> dict[str, NDArray[np.generic]]:
    """A graph's inputs: image (1,3,S,S) in [0,1]; points (1,N,3) centred, in region radii; the rest as it is."""
    image = np.ascontiguousarray(sample.image.transpose(2, 0, 1)[None], dtype=np.float32)
    image *= np.float32(1 / 255)
    unit = np.float32(metadata.category.region_radius_m)
    points = (sample.points_camera - sample.center_camera)[None] / unit
    tables = {name: getattr(neighbours, name)[None] for name in INPUT_NAMES[3:]}
    return {"image": image, "points": points, "pixels": sample.pixels[None], **tables}


class DeadlineExceeded(TimeoutError):
    """A forward pass was given up because its time was over."""


class Network:
    """A loaded bundle, ready to run. operators: how many run on which of onnxruntime's providers."""

    def __init__(self, path: Path | str, *, threads: int = 0, on: ProviderChoice = ON_CPU) -> None:
        """Load a bundle; threads 0 leaves the number to onnxruntime.

        Raises BundleError with the reason where the file is no bundle or cannot be loaded, ProviderError where `on`
        cannot be had.
        """
        self.path = Path(path)
        file = read_bundle(self.path)
        self.metadata = file.metadata
        self._check_signature(file)
        provider, provider_options = resolved(on, ort.get_available_providers())
        options = session_options(threads)
        if provider != CPU_PROVIDER:
            options.add_session_config_entry("session.record_ep_graph_assignment_info", "1")
            if on.required:
                options.add_session_config_entry("session.disable_cpu_ep_fallback", "1")
        try:
            self.session = ort.InferenceSession(
                file.data, options, providers=[(provider, provider_options)], disabled_optimizers=SLOWER
            )
        except Exception as error:  # onnxruntime raises many unrelated classes for one cause: a file it cannot load
            reason = str(error).splitlines()[0]
            if provider != CPU_PROVIDER:
                raise ProviderError(f"provider {short_name(provider)}: cannot run {self.path} ({reason})") from error
            raise BundleError(
                f"bundle {self.path}: onnxruntime cannot load it ({reason}); is it an exported, complete .onnx file?"
            ) from error
        self.operators = self._operators(provider, file.size.operators)
        if on.required and set(self.operators) != {provider}:
            raise ProviderError(
                f"provider {short_name(provider)}: required for the whole network, but it runs on "
                f"{described(self.operators)}"
            )
        # One thread was asked for, or several.
        self._beside = None if threads == 1 else ThreadPoolExecutor(1, thread_name_prefix="neighbours")

    def neighbours_of(self, sample: RegionSample) -> Neighbours:
        """The neighbour tables that `run` takes, with as many threads as the network was given."""
        return find_neighbours(sample.points_camera - sample.center_camera, beside=self._beside)

    def _operators(self, provider: str, operators: int) -> dict[str, int]:
        # onnxruntime falls back to the CPU by itself where a provider cannot start.
        if provider == CPU_PROVIDER or provider not in self.session.get_providers():
            return {CPU_PROVIDER: operators}
        return dict(Counter(part.ep_name for part in self.session.get_provider_graph_assignment_info()))

    def _check_signature(self, file: BundleFile) -> None:
        """The graph must take and give what its metadata and the neighbour search say."""
        names, outputs = tuple(file.graph.inputs), tuple(file.graph.outputs)
        if names != INPUT_NAMES or outputs != OUTPUT_NAMES:
            raise BundleError(
                f"bundle {self.path}: expected inputs {INPUT_NAMES} and outputs {OUTPUT_NAMES}, "
                f"got {names} and {outputs}"
            )
        metadata = self.metadata
        try:
            levels, answered = levels_of(metadata.num_points), answered_of(metadata.num_points)
        except ValueError as error:
            raise BundleError(f"bundle {self.path}: {error}") from error
        parts, keypoints = len(metadata.category.parts), metadata.category.num_keypoints
        full, size = metadata.num_points, metadata.image_size
        floats = {
            "image": [1, 3, size, size],
            "points": [1, full, 3],
            "pixels": [1, full, 2],
            "part_logits": [1, answered, parts + 1],
            "radii": [1, answered, keypoints],
            "side_logits": [1, answered, metadata.category.num_voted],
            "log_extents": [1, parts, 3],
        }
        groups = {f"group{i}": [1, count, GROUP_SIZE] for i, count in enumerate(levels[1:], 1)}
        fine = (answered, *levels[1:-1])
        ups = {f"up{i}": [1, count, INTERPOLATION_SIZE] for i, count in enumerate(fine, 1)}
        expected = {name: Declared(FLOAT, tuple(shape)) for name, shape in floats.items()}
        expected |= {name: Declared(INT32, tuple(shape)) for name, shape in (groups | ups).items()}
        for name, value in (file.graph.inputs | file.graph.outputs).items():
            if value != expected[name]:
                raise BundleError(
                    f"bundle {self.path}: expected {name} to be {expected[name]} by its metadata, "
                    f"got {value}; export it again"
                )

    def warm_up(self, runs: int = 3) -> None:
        """Run on zeros: the first passes set up memory, and take half as long again as later ones."""
        shapes = {value.name: (value.shape, value.type) for value in self.session.get_inputs()}
        zeros = {n: np.zeros(shape, np.int32 if "int" in kind else np.float32) for n, (shape, kind) in shapes.items()}
        for _ in range(runs):
            self.session.run(OUTPUT_NAMES, zeros)

    def run_raw(
        self, sample: RegionSample, neighbours: Neighbours, *, seconds: float | None = None
    ) -> tuple[NDArray[np.float32], ...]:
        """The graph's outputs as they are, in the order of OUTPUT_NAMES.

        seconds: DeadlineExceeded where the pass takes longer, at the end of the operator that was running then.
        """
        given = feeds(self.metadata, sample, neighbours)
        outputs = self.session.run(OUTPUT_NAMES, given) if seconds is None else self._run_in_time(given, seconds)
        return tuple(np.asarray(value, dtype=np.float32) for value in outputs)

    def _run_in_time(self, given: dict[str, NDArray[np.generic]], seconds: float) -> Sequence[Any]:
        late = f"network: not done within {1e3 * seconds:.1f} ms; allow more time, or use a quicker bundle"
        if seconds <= 0.0:
            raise DeadlineExceeded(late)
        run_options = ort.RunOptions()
        over = threading.Event()

        def end() -> None:
            over.set()
            run_options.terminate = True

        timer = threading.Timer(seconds, end)
        timer.daemon = True
        timer.start()
        try:
            return self.session.run(OUTPUT_NAMES, given, run_options)
        except Exception as error:  # onnxruntime says only "Fail" of a run that was told to end
            if over.is_set():
                raise DeadlineExceeded(late) from error
            raise
        finally:
            timer.cancel()

    def run(self, sample: RegionSample, neighbours: Neighbours, *, seconds: float | None = None) -> NetworkOutput:
        """One forward pass for all parts; seconds as in `run_raw`."""
        values = self.run_raw(sample, neighbours, seconds=seconds)
        return NetworkOutput.from_graph(values, self.metadata.category.region_radius_m)


def session_options(threads: int) -> ort.SessionOptions:
    """How every session here runs: so many threads, which wait by spinning for 50 us and sleep then.

    A worker that sleeps at once is woken for every operator: two threads were no faster than one, 11.6 and
    11.0 ms.
    One that spins for as long as onnxruntime's default does takes a core from the scorer, which runs between two
    passes. numpy's own threads and OpenCV's are set by the command (`cli._prepare`, `commands.inputs`).
    """
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.spin_duration_us", "50")
    return options


def open_session(path: Path, *, threads: int) -> ort.InferenceSession:
    """A session of a user's own .onnx file, a detector, on the CPU; BundleError with the reason where there can be
    none."""
    if not path.is_file():
        raise BundleError(f"{path}: there is no such file; expected an .onnx file")
    size = path.stat().st_size
    if not 0 < size <= MAX_DETECTOR_BYTES:
        raise BundleError(f"{path}: expected 1 to {MAX_DETECTOR_BYTES} bytes, got {size}")
    try:
        return ort.InferenceSession(path.read_bytes(), session_options(threads), providers=[CPU_PROVIDER])
    except Exception as error:  # as in Network
        reason = str(error).splitlines()[0]
        raise BundleError(f"{path}: onnxruntime cannot load it ({reason}); is it a complete .onnx file?") from error


def available_providers() -> tuple[str, ...]:
    """What this onnxruntime could run a network with."""
    return tuple(ort.get_available_providers())
