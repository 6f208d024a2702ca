"""The description that travels inside a bundle: one .onnx file with this JSON under its metadata key "page.bundle".

Versioned and closed: an unknown version, a missing field or one too many is refused, so that a bundle is either
understood whole or not used.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from page_runtime.bundle_fields import BundleError, closed, each_once, listed, whole, yes_or_no
from page_runtime.bundle_figures import PartFigures, figures_document, figures_from
from page_runtime.category import MAX_PARTS, Category
from page_runtime.category_document import CATEGORY_FIELDS, CATEGORY_MAY_SAY, category_document, category_from
from page_runtime.confidence import FEATURES, ConfidenceModel

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
            document = json.loads(text, object_pairs_hook=each_once)
        except (ValueError, RecursionError) as error:
            raise BundleError(f"bundle metadata: expected JSON, got {error}") from error
        if not isinstance(document, dict) or document.get("version") != METADATA_VERSION:
            version = document.get("version") if isinstance(document, dict) else None
            raise BundleError(f"bundle metadata: expected version {METADATA_VERSION}, got {version}; export it again")
        top = closed(document, "bundle", CATEGORY_FIELDS | _OWN_FIELDS, CATEGORY_MAY_SAY)
        category = category_from({name: value for name, value in top.items() if name not in _OWN_FIELDS})
        if top["preprocessing"] != PREPROCESSING:
            raise BundleError(
                "bundle metadata, preprocessing: expected what this runtime does to a frame "
                f"({json.dumps(PREPROCESSING)}), got {json.dumps(top['preprocessing'])[:400]}; export it again"
            )
        try:
            return BundleMetadata(
                category=category,
                num_points=whole(top, "num_points"),
                image_size=whole(top, "image_size"),
                voxel_m=float(top["voxel_m"]),
                opset=whole(top, "opset"),
                mirrored=yes_or_no(top, "mirrored"),
                provenance=dict(top["provenance"]),
                confidence=None if top["confidence"] is None else _confidence(top["confidence"]),
                figures=tuple(figures_from(one) for one in listed(top, "figures", MAX_FIGURES)),
            )
        except (TypeError, ValueError, OverflowError) as error:
            raise BundleError(f"bundle metadata: {error}") from error


_OWN_FIELDS = {
    "version", "num_points", "image_size", "voxel_m", "opset", "mirrored", "preprocessing", "provenance", "confidence",
    "figures",
}  # fmt: skip


def _confidence_document(model: ConfidenceModel) -> dict[str, Any]:
    return {"offset": model.offset, "weights": dict(zip(FEATURES, model.weights, strict=True))}


def _confidence(entry: Any) -> ConfidenceModel:
    given = closed(entry, "confidence", {"offset", "weights"})
    weights = closed(given["weights"], "confidence weights", set(FEATURES))
    return ConfidenceModel(tuple(float(weights[name]) for name in FEATURES), float(given["offset"]))
