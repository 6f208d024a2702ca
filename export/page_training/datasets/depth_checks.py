"""Does the depth inside the masks lie in the parts' boxes? Units and intrinsics that are wrong by a factor are the ones
under which it does not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from page_runtime.camera import Camera
from page_runtime.geometry import Array, apply
from page_runtime.image_files import SourceError, read_color, read_depth
from page_training.datasets.annotated import Annotated, AnnotatedFrame, AnnotatedInstance
from page_training.datasets.findings import Finding

# Of the depth inside a part's mask, what lies in its box grown by BOX_MARGIN_M.
BOX_MARGIN_M = 0.01
GOOD_SHARE = 0.95
CONFUSED_SHARE = 0.5
UNITS = (1.0, 1e-3, 1e-4, 1.0 / 5000.0, 1e-5)
MAX_PIXELS = 2000
MAX_DEPTH_FRAMES = 40


def check_depth(dataset: Annotated, on_frame: Callable[[], None]) -> Iterator[Finding]:
    """Does the depth inside the masks lie in the boxes, in the layout's unit and with the file's K?"""
    inside: dict[str, list[float]] = {}
    worst: tuple[float, str] = (np.inf, "")
    step = max(1, len(dataset.frames) // MAX_DEPTH_FRAMES)
    for frame in dataset.frames[::step]:
        try:
            read_color(frame.color_path)
            raw = read_depth(frame.depth_path, metres_per_unit=1.0)
            if raw.shape != (frame.camera.height, frame.camera.width):
                raise SourceError(
                    f"{frame.depth_path}: expected the {frame.camera.width}x{frame.camera.height} pixels of the colour "
                    f"picture, got {raw.shape[1]}x{raw.shape[0]}; register depth to colour first"
                )
            for i, instance in enumerate(frame.instances):
                for name, share in _shares(dataset, frame, i, instance, raw):
                    inside.setdefault(name, []).append(share)
                    if name == "" and share < worst[0]:
                        worst = share, frame.place(i)
        except SourceError as error:
            yield Finding("error", "pictures", str(error))
        on_frame()
    if not inside.get(""):
        yield Finding("error", "depth", "no depth inside any mask: nothing of it can be checked")
        return
    means = {name: float(np.mean(values)) for name, values in inside.items()}
    ours, best = means[""], max(means, key=lambda name: means[name])
    if ours >= GOOD_SHARE:
        yield Finding("fine", "depth", f"{100 * ours:.1f} % of the depth inside the masks lies in the parts' boxes")
        if worst[0] < CONFUSED_SHARE:
            yield Finding(
                "warning", "depth", f"only {100 * worst[0]:.0f} % of a part's depth lies in its box", worst[1]
            )
        return
    what = f"{100 * ours:.1f} % of the depth inside the masks lies in the parts' boxes"
    if means[best] > max(2 * ours, CONFUSED_SHARE):
        what += f", but {100 * means[best]:.1f} % {best}"
    yield Finding("error", "depth", what, worst[1])


def _shares(
    dataset: Annotated, frame: AnnotatedFrame, index: int, instance: AnnotatedInstance, raw: Array
) -> Iterator[tuple[str, float]]:
    """For each link the share of its depth in its box as the layout says (""), and under each other explanation."""
    layout = dataset.layout
    for n, link in enumerate(instance.links):
        part = link.identity - layout.first_link
        corners = dataset.models[instance.model].corners
        if not 0 <= part < len(corners):
            continue
        rows, columns = np.nonzero(frame.mask(index, n, layout.first_link) & (raw > 0))
        if len(rows) == 0:
            continue
        chosen = np.linspace(0, len(rows) - 1, min(len(rows), MAX_PIXELS)).astype(np.intp)
        pixels = np.stack([columns[chosen], rows[chosen]], axis=1).astype(float)
        values = raw[rows[chosen], columns[chosen]].astype(float)
        try:
            seen = _Seen(pixels, values, np.linalg.inv(link.matrix))
        except np.linalg.LinAlgError:
            continue

        def share(camera: Camera, unit_m: float, box: Array, seen: _Seen = seen) -> float:
            return _share_in_box(seen, camera, unit_m, box)

        yield "", share(frame.camera, layout.metres_per_unit, corners[part])
        for unit_m in UNITS:
            if unit_m != layout.metres_per_unit:
                yield f"with metres_per_unit {unit_m:g}", share(frame.camera, unit_m, corners[part])
        for factor in (0.5, 2.0):
            camera = frame.camera
            K = camera.K * np.array([[factor, factor, factor], [factor, factor, factor], [1.0, 1.0, 1.0]])
            scaled = Camera(K, camera.width, camera.height)
            yield f"with K times {factor:g}", share(scaled, layout.metres_per_unit, corners[part])
        for shift in (-1, 1):
            if 0 <= part + shift < len(corners):
                named = f"with first_link {layout.first_link - shift} in the layout"
                yield named, share(frame.camera, layout.metres_per_unit, corners[part + shift])


@dataclass(frozen=True, eq=False, slots=True)
class _Seen:
    """pixels (n,2) of a part with their raw depth values (n,); T_rest_camera: (4,4)."""

    pixels: Array
    values: Array
    T_rest_camera: Array


def _share_in_box(seen: _Seen, camera: Camera, unit_m: float, box: Array) -> float:
    """Of the readings, in units of unit_m, what lies in the box (2,3) of the rest frame."""
    points = apply(seen.T_rest_camera, camera.backproject(seen.pixels, seen.values * unit_m))
    return float(((points >= box[0] - BOX_MARGIN_M) & (points <= box[1] + BOX_MARGIN_M)).all(axis=1).mean())
