"""The exported network in an onnxruntime session; the only module that imports onnxruntime."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from page_runtime.bundle import BundleError, BundleMetadata
from page_runtime.bundle_file import read_bundle
from page_runtime.neighbours import ANSWERED, GROUP_SIZE, INTERPOLATION_SIZE, LEVELS, Neighbours
from page_runtime.sampling import RegionSample

INPUT_NAMES = ("image", "points", "pixels", "group1", "group2", "group3", "up1", "up2", "up3")
OUTPUT_NAMES = ("part_logits", "radii", "side_logits", "log_extents")
# Its kernel takes much longer than an addition and a layer norm: a forward pass of the boxes' network took 17.8 ms with
# it, 14.3 without (one thread, onnxruntime 1.31, in turns).
_SLOWER = ["SkipLayerNormFusion"]


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
    """A loaded bundle, ready to run."""

    def __init__(self, path: Path | str, *, threads: int = 0) -> None:
        """Load a bundle; threads 0 leaves the number to onnxruntime. Raises BundleError with the reason."""
        self.path = Path(path)
        file = read_bundle(self.path)
        self.metadata = file.metadata
        options = ort.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3
        # Threads that spin while they wait take a core from the scorer, which runs between two calls.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            self.session = ort.InferenceSession(
                file.data, options, providers=["CPUExecutionProvider"], disabled_optimizers=_SLOWER
            )
        except Exception as error:  # onnxruntime raises many unrelated classes for one cause: a file it cannot load
            reason = str(error).splitlines()[0]
            raise BundleError(
                f"bundle {self.path}: onnxruntime cannot load it ({reason}); is it an exported, complete .onnx file?"
            ) from error
        self._check_signature()

    def _check_signature(self) -> None:
        """The graph must take and give what its metadata and the neighbour search say."""
        names = tuple(value.name for value in self.session.get_inputs())
        outputs = tuple(value.name for value in self.session.get_outputs())
        if names != INPUT_NAMES or outputs != OUTPUT_NAMES:
            raise BundleError(
                f"bundle {self.path}: expected inputs {INPUT_NAMES} and outputs {OUTPUT_NAMES}, "
                f"got {names} and {outputs}"
            )
        metadata = self.metadata
        if metadata.num_points != LEVELS[0]:
            raise BundleError(f"bundle {self.path}: expected num_points {LEVELS[0]}, got {metadata.num_points}")
        parts, keypoints = len(metadata.category.parts), metadata.category.num_keypoints
        full, size = metadata.num_points, metadata.image_size
        floats = {
            "image": [1, 3, size, size],
            "points": [1, full, 3],
            "pixels": [1, full, 2],
            "part_logits": [1, ANSWERED, parts + 1],
            "radii": [1, ANSWERED, keypoints],
            "side_logits": [1, ANSWERED, metadata.category.num_voted],
            "log_extents": [1, parts, 3],
        }
        groups = {f"group{i}": [1, count, GROUP_SIZE] for i, count in enumerate(LEVELS[1:], 1)}
        fine = (ANSWERED, *LEVELS[1:-1])
        ups = {f"up{i}": [1, count, INTERPOLATION_SIZE] for i, count in enumerate(fine, 1)}
        expected = {name: ("tensor(float)", shape) for name, shape in floats.items()}
        expected |= {name: ("tensor(int32)", shape) for name, shape in (groups | ups).items()}
        for value in (*self.session.get_inputs(), *self.session.get_outputs()):
            kind, shape = expected[value.name]
            if value.type != kind or value.shape != shape:
                raise BundleError(
                    f"bundle {self.path}: expected {value.name} to be {kind} {shape} by its metadata, "
                    f"got {value.type} {value.shape}; export it again"
                )

    def run_raw(self, sample: RegionSample, neighbours: Neighbours) -> tuple[NDArray[np.float32], ...]:
        """The graph's outputs as they are, in the order of OUTPUT_NAMES."""
        outputs = self.session.run(OUTPUT_NAMES, feeds(self.metadata, sample, neighbours))
        return tuple(np.asarray(value, dtype=np.float32) for value in outputs)

    def run(self, sample: RegionSample, neighbours: Neighbours) -> NetworkOutput:
        """One forward pass for all parts."""
        return NetworkOutput.from_graph(self.run_raw(sample, neighbours), self.metadata.category.region_radius_m)
