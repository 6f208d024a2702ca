"""A bundle's file: what it says and holds, checked before anything is done with it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from page_runtime.bundle import METADATA_KEY, BundleMetadata
from page_runtime.bundle_fields import BundleError
from page_runtime.graph_limits import Size, size_of
from page_runtime.onnx_file import OnnxFile, OnnxGraph, read_onnx
from page_runtime.signature import require_signature
from page_runtime.wire import WireError

MAX_BUNDLE_BYTES = 64 << 20
# Of what an error says: a refused file decides on most of its words.
_MAX_WORDS = 600


@dataclass(frozen=True, eq=False, slots=True)
class BundleFile:
    """data: the file's bytes, an ONNX model that is safe to load. size: of its graph. What the graph declares of its
    inputs and outputs is what it takes and gives."""

    data: bytes
    metadata: BundleMetadata
    graph: OnnxGraph
    size: Size


def read_metadata(path: Path) -> BundleMetadata:
    """What a bundle says of itself, also one for several objects at once, which no `Network` takes. Errors as of
    `read_bundle`; of one for several the graph is not looked at, as nothing of it may be run."""
    with _named(path):
        data, file, metadata = _read(path)
        return metadata if _rows(file.graph) not in (None, 1) else _checked(data, file, metadata).metadata


def read_bundle(path: Path) -> BundleFile:
    """Read and check a bundle; BundleError with the reason for what is not one. OSError where it cannot be read.

    Nothing is loaded or computed: the work is bounded by MAX_BUNDLE_BYTES and the limits of `onnx_file` and
    `graph_limits`.
    """
    with _named(path):
        data, file, metadata = _read(path)
        rows = _rows(file.graph)
        if rows not in (None, 1):
            objects = "a free number of" if isinstance(rows, str) else str(rows)
            raise BundleError(
                f"it takes {objects} objects at once; the runtime takes one, which is quicker on a CPU: export it "
                "without --batch"
            )
        return _checked(data, file, metadata)


def _read(path: Path) -> tuple[bytes, OnnxFile, BundleMetadata]:
    if not path.is_file():
        raise BundleError("no file there; expected an .onnx file made by page-export")
    with path.open("rb") as opened:
        data = opened.read(MAX_BUNDLE_BYTES + 1)
    if not 0 < len(data) <= MAX_BUNDLE_BYTES:
        got = "more" if data else 0
        raise BundleError(f"expected 1 to {MAX_BUNDLE_BYTES} bytes, got {got}")
    file = read_onnx(data)
    if len(file.metadata) > 1:
        others = sorted(file.metadata.keys() - {METADATA_KEY})
        raise BundleError(f"its metadata has entries that are not understood: {others}")
    metadata = BundleMetadata.from_json(file.metadata[METADATA_KEY])
    if metadata.opset != file.graph.opset:
        raise BundleError(f"bundle metadata: opset {metadata.opset}, but the graph's is {file.graph.opset}")
    return data, file, metadata


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Errors that say which file."""
    try:
        yield
    except WireError as error:
        raise BundleError(f"bundle {path}: {_shown(error)}; is it a complete .onnx file of page-export?") from error
    except BundleError as error:
        raise BundleError(f"bundle {path}: {_shown(error)}") from error


def _shown(error: Exception) -> str:
    """What may be shown in a terminal, and is short enough to be read: how it begins and how it ends."""
    words = str(error)
    if len(words) > _MAX_WORDS:
        words = f"{words[:_MAX_WORDS]}{words[-_MAX_WORDS:]}"
    words = "".join(one if one.isprintable() else ascii(one)[1:-1] for one in words)
    return words if len(words) <= _MAX_WORDS else f"{words[: _MAX_WORDS // 2]} ... {words[-_MAX_WORDS // 2 :]}"


def _rows(graph: OnnxGraph) -> int | str | None:
    """Of all inputs; None where they differ, and it is no batch."""
    rows = {value.shape[0] for value in graph.inputs.values() if value.shape}
    return rows.pop() if len(rows) == 1 else None


def _checked(data: bytes, file: OnnxFile, metadata: BundleMetadata) -> BundleFile:
    checked = BundleFile(data, metadata, file.graph, size_of(file.graph))
    require_signature(file.graph, metadata)
    return checked
