"""The toy box as an annotated data set in the layouts of `page_training.datasets`, right or with a known fault."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import toy
from page_runtime.geometry import Array, invert, transform_from
from page_runtime.image_files import write_color, write_depth
from page_training.datasets.layout import POLYGONS, Layout, signed_permutation


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


def rest_poses() -> tuple[Array, Array, Array]:
    """T_rest_part (4,4) of base and closed lid in a rest frame off both, and a point of the hinge (3,) in it."""
    origin = np.array([0.05, -0.02, 0.03])
    base, lid = toy.EXTENTS_M
    hinge_base, hinge_lid = np.array([0, base[1] / 2, base[2] / 2]), np.array([0, lid[1] / 2, -lid[2] / 2])
    T_rest_base = transform_from(np.eye(3), origin)
    return T_rest_base, transform_from(np.eye(3), origin + hinge_base - hinge_lid), origin + hinge_base


def write_annotated(root: Path, layout: Layout, *, frames: int = 2, fault: Fault | None = None) -> Path:
    """A folder of `frames` equal pictures; the path that the layout's files are relative to."""
    fault = fault or Fault()
    path = root / "box"
    recorded, masks = toy.toy_frame()
    frame, instance = recorded.frame, recorded.instances[0]
    assert instance.region is not None
    *T_rest, hinge_rest = rest_poses()
    map_of_file = signed_permutation(list(fault.joint_order or layout.joint_order))
    corners = [
        [(T[:3, 3] + sign * extents / 2) / fault.scale for sign in (-1, 1)]
        for T, extents in zip(T_rest, toy.EXTENTS_M, strict=True)
    ]
    whole = [np.min([low for low, _ in corners], axis=0), np.max([high for _, high in corners], axis=0)]
    model = {
        "id": 3,
        "category_name": "box",
        "corner_pts": [[[low.tolist()], [high.tolist()]] for low, high in [whole, *corners]],
        "joint_types": ["revolute"],
        "joint_parents": [layout.first_link_of_joints],
        "joint_children": [layout.first_link_of_joints + 1],
        "joint_xyz": [(map_of_file.T @ (hinge_rest / fault.scale)).tolist()],
        "joint_rpy": [(map_of_file.T @ np.array([-1.0, 0.0, 0.0])).tolist()],
    }
    _write(path / layout.models.format(folder=path.name), {"urdf_metas": [model]})
    K = frame.camera.K * np.array([[fault.focal, 1, 1], [1, fault.focal, 1], [1, 1, 1]])
    size = {"width": frame.camera.width, "height": frame.camera.height}
    _write(path / layout.intrinsics, {**size, "intrinsic_matrix": K.T.ravel().tolist()})
    links = []
    for k, (T, mask) in enumerate(zip(T_rest, masks, strict=True)):
        matrix = toy.part_poses()[k] @ invert(T)
        matrix[:3, :3] *= fault.scale
        if fault.sheared:
            matrix[:3, 0] *= 1.2
        contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        links.append({
            "link_category_id": k + layout.first_link + fault.link_shift,
            "transformation": (matrix.T if fault.transposed else matrix).tolist(),
            "state": 0.0,
            **({"segmentation": [c.ravel().tolist() for c in contours]} if layout.masks == POLYGONS else {}),
        })  # fmt: skip
    x, y, w, h = instance.region
    annotation = {"instances": [{"urdf_id": 3, "bbox": [x, y, x + w, y + h], "links": links}]}
    # Pictures of part indices have no value for the background, which has no depth there.
    depth_m = frame.depth_m if layout.masks == POLYGONS else np.where(masks[0] | masks[1], frame.depth_m, np.float32(0))
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
            labels = np.where(masks[1], 1, 0).astype(np.uint8)
            cv2.imwrite(str(path / layout.masks / f"{name}.png"), np.repeat(labels[..., None], 3, axis=2))
    return path


def _write(file: Path, document: object) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(document))
