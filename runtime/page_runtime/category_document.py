"""A category as JSON, in bundles, checkpoints and the folders of the user's own categories, and back."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Any

from page_runtime.bundle_fields import BundleError, closed, listed, triple, whole, yes_or_no
from page_runtime.category import MAX_PARTS, Category, Joint, JointGeometry, Part
from page_runtime.symmetry import Interchange, Mirror, Symmetry
from page_runtime.template import template_document, template_from

CATEGORY_FIELDS = {"category", "num_voted", "region_radius_m", "parts", "joints", "mirror", "interchange"}
CATEGORY_MAY_SAY = {"focused"}
_PART_FIELDS = {"name", "frame", "keypoints_unit", "extents_unit", "diagonal_range_m", "template", "symmetry"}
_JOINT_FIELDS = {"name", "parent", "child", "kind", "axis", "limits", "geometry"}
_GEOMETRY_FIELDS = {f.name for f in fields(JointGeometry)}


def category_document(category: Category) -> dict[str, Any]:
    """A category in JSON's types; `category_from` gives it back."""
    return {
        "category": category.name,
        "num_voted": category.num_voted,
        "region_radius_m": category.region_radius_m,
        "parts": [
            {
                "name": part.name,
                "frame": part.frame,
                "keypoints_unit": part.keypoints_unit.tolist(),
                "extents_unit": part.extents_unit.tolist(),
                "diagonal_range_m": list(part.diagonal_range_m),
                "template": None if part.template is None else template_document(part.template),
                "symmetry": None if part.symmetry is None else asdict(part.symmetry),
            }
            for part in category.parts
        ],
        "mirror": None if category.mirror is None else asdict(category.mirror),
        "interchange": None if category.interchange is None else asdict(category.interchange),
        "joints": [_joint_document(joint) for joint in category.joints],
        # Said of those alone that are: others read as they always have.
        **({"focused": True} if category.focused else {}),
    }


def _joint_document(joint: Joint) -> dict[str, Any]:
    document = {f.name: getattr(joint, f.name) for f in fields(joint)}
    if joint.geometry is not None:
        document["geometry"] = {f.name: getattr(joint.geometry, f.name) for f in fields(joint.geometry)}
    return document


def category_from(document: dict[str, Any]) -> Category:
    """The category of `category_document`; BundleError names the field that is wrong, missing or one too many."""
    top = closed(document, "category", CATEGORY_FIELDS, CATEGORY_MAY_SAY)
    parts = tuple(_part(closed(entry, "part", _PART_FIELDS)) for entry in listed(top, "parts", MAX_PARTS))
    joints = tuple(_joint(closed(entry, "joint", _JOINT_FIELDS)) for entry in listed(top, "joints", MAX_PARTS - 1))
    try:
        return Category(
            name=str(top["category"]),
            parts=parts,
            joints=joints,
            num_voted=whole(top, "num_voted"),
            region_radius_m=float(top["region_radius_m"]),
            mirror=None if top["mirror"] is None else _mirror(closed(top["mirror"], "mirror", {"axis", "parts"})),
            interchange=None if top["interchange"] is None else _interchange(top["interchange"]),
            focused="focused" in top and yes_or_no(top, "focused"),
        )
    except (TypeError, ValueError, OverflowError) as error:
        raise BundleError(f"bundle metadata: {error}") from error


def _mirror(entry: dict[str, Any]) -> Mirror:
    return Mirror(whole(entry, "axis"), tuple(int(part) for part in entry["parts"]))


def _interchange(entry: Any) -> Interchange:
    given = closed(entry, "interchange", {"parts", "axis"})
    return Interchange(tuple(int(part) for part in given["parts"]), triple(given, "axis"))


def _symmetry(entry: Any) -> Symmetry:
    given = closed(entry, "symmetry", {"axis", "fold"})
    return Symmetry(triple(given, "axis"), whole(given, "fold"))


def _part(entry: dict[str, Any]) -> Part:
    try:
        low, high = entry["diagonal_range_m"]
        return Part(
            name=str(entry["name"]),
            frame=str(entry["frame"]),
            keypoints_unit=entry["keypoints_unit"],
            extents_unit=entry["extents_unit"],
            diagonal_range_m=(float(low), float(high)),
            template=None if entry["template"] is None else template_from(entry["template"]),
            symmetry=None if entry["symmetry"] is None else _symmetry(entry["symmetry"]),
        )
    except (TypeError, ValueError, OverflowError) as error:
        raise BundleError(f"bundle metadata, part {entry['name']!r}: {error}") from error


def _joint(entry: dict[str, Any]) -> Joint:
    try:
        if entry["kind"] not in ("free", "revolute", "prismatic"):
            raise ValueError(f"kind: expected free, revolute or prismatic, got {entry['kind']!r}")
        low, high = (float(value) for value in entry["limits"])
        return Joint(
            name=str(entry["name"]),
            parent=whole(entry, "parent"),
            child=whole(entry, "child"),
            kind=entry["kind"],
            axis=triple(entry, "axis"),
            limits=(low, high),
            geometry=None if entry["geometry"] is None else _geometry(entry["geometry"]),
        )
    except (TypeError, ValueError, OverflowError) as error:
        raise BundleError(f"bundle metadata, joint {entry['name']!r}: {error}") from error


def _geometry(entry: Any) -> JointGeometry:
    given = closed(entry, "joint geometry", _GEOMETRY_FIELDS)
    return JointGeometry(
        pivot_parent=triple(given, "pivot_parent"),
        pivot_child=triple(given, "pivot_child"),
        sigma_parent=triple(given, "sigma_parent"),
        sigma_child=triple(given, "sigma_child"),
        log_size_ratio=float(given["log_size_ratio"]),
        log_size_sigma=float(given["log_size_sigma"]),
    )
