"""What the ablations compare: one network each, and the paper's figures of the same comparison."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from benchmarks.approaches import Way

from page_runtime.category import Category
from page_training.config import RADIUS_WEIGHT, SEGMENTATION_WEIGHT, Fusion, TrainingConfig
from page_training.keypoint_estimator import EstimatorConfig, estimate_keypoints, part_clouds
from page_training.keypoint_report import heuristics
from page_training.keypoints import METHODS, read_keypoints, with_keypoints, write_keypoints

SEED = 1


@dataclass(frozen=True, slots=True)
class Variant:
    """One row. table: of the paper. paper: its figures, rotation [deg] of its parts, on `paper_category`.

    method, count: the keypoints, None for the project's eight of which three are voted; `count` ones are all voted.
    weights: lambda 1 and 2 of the KP-Estimator. way: to a pose. trained_as: of the variant whose network it shares.
    """

    name: str
    table: str
    paper: tuple[float, float] | None = None
    paper_category: str = "scissors"
    method: str | None = None
    count: int = 3
    weights: tuple[float, float] = (0.6, 0.2)
    fusion: Fusion = "gated"
    tau: tuple[float, float] = (SEGMENTATION_WEIGHT, RADIUS_WEIGHT)
    way: Way = "scoring"
    trained_as: str | None = None
    seed: int = SEED

    def config(self, category: str, samples: int) -> TrainingConfig:
        return TrainingConfig(
            category,
            fusion=self.fusion,
            segmentation_weight=self.tau[0],
            radius_weight=self.tau[1],
            samples=samples,
            seed=self.seed,
        )


LEARNED = METHODS[0]
OURS = "ours"
VARIANTS = (
    Variant(OURS, "II, IV, VI", (1.9, 5.4)),
    Variant("ours, other seed", "", seed=SEED + 1),
    Variant("depth only", "IV", (6.7, 4.2), "laptop", fusion="depth"),
    Variant("concatenation", "II", (2.6, 7.1), fusion="concatenated"),
    Variant("dense fusion", "II", (2.3, 6.5), fusion="dense"),
    Variant("regression", "II", (10.5, 15.4), way="regression", trained_as=OURS),
    Variant("anchors (6-PACK)", "I, II", (7.8, 8.5), way="anchors"),
    Variant("normalised coordinates (A-NCSH)", "I", (2.0, 2.6), way="normalised"),
    Variant("pair voting (CPPF)", "I", (3.2, 5.7), way="pairs"),
    Variant("KP-Estimator, 3", "II, VII", (1.9, 5.4), method=LEARNED),
    Variant("FPS, 3", "II", (11.2, 12.6), method="FPS"),
    Variant("box corners, 3", "II", (9.8, 10.5), method="box corners"),
    Variant("off surface, 3", "", method="off surface"),
    Variant("tau 0.5, 0.5", "VI", (2.1, 5.9), tau=(0.5, 0.5)),
    Variant("tau 0.75, 0.25", "VI", (3.2, 9.8), tau=(0.75, 0.25)),
    Variant("tau 0.1, 0.9", "VI", (1.8, 5.3), tau=(0.1, 0.9)),
    Variant("tau 0.9, 0.1", "VI", (8.8, 12.8), tau=(0.9, 0.1)),
    Variant("KP-Estimator, 4", "II", (1.8, 5.2), method=LEARNED, count=4),
    Variant("KP-Estimator, 5", "II", (1.7, 5.1), method=LEARNED, count=5),
    Variant("lambda 0.2, 0.4", "VII", (3.8, 8.5), method=LEARNED, weights=(0.2, 0.4)),
    Variant("lambda 0.4, 0.3", "VII", (2.1, 5.8), method=LEARNED, weights=(0.4, 0.3)),
    Variant("lambda 0.8, 0.1", "VII", (1.9, 5.3), method=LEARNED, weights=(0.8, 0.1)),
)


def category_of(variant: Variant, category: Category, folder: Path) -> Category:
    """The category with the variant's keypoints, which are kept in `folder` so that every run finds the same."""
    if variant.method is None:
        return category
    path = folder / variant.name / "keypoints.json"
    if not path.is_file():
        config = EstimatorConfig(
            keypoints=variant.count, wasserstein_weight=variant.weights[0], separation_weight=variant.weights[1]
        )
        rng = np.random.default_rng(config.seed)
        clouds = part_clouds(category.name, rng, config.instances, config.points)
        found = [
            estimate_keypoints(cloud, config)[0]
            if variant.method == LEARNED
            else heuristics(cloud, variant.count)[variant.method]
            for cloud in clouds
        ]
        path.parent.mkdir(parents=True, exist_ok=True)
        write_keypoints(path, with_keypoints(category, found), found)
    return read_keypoints(path, category)
