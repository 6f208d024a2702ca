"""What `page-runtime inspect` says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from page_runtime import Network
from page_runtime.bundle import PREPROCESSING
from page_runtime.bundle_file import read_bundle
from page_runtime.commands.inspect import readable
from page_training.categories import category_named

BUNDLE = Path(__file__).resolve().parents[1] / "runtime/bundles/box.onnx"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("arm", "turns by 180 deg about (0.000, 0.000, 1.000) change nothing"),
        ("scissors", "first blade as second blade, second blade as first blade"),
    ],
)
def test_what_looks_the_same_is_told_and_only_of_categories_that_have_it(name: str, said: str) -> None:
    metadata = Network(BUNDLE, threads=1).metadata
    assert said not in readable(metadata, BUNDLE)
    symmetric = replace(metadata, category=category_named(name), mirrored=False, figures=())
    assert said in readable(symmetric, BUNDLE)


def test_input_joints_and_figures_are_told() -> None:
    metadata = read_bundle(BUNDLE).metadata
    said = readable(metadata, BUNDLE)
    for sentence in PREPROCESSING.values():
        assert sentence in said
    (joint,) = metadata.category.joints
    assert joint.geometry is not None
    assert "({:.3f}, {:.3f}, {:.3f}) of base's box".format(*joint.geometry.pivot_parent) in said
    assert metadata.figures
    for one in metadata.figures:
        assert f"{one.data}, {one.instances} objects" in said
    assert "figures        not measured" in readable(replace(metadata, figures=()), BUNDLE)
