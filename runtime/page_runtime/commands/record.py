"""page-runtime record and convert: frames of any source into a recording, an MCAP file, or another layout."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from page_runtime.capture.conversion import frame_writer, layout_of, partial_of
from page_runtime.commands.outputs import require_file_place
from page_runtime.commands.sources import frames_of, is_live, opened, total_of
from page_runtime.commands.terminal import Progress
from page_runtime.commands.usage import UsageError
from page_runtime.image_files import SourceError


def record(source: str, *, target: Path, frames: int, window_s: float, quiet: bool) -> None:
    """Write the frames of `source` as they come into an .mcap file or a recording's folder."""
    _copy(source, target, None, frames, None, window_s, label="record", quiet=quiet)


def convert(
    source: str, *, target: Path, layout: str | None, frames: int, fps: float | None, window_s: float, quiet: bool
) -> None:
    """Write the frames of the recording `source` in another layout; fps: gives them times of their own, from 0 on."""
    if is_live(source):
        raise UsageError(f"convert: expected a recording, got the camera {source!r}; use page-runtime record")
    try:
        _copy(source, target, layout, frames, fps, window_s, label="convert", quiet=quiet)
    except SourceError:
        # What `record` has written so far is worth keeping; a part of a copy is not.
        if target.is_file():
            target.unlink()
        raise


def _copy(
    name: str,
    target: Path,
    layout: str | None,
    limit: int,
    fps: float | None,
    window_s: float,
    *,
    label: str,
    quiet: bool,
) -> None:
    if fps is not None and fps <= 0.0:
        raise UsageError(f"--fps: expected frames a second, got {fps:g}")
    if target.exists():
        raise UsageError(f"{target}: exists already; nothing is ever overwritten, give another name")
    if partial_of(target).exists() and layout_of(target, layout) == "recording":
        raise UsageError(
            f"{partial_of(target)}: an unfinished recording is in the way; finish it (page-runtime repair) or remove it"
        )
    require_file_place(target, option=label)
    count, failure = 0, None
    with opened(name, window_s=window_s) as source:
        with (
            frame_writer(target, layout, category=source.category, part_names=tuple(source.part_names or ())) as writer,
            Progress(label, total_of(source, limit), quiet=quiet) as progress,
        ):
            frames = frames_of(source, limit)
            while True:
                try:
                    recorded = next(frames, None)
                except SourceError as error:
                    # What a camera gave before it was lost is worth keeping.
                    if not is_live(name) or not count:
                        raise
                    failure = error
                    break
                if recorded is None:
                    break
                if fps is not None:
                    recorded = replace(recorded, frame=replace(recorded.frame, timestamp_s=count / fps))
                writer.write(recorded, calibration=source.calibration)
                count += 1
                progress.advance()
        if not quiet:
            sys.stderr.write(f"page-runtime: {count} frames in {target}\n")
    if failure is not None:
        raise failure
