"""What a bundle's graph takes and gives: names, types and shapes, all of which follow from its metadata."""

from __future__ import annotations

from page_runtime.bundle import BundleMetadata
from page_runtime.bundle_fields import BundleError
from page_runtime.neighbours import GROUP_SIZE, INTERPOLATION_SIZE, answered_of, levels_of
from page_runtime.onnx_file import Declared, OnnxGraph
from page_runtime.onnx_messages import FLOAT, INT32

INPUT_NAMES = ("image", "points", "pixels", "group1", "group2", "group3", "up1", "up2", "up3")
OUTPUT_NAMES = ("part_logits", "radii", "side_logits", "log_extents")


def require_signature(graph: OnnxGraph, metadata: BundleMetadata) -> None:
    """BundleError where the graph takes or gives something other than its metadata and the neighbour search say."""
    names, outputs = tuple(graph.inputs), tuple(graph.outputs)
    if names != INPUT_NAMES or outputs != OUTPUT_NAMES:
        raise BundleError(f"expected inputs {INPUT_NAMES} and outputs {OUTPUT_NAMES}, got {names} and {outputs}")
    try:
        levels, answered = levels_of(metadata.num_points), answered_of(metadata.num_points)
    except ValueError as error:
        raise BundleError(str(error)) from error
    parts, keypoints = len(metadata.category.parts), metadata.category.num_keypoints
    full, size = metadata.num_points, metadata.image_size
    floats = {
        "image": (1, 3, size, size),
        "points": (1, full, 3),
        "pixels": (1, full, 2),
        "part_logits": (1, answered, parts + 1),
        "radii": (1, answered, keypoints),
        "side_logits": (1, answered, metadata.category.num_voted),
        "log_extents": (1, parts, 3),
    }
    groups = {f"group{i}": (1, count, GROUP_SIZE) for i, count in enumerate(levels[1:], 1)}
    fine = (answered, *levels[1:-1])
    ups = {f"up{i}": (1, count, INTERPOLATION_SIZE) for i, count in enumerate(fine, 1)}
    expected = {name: Declared(FLOAT, shape) for name, shape in floats.items()}
    expected |= {name: Declared(INT32, shape) for name, shape in (groups | ups).items()}
    for name, value in (graph.inputs | graph.outputs).items():
        if value != expected[name]:
            raise BundleError(f"expected {name} to be {expected[name]} by its metadata, got {value}; export it again")
