"""Poses of an object of a category's scenes, anywhere and turned any way."""

from __future__ import annotations

import numpy as np

from page_runtime.category import Category
from page_runtime.geometry import Array, transform_from
from page_runtime.recorded import PartTruth
from page_runtime.similarity import so3_exp
from page_training.scenes.kinds import scene_category


def random_rotation(rng: np.random.Generator) -> Array:
    return so3_exp(rng.normal(size=(1, 3)))[0]


def scene_pose(category: Category, rng: np.random.Generator) -> tuple[tuple[PartTruth, ...], list[Array]]:
    """Truths of a random object in a random pose, and its parts' poses."""
    kind = scene_category(category.name)
    model = kind.sample_object(rng)
    states = kind.sample_states(rng, model)
    T_camera_root = transform_from(random_rotation(rng), np.array([0.1, -0.1, 1.0]))
    poses = model.poses(T_camera_root, states)
    state_of = {joint.child: state for joint, state in zip(category.joints, states, strict=True)}
    truths = tuple(
        PartTruth(part.name, T, model.parts[k].extents_m, 1.0, state_of.get(k))
        for k, (part, T) in enumerate(zip(category.parts, poses, strict=True))
    )
    return truths, poses
