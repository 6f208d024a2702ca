"""`page-train doctor`: what is wrong with a data set, and where."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from page_runtime.capture.bop import read_bop
from page_runtime.capture.own_recording import read_recording
from page_runtime.capture.playback import open_source
from page_runtime.image_files import SourceError
from page_runtime.part_masks import PartMasks, part_masks
from page_runtime.recorded import Refuse, Source
from page_runtime.recording import RECORDING_FILE
from page_training.categories import category_named
from page_training.datasets.annotated import read_annotated
from page_training.datasets.bop_parts import in_order_of, models_file_of, read_bop_parts
from page_training.datasets.checks import check_annotated
from page_training.datasets.depth_checks import MAX_FRAMES
from page_training.datasets.findings import Finding
from page_training.datasets.layout import BopLayout, read_layout, require_dataset_folder, unverified
from page_training.datasets.recorded_checks import check_source

Read = Callable[[Path, Refuse], tuple[Source, PartMasks | None]]


def examine(
    path: Path, layout: str | None = None, on_frame: Callable[[], None] = lambda: None, most_frames: int = MAX_FRAMES
) -> list[Finding]:
    """Findings of the data set at `path`, by a layout (see `layout.read_layout`) or, without one, as whatever
    `page-runtime` recognises: its own recordings, BOP, ReArtMix. most_frames: whose pictures are read.
    SourceError where nothing of it can be read."""
    if layout is not None:
        described = read_layout(layout)
        require_dataset_folder(path)
        if not isinstance(described, BopLayout):
            return check_annotated(read_annotated(path, described), on_frame, most_frames)
        told = [] if described.verified else [Finding("warning", "layout", f"{unverified(described)}; read on")]
        ordered = in_order_of(described, category_named(described.frames.category))
        return [*told, *_recorded(path, partial(_bop_parts, layout=ordered), on_frame, most_frames)]
    # By its files: reading it as a source would stop at the first fault.
    reartmix = read_layout("reartmix")
    assert not isinstance(reartmix, BopLayout)
    if (path / reartmix.models).is_file() and (path / reartmix.annotations).is_dir():
        return check_annotated(read_annotated(path, reartmix), on_frame, most_frames)
    return _recorded(path, _reader(path), on_frame, most_frames)


def _bop_parts(path: Path, note: Refuse, layout: BopLayout | None) -> tuple[Source, PartMasks | None]:
    return read_bop_parts(path, layout, note)


def _reader(path: Path) -> Read:
    if (path / RECORDING_FILE).is_file():
        return _own
    if not (path / "scene_camera.json").is_file():
        return lambda path, _: (open_source(path), None)
    if (path / "scene_gt.json").is_file() and models_file_of(path, None) is not None:
        return partial(_bop_parts, layout=None)
    return lambda path, note: (read_bop(path, note), None)


def _own(path: Path, note: Refuse) -> tuple[Source, PartMasks | None]:
    source = read_recording(path, note)
    return source, part_masks(source)


def _recorded(path: Path, read: Read, on_frame: Callable[[], None], most_frames: int) -> list[Finding]:
    """Findings of what `read` reads; where not one frame is left of it, why."""
    problems: list[str] = []
    try:
        source, masks = read(path, lambda error: problems.append(str(error)))
    except SourceError:
        if not problems:
            raise
        return [Finding("error", "files", problem) for problem in problems]
    return check_source(source, masks, problems, on_frame, most_frames)
