"""What the commands are given, checked before anything is computed or written."""

from __future__ import annotations

from pathlib import Path

from page_runtime.capture.playback import open_source
from page_runtime.category import Category
from page_runtime.commands.inputs import require_category
from page_runtime.commands.usage import UsageError
from page_runtime.recorded import Source


def open_fitting(knowing: Path, category: Category, recording: Path, *, with_truth: bool = False) -> Source:
    """A recording that says where objects are, of the category that the file `knowing` is for.

    ValueError for one of another category or of other parts, without regions or, where they are asked for, without true
    poses.
    """
    source = open_source(recording)
    require_category(knowing, category, str(recording), source)
    if not source.has_regions:
        raise UsageError(f"{recording}: expected a recording that says where objects are, got {source.format} without")
    if with_truth and not source.has_truth:
        raise UsageError(f"{recording}: expected a recording with true poses, got {source.format} without")
    return source
