"""The description that travels inside a bundle: one .onnx file with this JSON under its metadata key "page.bundle".

Versioned and closed: an unknown version, a missing field or one too many is refused, so that a bundle is either
understood whole or not used.
"""

from __future__ import annotations

import json
from collections.abc import Set
from dataclasses import asdict, dataclass, fields
from typing import Any

from page_runtime.bundle_figures import PartFigures, figures_document, figures_from
from page_runtime.category import MAX_PARTS, Category, Joint, JointGeometry, Part
from page_runtime.confidence import FEATURES, ConfidenceModel
from page_runtime.symmetry import Interchange, Mirror, Symmetry
from page_runtime.template import template_document, template_from

METADATA_KEY = "page.bundle"
METADATA_VERSION = 5
# What the runtime does to a frame before the network sees it (`sampling`, `neighbours`, `network.feeds`), in words: a
# bundle of a network trained on anything else is refused. Change it together with those modules.
PREPROCESSING = {
    "image": "RGB, float32 in [0, 1]: the square around the region, a tenth of its side wider on every side, black "
    "beyond the image, scaled",
    "points": "float32: depth readings within region_radius_m of the region's centre, camera axes, minus their mean, "
    "divided by region_radius_m",
    "order": "of the R2 sequence over the picture's pixels, repeated where there are fewer points than are asked for",
    "pixels": "float32: px of the scaled picture, integers at pixel centres",
}
MAX_POINTS, MAX_IMAGE_SIZE = 1 << 15, 1 << 11
MAX_FIGURES = 16 * MAX_PARTS
VOXELS_M = (5e-4, 0.1)


class BundleError(ValueError):
    """The file is not a bundle this version can run; the message says why."""


@dataclass(frozen=True, eq=False, slots=True)
class BundleMetadata:
    """What the runtime must know to feed the network and read its answer.

    num_points, image_size: N and S of its inputs. voxel_m: rho of the scorer. opset: of the graph. mirrored: whether
    the network was trained on mirror images too, and so may be asked about one (`mirror`).
    provenance: facts for people (commit, recipe, frames); the runtime reads none. confidence: None until the bundle is
    calibrated. figures: what it reached on test data, empty until measured.
    """

    category: Category
    num_points: int
    image_size: int
    voxel_m: float
    opset: int
    mirrored: bool
    provenance: dict[str, Any]
    confidence: ConfidenceModel | None = None
    figures: tuple[PartFigures, ...] = ()

    def __post_init__(self) -> None:
        if not (0 < self.num_points <= MAX_POINTS and 0 < self.image_size <= MAX_IMAGE_SIZE):
            raise ValueError(
                f"expected 1 to {MAX_POINTS} points and pictures of 1 to {MAX_IMAGE_SIZE} px, "
                f"got {self.num_points} and {self.image_size}"
            )
        if not VOXELS_M[0] <= self.voxel_m <= VOXELS_M[1]:
            raise ValueError(f"voxel_m: expected {VOXELS_M[0]} to {VOXELS_M[1]} m, got {self.voxel_m}")
        unknown = {one.part for one in self.figures} - {part.name for part in self.category.parts}
        if unknown:
            raise ValueError(f"figures: expected those of the category's parts, got {sorted(unknown)}")
        if not all(name.isprintable() for name in self.provenance):
            raise ValueError("provenance: expected printable names")
        if self.mirrored and not self.category.joints_mirror:
            raise ValueError(
                f"mirrored: expected false, as the joints of {self.category.name!r} are not their own mirror image "
                "(see Category.mirror)"
            )

    def to_json(self) -> str:
        """The JSON document; `from_json` gives the same metadata back."""
        document = {
            "version": METADATA_VERSION,
            **category_document(self.category),
            "num_points": self.num_points,
            "image_size": self.image_size,
            "voxel_m": self.voxel_m,
            "opset": self.opset,
            "mirrored": self.mirrored,
            "preprocessing": PREPROCESSING,
            "provenance": self.provenance,
            "confidence": None if self.confidence is None else _confidence_document(self.confidence),
            "figures": [figures_document(one) for one in self.figures],
        }
        return json.dumps(document, separators=(",", ":"))

    @staticmethod
    def from_json(text: str) -> BundleMetadata:
        """Parse and check; raises BundleError that names the field."""
        try:
            document = json.loads(text, object_pairs_hook=_each_once)
        except (ValueError, RecursionError) as error:
            raise BundleError(f"bundle metadata: expected JSON, got {error}") from error
        if not isinstance(document, dict) or document.get("version") != METADATA_VERSION:
            version = document.get("version") if isinstance(document, dict) else None
            raise BundleError(f"bundle metadata: expected version {METADATA_VERSION}, got {version}; export it again")
        top = _closed(document, "bundle", _CATEGORY_FIELDS | _OWN_FIELDS, _CATEGORY_MAY_SAY)
        category = category_from({name: value for name, value in top.items() if name not in _OWN_FIELDS})
        if top["preprocessing"] != PREPROCESSING:
            raise BundleError(
                "bundle metadata, preprocessing: expected what this runtime does to a frame "
                f"({json.dumps(PREPROCESSING)}), got {json.dumps(top['preprocessing'])[:400]}; export it again"
            )
        try:
            return BundleMetadata(
                category=category,
                num_points=_whole(top, "num_points"),
                image_size=_whole(top, "image_size"),
                voxel_m=float(top["voxel_m"]),
                opset=_whole(top, "opset"),
                mirrored=_yes_or_no(top, "mirrored"),
                provenance=dict(top["provenance"]),
                confidence=None if top["confidence"] is None else _confidence(top["confidence"]),
                figures=tuple(figures_from(one) for one in _listed(top, "figures", MAX_FIGURES)),
            )
        except (TypeError, ValueError, OverflowError) as error:
            raise BundleError(f"bundle metadata: {error}") from error


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
    top = _closed(document, "category", _CATEGORY_FIELDS, _CATEGORY_MAY_SAY)
    parts = tuple(_part(_closed(entry, "part", _PART_FIELDS)) for entry in _listed(top, "parts", MAX_PARTS))
    joints = tuple(_joint(_closed(entry, "joint", _JOINT_FIELDS)) for entry in _listed(top, "joints", MAX_PARTS - 1))
    try:
        return Category(
            name=str(top["category"]),
            parts=parts,
            joints=joints,
            num_voted=_whole(top, "num_voted"),
            region_radius_m=float(top["region_radius_m"]),
            mirror=None if top["mirror"] is None else _mirror(_closed(top["mirror"], "mirror", {"axis", "parts"})),
            interchange=None if top["interchange"] is None else _interchange(top["interchange"]),
            focused="focused" in top and _yes_or_no(top, "focused"),
        )
    except (TypeError, ValueError, OverflowError) as error:
        raise BundleError(f"bundle metadata: {error}") from error


