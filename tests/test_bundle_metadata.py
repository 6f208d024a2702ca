"""What a bundle says of itself is understood whole or refused, field by field."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from page_runtime.bundle import METADATA_VERSION, BundleMetadata
from page_runtime.bundle_fields import BundleError
from page_runtime.bundle_figures import PartFigures, figures_document, figures_from
from page_runtime.bundle_file import read_bundle
from page_training.categories import CATEGORIES

BUNDLES = Path(__file__).resolve().parents[1] / "runtime" / "bundles"
FIGURES = PartFigures("a test", 3, "lid", (1.5, 0.5), (None, None), (0.25, 0.125), 0.5, None)


@pytest.fixture(scope="module")
def metadata() -> BundleMetadata:
    return read_bundle(BUNDLES / "box.onnx").metadata


def test_metadata_survives_the_round_trip(metadata: BundleMetadata) -> None:
    again = BundleMetadata.from_json(metadata.to_json())
    assert again.to_json() == metadata.to_json()
    assert again.figures == metadata.figures
    for ours, theirs in zip(again.category.parts, CATEGORIES["box"].parts, strict=True):
        np.testing.assert_array_equal(ours.keypoints_unit, theirs.keypoints_unit)
        assert ours.frame == theirs.frame


@pytest.mark.parametrize("focused", [False, True])
def test_a_thin_category_says_so_and_others_read_as_before(metadata: BundleMetadata, focused: bool) -> None:
    written = replace(metadata, category=replace(metadata.category, focused=focused)).to_json()
    assert ("focused" in json.loads(written)) == focused
    assert BundleMetadata.from_json(written).category.focused == focused


@pytest.mark.parametrize("path", sorted(BUNDLES.glob("*.onnx")), ids=lambda path: path.stem)
def test_shipped_bundles_say_what_they_reached_on_the_test_split(path: Path) -> None:
    metadata = read_bundle(path).metadata
    measured = {one.part for one in metadata.figures if one.data.startswith("procedural")}
    assert measured == {part.name for part in metadata.category.parts}


def test_figures_survive_the_round_trip_and_are_of_known_parts(metadata: BundleMetadata) -> None:
    assert figures_from(json.loads(json.dumps(figures_document(FIGURES)))) == FIGURES
    with pytest.raises(ValueError, match="expected those of the category's parts, got \\['wheel'\\]"):
        replace(metadata, figures=(replace(FIGURES, part="wheel"),))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda d: d.update(version=99), f"version {METADATA_VERSION}, got 99"),
        (lambda d: d.update(mirrored="yes"), "mirrored: expected true or false, got 'yes'"),
        (lambda d: d.update(focused=1), "focused: expected true or false, got 1"),
        (lambda d: d.pop("voxel_m"), "missing .*voxel_m"),
        (lambda d: d.update(surprise=1), "not understood .*surprise"),
        (lambda d: d["parts"][0].pop("frame"), "part: missing .*frame"),
        (lambda d: d["parts"][0].update(keypoints_unit=[[0, 0]]), "keypoints_unit"),
        (lambda d: d["parts"][0].update(keypoints_unit=[[0.3, 0, 0]] * 8), "0.01 or more off one line"),
        (lambda d: d["parts"][0].update(keypoints_unit=[[k, k, 0] for k in range(8)]), "0.01 or more off one line"),
        (lambda d: d["parts"][0]["keypoints_unit"].__setitem__(0, [1e30, 0, 0]), "within 10 diagonals"),
        (lambda d: d["parts"][0].update(diagonal_range_m=[0.1, float("inf")]), "diagonal_range_m"),
        (lambda d: d["parts"][0].update(extents_unit=[0.1, 0.1, float("inf")]), "extents_unit"),
        (lambda d: d["parts"][0].update(name="base\n"), "printable"),
        (lambda d: d["parts"][0].update(frame="\x1b[2J"), "printable"),
        (lambda d: d["parts"][0].update(name="lid"), "a name for each part"),
        (lambda d: d["joints"][0].update(kind="elastic"), "elastic"),
        (lambda d: d["joints"][0].update(child=7), "no part index"),
        (lambda d: d["joints"].append(d["joints"][0] | {"parent": 1, "child": 0}), "a name for each joint"),
        (lambda d: d["joints"][0].update(child=0), "against itself"),
        (lambda d: d["joints"][0].update(child=1.0), "child: expected a whole number, got 1.0"),
        (lambda d: d["joints"][0].update(axis=[0, 0, 0]), "expected a unit vector"),
        (lambda d: d["joints"][0].update(limits=[1, 0]), "low <= high"),
        (lambda d: d["joints"].append(d["joints"][0] | {"name": "other"}), "a second parent"),
        (lambda d: d["joints"].append(d["joints"][0] | {"parent": 1, "child": 0, "name": "other"}), "a loop"),
        (lambda d: d["joints"][0]["geometry"].update(log_size_ratio=float("nan")), "finite"),
        (lambda d: d.update(num_points="2048"), "num_points: expected a whole number, got '2048'"),
        (lambda d: d.update(num_points=2048.5), "num_points: expected a whole number, got 2048.5"),
        (lambda d: d.update(num_points=1 << 20), "expected 1 to 32768 points"),
        (lambda d: d.update(voxel_m=-0.005), "voxel_m"),
        (lambda d: d.update(voxel_m=1e-9), "voxel_m"),
        (lambda d: d.update(region_radius_m=float("nan")), "region_radius_m"),
        (lambda d: d["preprocessing"].update(image="BGR"), "preprocessing: expected what this runtime does"),
        (lambda d: d["figures"][0].pop("part"), "figures: expected the fields"),
        (lambda d: d["figures"][0].update(instances=-1), "instances: expected a count"),
        (lambda d: d["figures"][0].update(data="\x1b[2J"), "data: expected printable text"),
        (lambda d: d["figures"][0]["rotation_deg"].update(mean="low"), "rotation_deg: expected a number"),
    ],
)
def test_metadata_that_is_not_understood_whole_is_refused(
    metadata: BundleMetadata, change: Callable[[dict[str, Any]], object], word: str
) -> None:
    document = json.loads(metadata.to_json())
    change(document)
    with pytest.raises(BundleError, match=word):
        BundleMetadata.from_json(json.dumps(document))
