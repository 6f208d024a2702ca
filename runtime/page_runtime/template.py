"""The surface of a category's part, as far as its instances share one."""

from __future__ import annotations

import base64
import binascii
from dataclasses import dataclass
from typing import Any

import numpy as np

from page_runtime.geometry import Array
from page_runtime.similarity import FloatArray

# In a bundle: half floats are 0.1 mm of a 0.4 m part, a tenth of what a depth camera tells.
_STORED = np.dtype("<f2")
_FIELDS = frozenset({"points_unit", "normals_unit", "extents_unit"})


@dataclass(frozen=True, eq=False, slots=True)
class Template:
    """Samples of a part's surface in its canonical frame, in units of its diagonal.

    points_unit: (M,3). normals_unit: (M,3), outward, unit length. extents_unit: (3,) positive, the full sizes of the
    box about the origin that the samples are of. M may be 0: a template that fits nothing.
    """

    points_unit: FloatArray
    normals_unit: FloatArray
    extents_unit: FloatArray

    def __post_init__(self) -> None:
        points = np.asarray(self.points_unit, dtype=np.float64)
        normals = np.asarray(self.normals_unit, dtype=np.float64)
        extents = np.asarray(self.extents_unit, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise ValueError(f"Template.points_unit: expected finite (M,3), got {points.shape}; one sample a row")
        if normals.shape != points.shape or not np.isfinite(normals).all():
            raise ValueError(f"Template.normals_unit: expected finite {points.shape}, got {normals.shape}; one a point")
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        if len(length) and (length.min() < 0.5 or length.max() > 2.0):
            raise ValueError(
                f"Template.normals_unit: expected unit vectors, got lengths of {length.min():.3g} to "
                f"{length.max():.3g}; normalise them first"
            )
        if extents.shape != (3,) or not np.isfinite(extents).all() or not (extents > 0).all():
            raise ValueError(
                f"Template.extents_unit: expected three positive numbers, got {extents.tolist()}; "
                "give a plate its thickness"
            )
        object.__setattr__(self, "points_unit", points)
        object.__setattr__(self, "normals_unit", normals / length)
        object.__setattr__(self, "extents_unit", extents)

    def stretched(self, extents_unit: Array) -> Template:
        """The same surface in a box of other proportions: (3,) full sizes, scaled to a diagonal of 1."""
        extents = np.asarray(extents_unit, dtype=np.float64)
        if extents.shape != (3,) or not np.isfinite(extents).all() or not (extents > 0).all():
            raise ValueError(
                f"extents_unit: expected three positive numbers, got {extents.tolist()}; pass a box's sizes"
            )
        extents = extents / np.linalg.norm(extents)
        factors = extents / self.extents_unit
        normals = self.normals_unit / factors
        return Template(self.points_unit * factors, normals / np.linalg.norm(normals, axis=1, keepdims=True), extents)


def template_document(template: Template) -> dict[str, Any]:
    """A template in JSON's types: 16 bytes of base64 a sample; `template_from` gives it back to half precision."""
    return {name: _encoded(getattr(template, name)) for name in sorted(_FIELDS)}


def template_from(document: Any) -> Template:
    """The template of `template_document`; ValueError names the field that is wrong, missing or one too many."""
    if not isinstance(document, dict) or document.keys() != _FIELDS:
        got = sorted(map(str, document)) if isinstance(document, dict) else type(document).__name__
        raise ValueError(f"template: expected the fields {sorted(_FIELDS)}, got {got}; export the bundle again")
    points, normals = (_decoded(document[name], name).reshape(-1, 3) for name in ("points_unit", "normals_unit"))
    return Template(points, normals, _decoded(document["extents_unit"], "extents_unit"))


def _encoded(values: Array) -> str:
    return base64.b64encode(np.asarray(values, _STORED).tobytes()).decode("ascii")


def _decoded(text: Any, name: str) -> FloatArray:
    try:
        data = base64.b64decode(text, validate=True)
    except (TypeError, ValueError, binascii.Error) as error:
        raise ValueError(f"template, {name}: expected base64, got {error}; export the bundle again") from error
    if len(data) % (3 * _STORED.itemsize):
        raise ValueError(
            f"template, {name}: expected rows of three half floats, got {len(data)} bytes; export the bundle again"
        )
    return np.frombuffer(data, _STORED).astype(np.float64)