def _mirror(entry: dict[str, Any]) -> Mirror:
    return Mirror(_whole(entry, "axis"), tuple(int(part) for part in entry["parts"]))


def _interchange(entry: Any) -> Interchange:
    closed = _closed(entry, "interchange", {"parts", "axis"})
    return Interchange(tuple(int(part) for part in closed["parts"]), _triple(closed, "axis"))


def _symmetry(entry: Any) -> Symmetry:
    closed = _closed(entry, "symmetry", {"axis", "fold"})
    return Symmetry(_triple(closed, "axis"), _whole(closed, "fold"))


def _triple(entry: dict[str, Any], name: str) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in entry[name])
    return x, y, z


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; two readers would take different ones of a field that is given twice."""
    entry = dict(pairs)
    if len(entry) != len(pairs):
        raise ValueError("a field that is given twice")
    return entry


_CATEGORY_FIELDS = {"category", "num_voted", "region_radius_m", "parts", "joints", "mirror", "interchange"}
_CATEGORY_MAY_SAY = {"focused"}
_OWN_FIELDS = {
    "version", "num_points", "image_size", "voxel_m", "opset", "mirrored", "preprocessing", "provenance", "confidence",
    "figures",
}  # fmt: skip
_PART_FIELDS = {"name", "frame", "keypoints_unit", "extents_unit", "diagonal_range_m", "template", "symmetry"}
_JOINT_FIELDS = {"name", "parent", "child", "kind", "axis", "limits", "geometry"}
_GEOMETRY_FIELDS = {f.name for f in fields(JointGeometry)}


def _closed(entry: Any, what: str, expected: set[str], allowed: Set[str] = frozenset()) -> dict[str, Any]:
    if not isinstance(entry, dict):
        raise BundleError(f"bundle metadata: expected each {what} to be an object, got {type(entry).__name__}")
    missing, extra = expected - entry.keys(), entry.keys() - expected - allowed
    if missing or extra:
        raise BundleError(f"bundle metadata, {what}: missing {sorted(missing)}, not understood {sorted(extra)}")
    return entry


def _listed(entry: dict[str, Any], name: str, most: int) -> list[Any]:
    if not isinstance(entry[name], list):
        raise BundleError(f"bundle metadata, {name}: expected a list, got {type(entry[name]).__name__}")
    if len(entry[name]) > most:
        raise BundleError(f"bundle metadata, {name}: expected at most {most}, got {len(entry[name])}")
    return entry[name]


def _whole(entry: dict[str, Any], name: str) -> int:
    if not isinstance(entry[name], int) or isinstance(entry[name], bool):
        raise ValueError(f"{name}: expected a whole number, got {entry[name]!r}")
    return entry[name]


def _yes_or_no(entry: dict[str, Any], name: str) -> bool:
    if not isinstance(entry[name], bool):
        raise ValueError(f"{name}: expected true or false, got {entry[name]!r}")
    return entry[name]


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
            parent=_whole(entry, "parent"),
            child=_whole(entry, "child"),
            kind=entry["kind"],
            axis=_triple(entry, "axis"),
            limits=(low, high),
            geometry=None if entry["geometry"] is None else _geometry(entry["geometry"]),
        )
    except (TypeError, ValueError, OverflowError) as error:
        raise BundleError(f"bundle metadata, joint {entry['name']!r}: {error}") from error


def _geometry(entry: Any) -> JointGeometry:
    closed = _closed(entry, "joint geometry", _GEOMETRY_FIELDS)
    return JointGeometry(
        pivot_parent=_triple(closed, "pivot_parent"),
        pivot_child=_triple(closed, "pivot_child"),
        sigma_parent=_triple(closed, "sigma_parent"),
        sigma_child=_triple(closed, "sigma_child"),
        log_size_ratio=float(closed["log_size_ratio"]),
        log_size_sigma=float(closed["log_size_sigma"]),
    )


def _confidence_document(model: ConfidenceModel) -> dict[str, Any]:
    return {"offset": model.offset, "weights": dict(zip(FEATURES, model.weights, strict=True))}


def _confidence(entry: Any) -> ConfidenceModel:
    closed = _closed(entry, "confidence", {"offset", "weights"})
    weights = _closed(closed["weights"], "confidence weights", set(FEATURES))
    return ConfidenceModel(tuple(float(weights[name]) for name in FEATURES), float(closed["offset"]))
