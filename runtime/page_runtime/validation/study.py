"""Recordings and the bundles they are estimated with, and the document made of all comparisons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from page_runtime.category import Category
from page_runtime.providers import ON_CPU, ProviderChoice
from page_runtime.recorded import Source
from page_runtime.validation.comparison import Comparison
from page_runtime.validation.figures import (
    PAPER_COMPATIBLE,
    category_figures,
    confidence_figures,
    paper_compatible,
    pooled_figures,
)
from page_runtime.validation.statistics import REPLICATES, SEED, Resampling
from page_runtime.validation.symmetry_choice import SymmetryChoice, with_symmetries
from page_runtime.validation.work import FRAMES_PER_TASK, Task, split


@dataclass(frozen=True, eq=False, slots=True)
class Study:
    """One recording by one bundle. name: what it is called in figures and pictures. category: the bundle's."""

    name: str
    path: Path
    sha256: str
    source: Source
    bundle: Path
    bundle_sha256: str
    category: Category

    def tasks(
        self,
        *,
        looks: int,
        window_s: float,
        threads: int,
        symmetry: tuple[SymmetryChoice, ...] = (),
        pictures: Path | None = None,
        on: ProviderChoice = ON_CPU,
    ) -> list[Task]:
        """All its frames in pieces."""
        return [
            Task(
                str(self.path.resolve()),
                self.sha256,
                str(self.bundle.resolve()),
                self.bundle_sha256,
                first,
                last,
                looks,
                window_s,
                threads,
                symmetry,
                None if pictures is None else str(pictures.resolve()),
                on,
            )
            for first, last in split(len(self.source), FRAMES_PER_TASK)
        ]


def document_of(
    studies: Sequence[Study],
    comparisons: Mapping[str, Sequence[Comparison]],
    *,
    looks: int,
    symmetry: tuple[SymmetryChoice, ...] = (),
    seed: int = SEED,
) -> dict[str, Any]:
    """Everything `page-runtime validate` writes. comparisons: by the study's name, in the order of its frames.

    Figures of a category are over all its recordings together; the same comparisons and seed give the same document.
    """
    first_frame: dict[str, int] = {}
    frames = 0
    for study in studies:
        first_frame[study.name] = frames
        frames += len(study.source)
    resampling = Resampling.of(frames, seed=seed)
    place = {
        study.name: {entry.index: first_frame[study.name] + i for i, entry in enumerate(study.source.entries)}
        for study in studies
    }
    by_category: dict[str, list[Study]] = {}
    for study in studies:
        by_category.setdefault(study.category.name, []).append(study)
    parts, joints, categories, compatible = [], [], [], []
    for name, own in by_category.items():
        category = with_symmetries(own[0].category, symmetry)
        each = [(one, place[study.name][one.frame]) for study in own for one in comparisons[study.name]]
        found, where = [one for one, _ in each], [frame for _, frame in each]
        figures = category_figures(category, found, where, resampling)
        parts += figures["parts"]
        joints += [{**joint, "category": name} for joint in figures["joints"]]
        counts = {"frames": sum(len(study.source) for study in own), "instances": figures["instances"]}
        pooled = pooled_figures(found, where, resampling)
        categories.append({"name": name, **counts, **pooled, "confidence": confidence_figures(found)})
        compatible += paper_compatible(category, found)
    return {
        "recording": ", ".join(study.name for study in studies),
        "bundle": ", ".join(dict.fromkeys(study.bundle.name for study in studies)),
        "category": ", ".join(by_category),
        "frames": frames,
        "instances": sum(len(found) for found in comparisons.values()),
        "parts": parts,
        "joints": joints,
        "categories": categories,
        "recordings": [_recording(study, comparisons[study.name], symmetry) for study in studies],
        "paper_compatible": {"what": PAPER_COMPATIBLE, "parts": compatible},
        "settings": {
            "looks": looks,
            "symmetry": [_words(choice) for choice in symmetry] or ["of the bundle"],
            "bootstrap": {"seed": seed, "replicates": REPLICATES, "resampled": "frames"},
        },
    }


def _recording(study: Study, found: Sequence[Comparison], symmetry: tuple[SymmetryChoice, ...]) -> dict[str, Any]:
    """The figures of one recording, without intervals."""
    figures = category_figures(with_symmetries(study.category, symmetry), found, [0] * len(found), None)
    return {
        "recording": study.name,
        "format": study.source.format,
        "sha256": study.sha256,
        "bundle": study.bundle.name,
        "bundle_sha256": study.bundle_sha256,
        "frames": len(study.source),
        **figures,
    }


def _words(choice: SymmetryChoice) -> str:
    if choice.part is None:
        return "none"
    return f"{choice.part}={choice.axis}:{choice.fold or 'any'}"
