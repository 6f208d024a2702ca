"""A piece of a validation that any process can do by itself: some frames of one recording by one bundle.

The same function does it in this process, in another one and on another machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import cv2

from page_runtime.capture.playback import open_source
from page_runtime.image_files import write_color
from page_runtime.network import Network
from page_runtime.overlay import draw
from page_runtime.part_masks import PartMasks, part_masks
from page_runtime.providers import ON_CPU, ProviderChoice
from page_runtime.recorded import Source
from page_runtime.validation.comparison import Comparison, compare_frame
from page_runtime.validation.symmetry_choice import SymmetryChoice, with_symmetries

# Some seconds of work: what an interruption costs at most, and many of them even for one recording.
FRAMES_PER_TASK = 20
PICTURE_SUFFIX = ".jpg"


@dataclass(frozen=True, slots=True)
class Task:
    """Frames [first, last) of a recording, by their place in it.

    recording, bundle: paths that hold on the machine that does it. recording_sha256, bundle_sha256: of their contents.
    threads: of onnxruntime and OpenCV. on: the provider. pictures: a folder for overlays of all frames, None for none.
    """

    recording: str
    recording_sha256: str
    bundle: str
    bundle_sha256: str
    first: int
    last: int
    looks: int
    window_s: float
    threads: int
    symmetry: tuple[SymmetryChoice, ...] = ()
    pictures: str | None = None
    on: ProviderChoice = ON_CPU

    @property
    def frames(self) -> int:
        return self.last - self.first

    def identity(self) -> dict[str, object]:
        """What the result depends on, and nothing else: not where the files lie, nor who does it."""
        described = asdict(self)
        for name in ("recording", "bundle", "pictures"):
            described.pop(name)
        return described


def split(frames: int, per_task: int = FRAMES_PER_TASK) -> Iterator[tuple[int, int]]:
    """[first, last) of each piece."""
    yield from pairwise([*range(0, frames, per_task), frames])


def do(task: Task, on_frame: Callable[[], None] = lambda: None) -> tuple[Comparison, ...]:
    """The comparisons of the task's frames, in order. Errors as those of `open_source` and `Network`."""
    cv2.setNumThreads(task.threads)
    network = _network(task.bundle, task.bundle_sha256, task.threads, task.on)
    source, masks = _source(task.recording, task.recording_sha256, task.window_s)
    category = with_symmetries(network.metadata.category, task.symmetry)
    found: list[Comparison] = []
    for entry in source.entries[task.first : task.last]:
        recorded = entry.read()
        estimated = compare_frame(network, category, recorded, masks, max_looks=task.looks)
        found += estimated.comparisons
        if task.pictures is not None:
            drawn = draw(recorded.frame, tuple(zip(recorded.instances, estimated.poses, strict=True)), with_truth=True)
            with suppress(FileExistsError):
                Path(task.pictures).mkdir(parents=True)
            write_color(Path(task.pictures) / f"{recorded.frame.index:06d}{PICTURE_SUFFIX}", drawn)
        on_frame()
    return tuple(found)


# A process does many tasks of few recordings; loading a network takes as long as several frames.
@lru_cache(maxsize=2)
def _network(path: str, sha256: str, threads: int, on: ProviderChoice) -> Network:
    del sha256  # A file that has changed is loaded again.
    return Network(path, threads=threads, on=on)


@lru_cache(maxsize=4)
def _source(path: str, sha256: str, window_s: float) -> tuple[Source, PartMasks | None]:
    del sha256
    source = open_source(path, window_s=window_s)
    return source, part_masks(source)
