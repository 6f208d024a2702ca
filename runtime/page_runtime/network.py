"""The exported network in an onnxruntime session."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from page_runtime.bundle import BundleMetadata
from page_runtime.bundle_file import read_bundle
from page_runtime.neighbours import Neighbours, find_neighbours
from page_runtime.providers import (
    CPU_PROVIDER,
    ON_CPU,
    NetworkError,
    ProviderChoice,
    ProviderError,
    described,
    short_name,
)
from page_runtime.sampling import RegionSample
from page_runtime.sessions import DeadlineExceeded, first_line, run_session, session_on, session_options
from page_runtime.signature import INPUT_NAMES, OUTPUT_NAMES

# Its kernel takes much longer than an addition and a layer norm: a forward pass of the boxes' network took 17.8 ms with
# it, 14.3 without (one thread, onnxruntime 1.31, in turns). A bias that becomes part of a product is written by one
# thread before it: 2,048 x 128 by 160 took 368 us on two threads with it, 260 without.
SLOWER = ["SkipLayerNormFusion", "MatMulAddFusion"]


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


class Network:
    """A loaded bundle, ready to run. operators: how many run on which of onnxruntime's providers. fell_back: why the
    CPU runs it and not the provider that was asked for; empty where that one does."""

    def __init__(self, path: Path | str, *, threads: int = 0, on: ProviderChoice = ON_CPU) -> None:
        """Load a bundle; threads 0 leaves the number to onnxruntime.

        Raises BundleError with the reason where the file is no bundle or cannot be loaded, ProviderError where `on`
        cannot be had, ValueError for more threads than `machine.most_threads`.
        """
        self.path = Path(path)
        options = session_options(threads)
        file = read_bundle(self.path)
        self.metadata = file.metadata
        self.session, provider, self.fell_back = session_on(on, self.path, file.data, options, without=SLOWER)
        self.operators = self._operators(provider, file.size.operators)
        if provider != CPU_PROVIDER and self.operators.keys() == {CPU_PROVIDER} and not self.fell_back:
            self.fell_back = f"provider {short_name(provider)}: it takes none of the operators of {self.path}"
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
        if provider == CPU_PROVIDER or self.fell_back:
            return {CPU_PROVIDER: operators}
        return dict(Counter(part.ep_name for part in self.session.get_provider_graph_assignment_info()))

    def warm_up(self, runs: int = 3) -> None:
        """Run on zeros: the first passes set up memory, and take half as long again as later ones."""
        shapes = {value.name: (value.shape, value.type) for value in self.session.get_inputs()}
        zeros = {n: np.zeros(shape, np.int32 if "int" in kind else np.float32) for n, (shape, kind) in shapes.items()}
        for _ in range(runs):
            self._run(zeros)

    def run_raw(
        self, sample: RegionSample, neighbours: Neighbours, *, seconds: float | None = None
    ) -> tuple[NDArray[np.float32], ...]:
        """The graph's outputs as they are, in the order of OUTPUT_NAMES.

        seconds: DeadlineExceeded where the pass takes longer, at the end of the operator that was running then;
        ValueError where it is not above 0. NetworkError where onnxruntime fails.
        """
        if seconds is not None and not seconds > 0.0:
            raise ValueError(f"seconds: expected a time above 0, or None for any, got {seconds}")
        outputs = self._run(feeds(self.metadata, sample, neighbours), seconds)
        return tuple(np.asarray(value, dtype=np.float32) for value in outputs)

    def _run(self, given: Mapping[str, NDArray[Any]], seconds: float | None = None) -> Sequence[Any]:
        try:
            return run_session(self.session, OUTPUT_NAMES, given, seconds)
        except DeadlineExceeded:
            raise
        except Exception as error:  # onnxruntime raises many unrelated classes
            otherwise = "" if self.operators.keys() == {CPU_PROVIDER} else ", or run it on the provider cpu"
            raise NetworkError(
                f"bundle {self.path}: onnxruntime failed while it ran on {described(self.operators)} "
                f"({first_line(error)}); export it again{otherwise}"
            ) from error

    def run(self, sample: RegionSample, neighbours: Neighbours, *, seconds: float | None = None) -> NetworkOutput:
        """One forward pass for all parts; seconds as in `run_raw`."""
        values = self.run_raw(sample, neighbours, seconds=seconds)
        return NetworkOutput.from_graph(values, self.metadata.category.region_radius_m)
