"""What the network said of single points against the truth: parts (the paper's Table IV) and radii."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from page_runtime.category import Category
from page_runtime.equivalents import Description, is_visible
from page_runtime.evaluation import true_keypoints
from page_runtime.network import NetworkOutput
from page_runtime.part_poses import members_of
from page_runtime.sampling import RegionSample


@dataclass(frozen=True, slots=True)
class Segmentation:
    """Points of one look at one object. points, right: all of them, and those whose class (background is one) is the
    true one. part_points, part_right: (K,) of the points that truly are of each part."""

    points: int
    right: int
    part_points: tuple[int, ...]
    part_right: tuple[int, ...]


def segmentation(
    sample: RegionSample, output: NetworkOutput, part_map: NDArray[np.uint8], order: tuple[int, ...]
) -> Segmentation:
    """part_map: (H,W) of the frame, k + 1 where part k is seen; order: of the parts in the nearest description."""
    num_parts = len(order)
    count = min(sample.num_distinct, len(output.part_logits))
    said = output.part_logits[:count].argmax(axis=1)
    # What the masks call part order[k] is part k of the description, and what is of none is the last class.
    class_of = np.full(num_parts + 1, num_parts)
    class_of[np.array(order) + 1] = np.arange(num_parts)
    true = class_of[part_map.reshape(-1)[sample.source_index[:count]]]
    right = said == true
    return Segmentation(
        points=int(count),
        right=int(right.sum()),
        part_points=tuple(int((true == k).sum()) for k in range(num_parts)),
        part_right=tuple(int((right & (true == k)).sum()) for k in range(num_parts)),
    )


def radius_errors(
    category: Category, sample: RegionSample, output: NetworkOutput, description: Description
) -> dict[str, float]:
    """For each visible part that the network gave any point, the mean over these points and all keypoints of the size
    of the radius's error, m: the radii that vote, against the distances to the true keypoints."""
    found = {}
    truths = {truth.name: truth for truth in description.truths}
    for part, members in zip(category.parts, members_of(output, sample.num_distinct), strict=True):
        truth = truths[part.name]
        if not len(members) or not is_visible(truth):
            continue
        points = sample.points_camera[members].astype(np.float64)
        away = np.linalg.norm(points[:, None] - true_keypoints(part, truth), axis=2)
        found[part.name] = float(np.abs(output.radii_m[members] - away).mean())
    return found
