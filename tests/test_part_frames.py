"""Part frames of annotated data sets: poses come back as they were written, wrong frames are named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annotated_folder import DESCRIBED, Fault, annotated_layout, write_annotated, written_layout
from category_objects import posed_object, seen_object
from page_training.categories import CATEGORIES, category_named
from page_training.datasets.annotated import read_annotated
from page_training.datasets.checks import check_annotated
from page_training.datasets.findings import Finding
from page_training.datasets.labelled import open_labelled
from page_training.datasets.layout import BopLayout, Layout, layout_names, read_layout
from page_training.datasets.samples import records_of

REARTMIX = annotated_layout("reartmix")


def found(path: Path, layout: Layout) -> list[Finding]:
    return check_annotated(read_annotated(path, layout))


def errors(findings: list[Finding]) -> list[str]:
    return [f"{one.check}: {one.what}" for one in findings if one.severity == "error"]


@pytest.mark.parametrize(("name", "category"), DESCRIBED)
def test_every_layout_gives_the_poses_states_and_masks_that_were_written(
    name: str, category: str, tmp_path: Path
) -> None:
    layout, known = annotated_layout(name), CATEGORIES[category]
    path = write_annotated(tmp_path, layout, category=category, fault=Fault(scale=0.8))
    labelled = open_labelled(path, name, known)
    assert bool(labelled.notes) == (not layout.verified)
    truths = posed_object(known)
    _, masks = seen_object(truths)
    for instance in labelled.instances():
        for k, (read, true) in enumerate(zip(instance.truths, truths, strict=True)):
            np.testing.assert_allclose(read.T_camera_part, true.T_camera_part, atol=1e-9)
            np.testing.assert_allclose(read.extents_m, true.extents_m, atol=1e-9)
            assert read.name == true.name
            assert (read.joint_state is None) == (true.joint_state is None)
            assert abs((read.joint_state or 0.0) - (true.joint_state or 0.0)) < 1e-9
            assert np.mean((instance.part_mask == k + 1) != masks[k]) < 0.002
        assert len(records_of(instance, known, 1, np.random.default_rng(0))) == 1 + known.focused


@pytest.mark.parametrize(
    ("name", "category", "wrong"),
    [
        ("reartmix", "box", {"lid": ("y", "-x", "z")}),
        ("reartmix", "box", {"base": ("x", "y", "z"), "lid": ("x", "-y", "-z")}),
        ("artimage", "laptop", {"lid": ("x", "-z", "y")}),
        ("artimage", "dishwasher", {"housing": ("z", "x", "y"), "door": ("z", "x", "y")}),
        ("artimage", "drawer", {"body": ("-x", "z", "y")}),
        ("robotarm", "arm", {"base": ("-y", "x", "z"), "wrist": ("-y", "x", "z")}),
    ],
)
def test_part_frames_that_are_not_the_categorys_are_said_with_those_that_are(
    name: str, category: str, wrong: dict[str, tuple[str, ...]], tmp_path: Path
) -> None:
    layout = annotated_layout(name)
    path = write_annotated(tmp_path, layout, category=category)
    (right,) = (one for one in layout.objects if one.category == category)
    parts = tuple(replace(part, axes=wrong.get(part.part, part.axes)) for part in right.parts)
    objects = tuple(replace(one, parts=parts) if one is right else one for one in layout.objects)
    findings = found(path, replace(layout, objects=objects))
    assert any(line.startswith("truths") for line in errors(findings))
    with pytest.raises(ValueError, match="page-train doctor says more, and which axes would fit"):
        open_labelled(path, str(written_layout(tmp_path, replace(layout, objects=objects))), CATEGORIES[category])
    (advice,) = [one.what for one in findings if one.check == "frames"]
    assert ", ".join(f"{part.part} [{' '.join(part.axes)}]" for part in right.parts) in advice


def test_objects_whose_frames_no_layout_gives_are_said(tmp_path: Path) -> None:
    path = write_annotated(tmp_path, REARTMIX)
    findings = found(path, replace(REARTMIX, objects=()))
    assert errors(findings) == []
    assert any("box: the layout has no [[objects]]" in one.what for one in findings)


def test_what_comes_with_the_package_names_parts_that_there_are() -> None:
    for name in layout_names():
        layout = read_layout(name)
        for one in (layout.frames,) if isinstance(layout, BopLayout) else layout.objects:
            assert {part.part for part in one.parts} == {part.name for part in category_named(one.category).parts}
