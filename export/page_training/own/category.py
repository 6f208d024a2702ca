"""From models of the user's own to a category: what the runtime must know of it, and how scenes of it are made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from page_runtime.category import Category, Joint, Part
from page_runtime.geometry import Array, apply, invert, transform_from
from page_runtime.symmetry import Symmetry
from page_training.keypoints import NUM_VOTED, off_surface_keypoints
from page_training.own.model import OwnModel, Surface, require_different
from page_training.records import SPLITS
from page_training.scenes.articulated import ArticulatedObject, JointModel, PartModel, States, seen_from
from page_training.scenes.fittings import finish
from page_training.scenes.materials import Material, plain, random_color, scanned, vary
from page_training.scenes.meshes import Mesh
from page_training.scenes.resting import Rest, held_rest, upright_rest
from page_training.scenes.statistics import joint_geometry, part_statistics
from page_training.scenes.textures import Generator
from page_training.templates import INSTANCES, with_templates
from page_training.thinness import are_thin

Resting = Literal["stand", "any"]
# Of a model's size, either way: what a tape measure and a scale error of depth leave open.
SCALE_SIGMA = 0.02
_MOST_SCALE = 3.0
_MEASURED = 48
_DRAWN_A_MODEL = 4
_STATE_TRIES = 30
_FEW = 60
_INSIDE = 0.6
_FRAME = "origin: centre of the part's box, all joints at 0; axes: those of the model's root, all joints at 0 too"


@dataclass(frozen=True, eq=False, slots=True)
class OwnCategory:
    """category: for the runtime. models: its objects, those to learn from first. rest: "stand" for what stands on its
    root's -z side, "any" for what lies about or is held. scale_sigma: by which sizes vary. splits: of each model, where
    it is used.
    """

    category: Category
    models: tuple[OwnModel, ...]
    rest: Resting
    scale_sigma: float
    splits: tuple[str, ...]

    def sample_object(self, rng: Generator, split: str = "train") -> ArticulatedObject:
        """One of the models for a split, a little larger or smaller, in its own colours or others; of those to learn
        from where there are none for it."""
        models = self.models_of(split) or self.models_of("train")
        model = models[int(rng.integers(len(models)))]
        scale = float(np.exp(self.scale_sigma * np.clip(rng.normal(), -_MOST_SCALE, _MOST_SCALE)))
        materials = _materials(rng, model.parts[0].surface.palette)
        parts = []
        for part in model.parts:
            vertices = (scale * (part.surface.vertices - _origin(part.surface))).astype(np.float32)
            mesh = Mesh(vertices, vertices, part.surface.triangles, part.surface.color, materials)
            parts.append(PartModel(mesh, np.ptp(vertices.astype(float), axis=0)))
        joints = []
        for joint, own in zip(self.category.joints, model.joints, strict=True):
            pivots = [scale * (np.array(own.point) - _origin(model.parts[k].surface)) for k in (own.parent, own.child)]
            size = scale if own.kind == "prismatic" else 1.0
            joints.append(JointModel(joint, pivots[0], pivots[1], (size * own.limits[0], size * own.limits[1])))
        return ArticulatedObject(tuple(parts), tuple(joints))

    def models_of(self, split: str) -> tuple[OwnModel, ...]:
        """The models that were given for a split."""
        return tuple(model for model, own in zip(self.models, self.splits, strict=True) if own == split)

    def sample_states(self, rng: Generator, model: ArticulatedObject) -> States:
        """Anything the joints allow, now and then at a limit; as far as tries go no part goes deep into another, nor
        below where the object stands."""
        states: States = ()
        for _ in range(_STATE_TRIES):
            drawn = []
            for joint in model.joints:
                low, high = joint.limits
                share = float(rng.uniform()) if rng.random() < 0.85 else float(rng.integers(2))
                drawn.append(low + share * (high - low))
            states = tuple(drawn)
            poses = model.poses(np.eye(4), states)
            if (self.rest == "any" or _stands(model, poses)) and _is_clear(model, poses):
                break
        return states

    def sample_rest(self, rng: Generator) -> Rest:
        standing = 0.92 if self.rest == "stand" else 0.15
        return upright_rest(rng) if rng.random() < standing else held_rest(rng)

    def distance_m(self, model: ArticulatedObject) -> tuple[float, float]:
        return seen_from(model, 1.0, 3.8)

    def on_table(self, model: ArticulatedObject) -> float:
        return 0.85 if model.diagonal_m < 1.0 else 0.4


def T_part_link(model: OwnModel) -> dict[str, dict[str, Array]]:
    """Of each part, (4,4) of every link of the file that belongs to it: T_camera_link = T_camera_part @ T_part_link."""
    return {
        part.name: {link: transform_from(np.eye(3), -_origin(part.surface)) @ T for link, T in part.links.items()}
        for part in model.parts
    }


def _origin(surface: Surface) -> Array:
    """(3,) the middle of a part's box in the model's frame."""
    vertices = surface.vertices.astype(float)
    return (vertices.min(axis=0) + vertices.max(axis=0)) / 2


def _stands(model: ArticulatedObject, poses: Sequence[Array]) -> bool:
    floor = float(model.parts[0].mesh.vertices[:, 2].min())
    slack = 0.01 * float(np.linalg.norm(model.parts[0].extents_m))
    lowest = min(
        float((part.mesh.vertices @ T[2, :3].astype(np.float32)).min() + T[2, 3])
        for part, T in zip(model.parts, poses, strict=True)
    )
    return lowest >= floor - slack


def _is_clear(model: ArticulatedObject, poses: Sequence[Array]) -> bool:
    """Whether no vertex of a part, of a few, lies well inside the box of another that no joint ties to it."""
    tied = {frozenset((joint.joint.parent, joint.joint.child)) for joint in model.joints}
    for k, (part, T) in enumerate(zip(model.parts, poses, strict=True)):
        few = part.mesh.vertices[:: max(1, len(part.mesh.vertices) // _FEW)].astype(float)
        for other, T_other in enumerate(poses):
            if other == k or frozenset((k, other)) in tied:
                continue
            inside = np.abs(apply(invert(T_other) @ T, few)) < _INSIDE * model.parts[other].extents_m / 2
            if inside.all(axis=1).any():
                return False
    return True


def _materials(rng: Generator, palette: Array) -> tuple[Material, ...]:
    """For each colour of a model: itself in other light, another colour, or one surface for all."""
    draw = rng.random()
    if draw < 0.55:
        amount = float(rng.choice([0.03, 0.12]))
        made = [plain(rng, vary(rng, np.asarray(color), amount)) for color in palette]
    elif draw < 0.85:
        made = [plain(rng, random_color(rng)) for _ in palette]
    else:
        made = [finish(rng)] * len(palette)
    if rng.random() < 0.15:
        made = [scanned(rng, material) for material in made]
    return tuple(made)


def own_category(
    name: str,
    models: Sequence[OwnModel],
    *,
    rest: Resting = "stand",
    scale_sigma: float = SCALE_SIGMA,
    symmetries: Sequence[tuple[str, Symmetry]] = (),
    unseen: Mapping[str, Sequence[OwnModel]] | None = None,
) -> OwnCategory:
    """The category of models that have the same parts and joints.

    unseen: models for the split "validation" or "test" alone; without any, scenes of that split show the models learned
    from. They set the joints' limits with the others, and nothing else of what the runtime knows. symmetries: of parts,
    by name. A mirror shows no object of such a category. ValueError names what differs between the models, and a name
    that cannot be a folder's.
    """
    if not name.isidentifier():
        raise ValueError(f"name: expected letters, digits and underscores, got {name!r}")
    if rest not in get_args(Resting):
        raise ValueError(f"rest: expected one of {', '.join(get_args(Resting))}, got {rest!r}")
    if not 0.0 <= scale_sigma <= 0.2:
        raise ValueError(f"scale_sigma: expected 0 to 0.2, got {scale_sigma:g}")
    unseen = unseen or {}
    if not set(unseen) <= set(SPLITS[1:]):
        raise ValueError(f"unseen: expected models for {' and '.join(SPLITS[1:])}, got {', '.join(unseen)}")
    everything = [*models, *(model for own in unseen.values() for model in own)]
    splits = (SPLITS[0],) * len(models) + tuple(split for split, own in unseen.items() for _ in own)
    require_different([model.source for model in everything], "models", name)
    first = models[0]
    for model in everything[1:]:
        _require_alike(first, model)
    symmetric = dict(symmetries)
    unknown = sorted(set(symmetric) - {part.name for part in first.parts})
    if unknown:
        known = ", ".join(part.name for part in first.parts)
        raise ValueError(f"symmetry: expected parts of {known}, got {', '.join(unknown)}")
    growth = float(np.exp(scale_sigma * _MOST_SCALE))
    joints = tuple(
        Joint(joint.name, joint.parent, joint.child, joint.kind, joint.axis, _widest(everything, k, growth))
        for k, joint in enumerate(first.joints)
    )
    parts = tuple(
        Part(part.name, _FRAME, off_surface_keypoints(), np.ones(3), (0.1, 1.0), symmetry=symmetric.get(part.name))
        for part in first.parts
    )
    rough = Category(name, parts, joints, NUM_VOTED, 1.0, mirror=None)
    own = OwnCategory(rough, tuple(everything), rest, scale_sigma, splits)
    own = replace(own, category=_measured(own))
    # Of one model all objects are alike but for their size, which a template does not have.
    instances = 1 if len(models) == 1 else min(INSTANCES, _DRAWN_A_MODEL * len(models))
    return replace(own, category=with_templates(own.category, own.sample_object, instances))


def _require_alike(first: OwnModel, other: OwnModel) -> None:
    for what, one, two in (
        ("parts", [part.name for part in first.parts], [part.name for part in other.parts]),
        ("joints", [(j.name, j.parent, j.child, j.kind) for j in first.joints],
         [(j.name, j.parent, j.child, j.kind) for j in other.joints]),
    ):  # fmt: skip
        if one != two:
            raise ValueError(f"{other.source}: expected the {what} of {first.source}, {one}, got {two}")
    for one, two in zip(first.joints, other.joints, strict=True):
        if float(np.dot(one.axis, two.axis)) < 1.0 - 1e-4:
            raise ValueError(
                f"{other.source}: joint {two.name!r}: expected the axis of {first.source}, {one.axis}, got {two.axis}"
            )


def _widest(models: Sequence[OwnModel], joint: int, growth: float) -> tuple[float, float]:
    """The range that holds every model's, of whatever size it is."""
    own = [model.joints[joint] for model in models]
    low, high = min(one.limits[0] for one in own), max(one.limits[1] for one in own)
    if own[0].kind == "revolute":
        return low, high
    return min(low, low * growth), max(high, high * growth)


