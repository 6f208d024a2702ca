"""Where the keypoints of a part are: by rule. `page-train keypoints` compares them with learned ones.

A trial (METHOD 9) found off-surface keypoints at 0.3 to 0.35 of the part's size best for plate-like parts: keypoints
on the surface or in the plate's plane double the rotation error, far ones dilute it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from page_runtime.category import Category
from page_runtime.geometry import Array

NUM_VOTED = 3
# What `page-train keypoints` compares: learned ones first, then those of `keypoint_report.heuristics`.
METHODS = ("KP-Estimator", "FPS", "box corners", "off surface")


def off_surface_keypoints() -> Array:
    """(8,3) keypoints in units of the part's diagonal, canonical frame.

    Three voted ones above the part, three below turned by 60 degrees, one beyond either end along x. No plane holds
    them all and no reflection maps the set to itself in order, so a mirrored pose never fits all eight radii
    (METHOD 12).
    """
    height, radius = 0.33, 0.33
    above = np.radians([90.0, 210.0, 330.0])
    below = np.radians([30.0, 150.0, 270.0])
    rings = [
        np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(3, z)], axis=1)
        for angles, z in ((above, height), (below, -height))
    ]
    return np.concatenate([*rings, [[0.6, 0.0, 0.0], [-0.5, 0.2, 0.1]]])


def with_keypoints(category: Category, keypoints_unit: Sequence[Array]) -> Category:
    """The category with other keypoints, (n,3) of each part in units of its diagonal, all of them voted."""
    if len(keypoints_unit) != len(category.parts):
        raise ValueError(f"keypoints: expected those of {len(category.parts)} parts, got {len(keypoints_unit)}")
    parts = tuple(replace(part, keypoints_unit=own) for part, own in zip(category.parts, keypoints_unit, strict=True))
    return replace(category, parts=parts, num_voted=len(parts[0].keypoints_unit))


def write_keypoints(path: Path, category: Category, keypoints_unit: Sequence[Array]) -> None:
    """Keypoints (n,3) of each part as `page-train pose --keypoints` reads them."""
    named = {part.name: np.asarray(own).tolist() for part, own in zip(category.parts, keypoints_unit, strict=True)}
    path.write_text(json.dumps({"category": category.name, "keypoints_unit": named}, indent=2) + "\n")


def read_keypoints(path: Path, category: Category) -> Category:
    """The category with the keypoints of a file of `write_keypoints`; ValueError where it is none or another's."""
    try:
        document = json.loads(path.read_text())
        name, named = document["category"], document["keypoints_unit"]
        found = {part: np.asarray(own, dtype=float) for part, own in named.items()}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"keypoints {path}: expected a file of page-train keypoints --out, got {error!r}") from error
    parts = [part.name for part in category.parts]
    if name != category.name or sorted(found) != sorted(parts):
        raise ValueError(
            f"keypoints {path}: expected those of {category.name!r} with the parts {', '.join(parts)}, got {name!r} "
            f"with {', '.join(sorted(found))}"
        )
    try:
        return with_keypoints(category, [found[part] for part in parts])
    except ValueError as error:
        raise ValueError(f"keypoints {path}: {error}") from error
