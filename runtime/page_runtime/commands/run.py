"""page-runtime run: a JSON line for every object in every frame."""

from __future__ import annotations

from pathlib import Path

from page_runtime.commands.inputs import Inputs, estimates, load_network, require_fitting, require_region
from page_runtime.commands.live import live
from page_runtime.commands.outputs import overlay_output, require_file_place, require_folder_place, text_output
from page_runtime.commands.sources import frames_of, is_live, opened, total_of
from page_runtime.commands.terminal import Progress
from page_runtime.overlay import draw
from page_runtime.providers import ProviderChoice
from page_runtime.recorded import FrameSource, Source
from page_runtime.sampling import Region
from page_runtime.schema import json_line, pose_record


def run(
    source: str,
    *,
    bundle: Path,
    region: Region | None,
    out: Path | None,
    overlay: Path | None,
    frames: int,
    window_s: float,
    threads: int,
    on: ProviderChoice,
    looks: int,
    quiet: bool,
) -> None:
    """Estimate every frame of `source`, or so many, and write the lines to `out` (None: standard output).

    A camera is followed as by `page-runtime live` without its further options.
    """
    if is_live(source):
        live(
            source,
            bundle=bundle,
            region=region,
            mask=None,
            detector=None,
            classes=(),
            objects=0,
            track=True,
            deadline_ms=None,
            status=None,
            out=out,
            overlay=overlay,
            frames=frames,
            window_s=window_s,
            threads=threads,
            on=on,
            looks=looks,
            quiet=quiet,
        )
        return
    network, threads = load_network(bundle, threads=threads, looks=looks, on=on)
    require_file_place(out, option="--out")
    require_folder_place(overlay, option="--overlay")
    with opened(source, window_s=window_s) as found:
        require_fitting(bundle, network, source, found)
        require_region(source, found, region)
        _run(Inputs(network, found, threads, looks, region), out, overlay, frames, quiet=quiet)


def _run(inputs: Inputs[FrameSource], out: Path | None, overlay: Path | None, limit: int, *, quiet: bool) -> None:
    source = inputs.source
    entries = source.entries if isinstance(source, Source) and inputs.region is None else ()
    several = any(len(entry.instances) > 1 for entry in entries)
    with (
        text_output(out) as lines,
        overlay_output(overlay) as pictures,
        Progress("run", total_of(source, limit), quiet=quiet) as progress,
    ):
        for recorded, found in estimates(inputs, frames_of(source, limit)):
            frame = recorded.frame
            for i, (_, pose) in enumerate(found):
                number = i if several else None
                record = pose_record(pose, frame=frame.index, timestamp_s=frame.timestamp_s, instance=number)
                lines.write(json_line(record))
            lines.flush()
            if pictures is not None:
                pictures.add(frame.index, draw(frame, found))
            progress.advance()
