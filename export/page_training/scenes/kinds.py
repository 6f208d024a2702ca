"""What there are scenes of: for each category how objects are made, how they rest, and from how far they are seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from page_training.categories import known_categories, own_folder
from page_training.scenes import arm, box, cutter, dishwasher, drawer, eyeglasses, laptop, scissors, stapler
from page_training.scenes.articulated import ArticulatedObject, States
from page_training.scenes.resting import Rest, upright_rest
from page_training.scenes.textures import Generator


@dataclass(frozen=True, eq=False, slots=True)
class SceneCategory:
    """sample_states: of the object's joints. distance_m: nearest and farthest camera for an object. rest: how it rests.
    on_table: how often an object stands on a table, else on the floor.
    camera_tries: viewpoints tried until the object is seen well; last_tries: then, without occluders, until it is seen
    at all. hard_views: share kept of those that hide parts.
    """

    sample_object: Callable[[Generator], ArticulatedObject]
    sample_states: Callable[[Generator, ArticulatedObject], States]
    distance_m: Callable[[ArticulatedObject], tuple[float, float]]
    rest: Callable[[Generator], Rest] = upright_rest
    on_table: Callable[[ArticulatedObject], float] = lambda _: 0.85
    camera_tries: int = 12
    last_tries: int = 8
    hard_views: float = 0.1


CATEGORIES: dict[str, SceneCategory] = {
    "arm": SceneCategory(arm.sample_object, arm.sample_states, arm.distance_m, arm.rest, on_table=arm.on_table),
    "box": SceneCategory(
        box.sample_object, box.sample_states, box.distance_m, camera_tries=5, last_tries=1, hard_views=0.25
    ),
    "cutter": SceneCategory(cutter.sample_object, cutter.sample_states, cutter.distance_m, cutter.rest),
    "dishwasher": SceneCategory(
        dishwasher.sample_object, dishwasher.sample_states, dishwasher.distance_m, on_table=dishwasher.on_table
    ),
    "drawer": SceneCategory(drawer.sample_object, drawer.sample_states, drawer.distance_m, on_table=drawer.on_table),
    "eyeglasses": SceneCategory(
        eyeglasses.sample_object, eyeglasses.sample_states, eyeglasses.distance_m, eyeglasses.rest
    ),
    "laptop": SceneCategory(
        laptop.sample_object, laptop.sample_states, laptop.distance_m, camera_tries=5, last_tries=1, hard_views=0.25
    ),
    "scissors": SceneCategory(scissors.sample_object, scissors.sample_states, scissors.distance_m, scissors.rest),
    "stapler": SceneCategory(stapler.sample_object, stapler.sample_states, stapler.distance_m, stapler.rest),
}


def scene_category(name: str, split: str = "train") -> SceneCategory:
    """How scenes of a category are made for a split; a ValueError that lists those there are.

    Built-in categories make every object anew, so that none is in two splits; those of the user's own have the objects
    that `page-train from-urdf` was given for it.
    """
    if name in CATEGORIES:
        return CATEGORIES[name]
    if name not in known_categories():
        raise ValueError(f"category: expected one of {known_categories()}, got {name!r}")
    from page_training.own.files import read_own

    own = read_own(own_folder(name))
    sample_object = partial(own.sample_object, split=split)
    return SceneCategory(sample_object, own.sample_states, own.distance_m, own.sample_rest, on_table=own.on_table)