def _measured(own: OwnCategory) -> Category:
    """The category with the sizes, joints and reach of its objects."""
    rng = np.random.default_rng(0)
    objects = [own.sample_object(rng) for _ in range(_MEASURED)]
    parts = []
    for k, part in enumerate(own.category.parts):
        found = part_statistics(objects, k)
        parts.append(replace(part, extents_unit=found.extents_unit, diagonal_range_m=found.diagonal_range_m))
    joints = tuple(replace(joint, geometry=joint_geometry(objects, k)) for k, joint in enumerate(own.category.joints))
    moved = [(model, own.sample_states(rng, model)) for model in objects]
    reach = max(_reach(model, states) for model, states in moved)
    return replace(
        own.category,
        parts=tuple(parts),
        joints=joints,
        region_radius_m=1.15 * reach,
        focused=are_thin(moved, rng),
    )


def _reach(model: ArticulatedObject, states: States) -> float:
    """Half of what the object measures across in these states, m."""
    ends = []
    for part, T in zip(model.parts, model.poses(np.eye(4), states), strict=True):
        around = np.abs(T[:3, :3]) @ (part.extents_m / 2)
        ends += [T[:3, 3] - around, T[:3, 3] + around]
    return float(np.linalg.norm(np.ptp(ends, axis=0))) / 2
