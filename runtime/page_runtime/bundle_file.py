"""A bundle's file: what it says and holds, checked before anything is done with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from page_runtime.bundle import METADATA_KEY, BundleError, BundleMetadata
from page_runtime.graph_limits import Size, size_of
from page_runtime.onnx_file import OnnxGraph, read_onnx
from page_runtime.wire import WireError

MAX_BUNDLE_BYTES = 64 << 20


@dataclass(frozen=True, eq=False, slots=True)
class BundleFile:
    """data: the file's bytes, an ONNX model that is safe to load. size: of its graph. What the graph declares of its
    inputs and outputs is what it takes and gives."""

    data: bytes
    metadata: BundleMetadata
    graph: OnnxGraph
    size: Size


def read_bundle(path: Path) -> BundleFile:
    """Read and check a bundle; BundleError with the reason for what is not one. OSError where it cannot be read.

    Nothing is loaded or computed: the work is bounded by MAX_BUNDLE_BYTES and the limits of `onnx_file` and
    `graph_limits`.
    """
    if not path.is_file():
        raise BundleError(f"bundle: no file {path}; expected an .onnx file made by page-export")
    with path.open("rb") as file:
        data = file.read(MAX_BUNDLE_BYTES + 1)
    if not 0 < len(data) <= MAX_BUNDLE_BYTES:
        got = "more" if data else 0
        raise BundleError(f"bundle {path}: expected 1 to {MAX_BUNDLE_BYTES} bytes, got {got}")
    try:
        file_read = read_onnx(data)
        if len(file_read.metadata) > 1:
            others = sorted(file_read.metadata.keys() - {METADATA_KEY})
            raise BundleError(f"its metadata has entries that are not understood: {others}")
        metadata = BundleMetadata.from_json(file_read.metadata[METADATA_KEY])
        if metadata.opset != file_read.graph.opset:
            raise BundleError(f"bundle metadata: opset {metadata.opset}, but the graph's is {file_read.graph.opset}")
        _check_batch({value.shape[0] for value in file_read.graph.inputs.values() if value.shape})
        return BundleFile(data, metadata, file_read.graph, size_of(file_read.graph))
    except WireError as error:
        raise BundleError(f"bundle {path}: {error}; is it a complete .onnx file of page-export?") from error
    except BundleError as error:
        raise BundleError(f"bundle {path}: {error}") from error


def _check_batch(rows: set[int | str]) -> None:
    """rows: of the inputs. Where they differ it is no batch, and `Network` says which input is wrong."""
    if len(rows) == 1 and rows != {1}:
        (count,) = rows
        objects = "a free number of" if isinstance(count, str) else str(count)
        raise BundleError(
            f"it takes {objects} objects at once; the runtime takes one, which is quicker on a CPU: export it without "
            "--batch"
        )
