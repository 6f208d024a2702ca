"""page-runtime run: a JSON line for every object in every frame."""

from __future__ import annotations

from pathlib import Path

from page_runtime.commands.inputs import estimates, open_inputs
from page_runtime.commands.outputs import overlay_output, require_file_place, require_folder_place, text_output
from page_runtime.commands.terminal import Progress
from page_runtime.overlay import draw
from page_runtime.sampling import Region
from page_runtime.schema import json_line, pose_record


def run(
    source: Path,
    *,
    bundle: Path,
    region: Region | None,
    out: Path | None,
    overlay: Path | None,
    threads: int,
    looks: int,
    quiet: bool,
) -> None:
    """Estimate every frame of `source` and write the lines to `out` (None: standard output)."""
    inputs = open_inputs(source, bundle, threads=threads, looks=looks, region=region)
    require_file_place(out, option="--out")
    require_folder_place(overlay, option="--overlay")
    several = any(len(entry.instances) > 1 for entry in inputs.source.entries)
    with (
        text_output(out) as lines,
        overlay_output(overlay) as pictures,
        Progress("run", len(inputs.source), quiet=quiet) as progress,
    ):
        for recorded, found in estimates(inputs):
            frame = recorded.frame
            for i, (_, pose) in enumerate(found):
                number = i if several else None
                record = pose_record(pose, frame=frame.index, timestamp_s=frame.timestamp_s, instance=number)
                lines.write(json_line(record))
            lines.flush()
            if pictures is not None:
                pictures.add(frame.index, draw(frame, found))
            progress.advance()
