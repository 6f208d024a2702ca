"""Does an annotated data set say what its own pictures show?"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from page_runtime.image_files import SourceError, read_color, read_depth
from page_training.datasets.annotated import Annotated, AnnotatedFrame
from page_training.datasets.depth_checks import check_seen, sampled
from page_training.datasets.evidence import SeenPart, thinned
from page_training.datasets.findings import Finding


def check_pictures(dataset: Annotated, on_frame: Callable[[], None], most_frames: int) -> Iterator[Finding]:
    """Findings of the pictures of some frames, those that cannot be read named and left out."""
    seen: list[SeenPart] = []
    chosen = [dataset.frames[i] for i in sampled(len(dataset.frames), most_frames)]
    for frame in chosen:
        try:
            seen += _seen(dataset, frame, _units(frame))
        except SourceError as error:
            yield Finding("error", "pictures", str(error))
        on_frame()
    yield Finding("fine", "pictures", f"{len(chosen)} of {len(dataset.frames)} read")
    yield from check_seen(seen, lambda unit_m: f"metres_per_unit {unit_m:g} in the layout")


def _units(frame: AnnotatedFrame) -> np.ndarray:
    """(H,W) raw depth, once the colour could be read, too."""
    read_color(frame.color_path)
    units = read_depth(frame.depth_path, metres_per_unit=1.0)
    if units.shape != (frame.camera.height, frame.camera.width):
        raise SourceError(
            f"{frame.depth_path}: expected the {frame.camera.width}x{frame.camera.height} pixels of the colour "
            f"picture, got {units.shape[1]}x{units.shape[0]}; register depth to colour first"
        )
    return units


def _seen(dataset: Annotated, frame: AnnotatedFrame, units: np.ndarray) -> Iterator[SeenPart]:
    layout = dataset.layout
    for i, instance in enumerate(frame.instances):
        corners = dataset.models[instance.model].corners
        for n, link in enumerate(instance.links):
            part = link.identity - layout.first_link
            if not 0 <= part < len(corners):
                continue
            mask = frame.mask(i, n, layout.first_link)
            # Pictures of part indices say nothing where there is no depth.
            pixels, values = thinned(mask if frame.label_path is None else mask & (units > 0), units)
            yield SeenPart(
                f"{frame.place(i)}, link {link.identity}",
                frame.camera,
                layout.metres_per_unit,
                link.matrix,
                corners[part],
                pixels,
                values,
                region=instance.region,
                others={
                    f"with first_link {layout.first_link - shift} in the layout": corners[part + shift]
                    for shift in (-1, 1)
                    if 0 <= part + shift < len(corners)
                },
            )
