"""An object of any category as an annotated data set in the layouts of `page_training.datasets`, right or faulty."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from category_objects import pivots, posed_object, seen_object
from page_runtime.category import Category
from page_runtime.geometry import Array, apply, invert, transform_from
from page_runtime.image_files import write_color, write_depth
from page_training.categories import CATEGORIES
from page_training.datasets.layout import POLYGONS, Layout, layout_names, read_layout
from page_training.datasets.part_frames import ObjectFrames, signed_permutation

# Every category of every layout that comes with the package.
DESCRIBED = [
    (name, one.category)
    for name in layout_names()
    if isinstance(layout := read_layout(name), Layout)
    for one in layout.objects
]


@dataclass(frozen=True, slots=True)
class Fault:
    """What the files say that the layout does not. scale: the matrices carry; link_shift: of link_category_id;
    joint_order: of the joints; unit: of the depth pictures over the layout's; focal: K over the true one; sheared: the
    matrices are no similarities; transposed: the matrices are stored so."""

    scale: float = 1.0
    link_shift: int = 0
    joint_order: tuple[str, ...] | None = None
    unit: float = 1.0
    focal: float = 1.0
    sheared: bool = False
    transposed: bool = False


def annotated_layout(name: str) -> Layout:
    """A layout of that form, none of BOP."""
    layout = read_layout(name)
    assert isinstance(layout, Layout)
    return layout


def spelled(layout: Layout) -> dict[str, str]:
    """Each field as TOML has it."""
    objects = "[" + ", ".join(
        f"{{named = {json.dumps(one.named)}, category = {json.dumps(one.category)}, parts = ["
        + ", ".join(f"{{part = {json.dumps(p.part)}, axes = {json.dumps(list(p.axes))}}}" for p in one.parts) + "]}"
        for one in layout.objects
    ) + "]"  # fmt: skip
    return {name: objects if name == "objects" else json.dumps(getattr(layout, name)) for name in Layout.__slots__}


def written_layout(folder: Path, layout: Layout) -> Path:
    """Its file."""
    file = folder / "mine.toml"
    file.write_text("\n".join(f"{name} = {value}" for name, value in spelled(layout).items()))
    return file


def rest_poses(frames: ObjectFrames, category: Category, extents: list[Array]) -> tuple[list[Array], list[Array]]:
    """T_rest_part (4,4) of each part at state 0 in a rest frame off all of them, in the axes of `frames`, and a point
    of each joint (3,) in it."""
    turns = {part.part: part.R_rest_part for part in frames.parts}
    poses = {0: transform_from(turns[category.parts[0].name], np.array([0.05, -0.02, 0.03]))}
    points = []
    for joint in category.joints:
        at_parent, at_child = pivots(joint, extents)
        turn = turns[category.parts[joint.child].name]
        points.append(apply(poses[joint.parent], at_parent))
        poses[joint.child] = transform_from(turn, points[-1] - turn @ at_child)
    return [poses[k] for k in range(len(category.parts))], points


def write_annotated(
    root: Path, layout: Layout, *, category: str = "box", frames: int = 2, fault: Fault | None = None
) -> Path:
    """A folder of `frames` equal pictures of an object; the path that the layout's files are relative to."""
    fault = fault or Fault()
    path = root / category
    own, known = next(one for one in layout.objects if one.category == category), CATEGORIES[category]
    truths = posed_object(known)
    recorded, masks = seen_object(truths)
    frame, instance = recorded.frame, recorded.instances[0]
    assert instance.region is not None
    order = [[part.name for part in known.parts].index(part.part) for part in own.parts]
    number = {k: n for n, k in enumerate(order)}
    T_rest, points_rest = rest_poses(own, known, [truth.extents_m for truth in truths])
    map_of_file = signed_permutation(list(fault.joint_order or layout.joint_order))
    halves = [np.abs(T_rest[k][:3, :3]) @ truths[k].extents_m / 2 for k in order]
    corners = [
        [(T_rest[k][:3, 3] + sign * half) / fault.scale for sign in (-1, 1)]
        for k, half in zip(order, halves, strict=True)
    ]
    whole = [np.min([low for low, _ in corners], axis=0), np.max([high for _, high in corners], axis=0)]
    axes_rest = [T_rest[joint.parent][:3, :3] @ np.array(joint.axis) for joint in known.joints]
    model = {
        "id": 3,
        "category_name": own.named,
        "corner_pts": [[[low.tolist()], [high.tolist()]] for low, high in [whole, *corners]],
        "joint_types": [joint.kind for joint in known.joints],
        "joint_parents": [layout.first_link_of_joints + number[joint.parent] for joint in known.joints],
        "joint_children": [layout.first_link_of_joints + number[joint.child] for joint in known.joints],
        "joint_xyz": [(map_of_file.T @ (point / fault.scale)).tolist() for point in points_rest],
        "joint_rpy": [(map_of_file.T @ axis).tolist() for axis in axes_rest],
    }
    _write(path / layout.models.format(folder=path.name), {"urdf_metas": [model]})
    K = frame.camera.K * np.array([[fault.focal, 1, 1], [1, fault.focal, 1], [1, 1, 1]])
    size = {"width": frame.camera.width, "height": frame.camera.height}
    _write(path / layout.intrinsics, {**size, "intrinsic_matrix": K.T.ravel().tolist()})
    links = []
    for n, k in enumerate(order):
        matrix = truths[k].T_camera_part @ invert(T_rest[k])
        matrix[:3, :3] *= fault.scale
        if fault.sheared:
            matrix[:3, 0] *= 1.2
        contours, _ = cv2.findContours(masks[k].astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        links.append({
            "link_category_id": n + layout.first_link + fault.link_shift,
            "transformation": (matrix.T if fault.transposed else matrix).tolist(),
            "state": 0.0,
            **({"segmentation": [c.ravel().tolist() for c in contours]} if layout.masks == POLYGONS else {}),
        })  # fmt: skip
    x, y, w, h = instance.region
    annotation = {"instances": [{"urdf_id": 3, "bbox": [x, y, x + w, y + h], "links": links}]}
    # Pictures of part indices have no value for the background, which has no depth there.
    any_part = np.any(masks, axis=0)
    depth_m = frame.depth_m if layout.masks == POLYGONS else np.where(any_part, frame.depth_m, np.float32(0))
    for i in range(frames):
        name = f"scene/{i:06d}"
        _write(path / layout.annotations / f"{name}.json", annotation)
        for folder in (layout.color, layout.depth):
            (path / folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_color(path / layout.color / f"{name}.png", frame.color)
        unit_m = layout.metres_per_unit * fault.unit
        write_depth(path / layout.depth / f"{name}.png", depth_m, metres_per_unit=unit_m)
        if layout.masks != POLYGONS:
            (path / layout.masks / name).parent.mkdir(parents=True, exist_ok=True)
            labels = np.sum([n * masks[k] for n, k in enumerate(order)], axis=0).astype(np.uint8)
            cv2.imwrite(str(path / layout.masks / f"{name}.png"), np.repeat(labels[..., None], 3, axis=2))
    return path


def _write(file: Path, document: object) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(document))
