"""Annotated data sets: a right one is fine in every layout, and every known fault is named with its way out."""

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import toy
from annotated_folder import DESCRIBED, Fault, annotated_layout, spelled, write_annotated, written_layout
from category_objects import posed_object, seen_object
from page_runtime.image_files import SourceError
from page_training.categories import CATEGORIES
from page_training.cli import main
from page_training.datasets.annotated import read_annotated
from page_training.datasets.checks import check_annotated
from page_training.datasets.doctor import examine
from page_training.datasets.findings import Finding
from page_training.datasets.layout import Layout, read_layout
from page_training.datasets.part_frames import signed_permutation

REARTMIX = annotated_layout("reartmix")


def found(path: Path, layout: Layout = REARTMIX) -> list[Finding]:
    return check_annotated(read_annotated(path, layout))


def errors(findings: Iterable[Finding]) -> list[str]:
    return [f"{one.check}: {one.what}" for one in findings if one.severity == "error"]


@pytest.mark.parametrize(("name", "category"), DESCRIBED)
def test_a_right_data_set_is_fine_in_every_layout(name: str, category: str, tmp_path: Path) -> None:
    layout = annotated_layout(name)
    findings = found(write_annotated(tmp_path, layout, category=category), layout)
    assert errors(findings) == []
    assert {one.check for one in findings if one.severity == "fine"} >= {
        "files",
        "links",
        "matrices",
        "joints",
        "truths",
        "outlines",
        "depth",
    }
    assert any(one.check == "layout" for one in findings) == (not layout.verified)


@pytest.mark.parametrize(
    ("fault", "check", "advice"),
    [
        (Fault(link_shift=-1), "links", "the lowest number in the data is 0: first_link"),
        (Fault(sheared=True), "matrices", "not a rotation times one scale"),
        (Fault(transposed=True), "matrices", "stored transposed"),
        (Fault(joint_order=("x", "y", "z")), "joints", "in x y z: joint_order"),
        (Fault(joint_order=("-y", "z", "x")), "joints", "joint_order in the layout"),
        (Fault(unit=0.1), "depth", "with metres_per_unit 0.0001"),
        (Fault(focal=2.0), "outlines", "agree with fx and fy times 0.5"),
        (Fault(focal=0.8), "outlines", "agree with fx and fy times 1.25"),
        (Fault(focal=1.25), "outlines", "agree with fx and fy times 0.8"),
    ],
)
def test_a_fault_is_named_with_the_way_out(fault: Fault, check: str, advice: str, tmp_path: Path) -> None:
    said = errors(found(write_annotated(tmp_path, REARTMIX, fault=fault)))
    assert any(line.startswith(check) and advice in line for line in said), said


def test_a_scale_inside_the_matrices_is_said_and_the_depth_still_fits(tmp_path: Path) -> None:
    findings = found(write_annotated(tmp_path, REARTMIX, fault=Fault(scale=0.8)))
    assert errors(findings) == []
    (scale,) = [one for one in findings if one.check == "matrices"]
    assert scale.severity == "warning"
    assert "0.800 to 0.800" in scale.what


def test_files_that_cannot_be_read_are_named_and_the_others_read(tmp_path: Path) -> None:
    path = write_annotated(tmp_path, REARTMIX, frames=4)
    annotations = sorted((path / "annotations").rglob("*.json"))
    annotations[0].write_text("{")
    document = json.loads(annotations[1].read_text())
    document["instances"][0]["links"][0]["transformation"] = [[1, 0, 0]] * 4
    annotations[1].write_text(json.dumps(document))
    (path / "color/scene/000002.png").unlink()
    dataset = read_annotated(path, REARTMIX)
    assert [frame.name for frame in dataset.frames] == ["scene/000003"]
    for problem, part in zip(
        dataset.problems, ("expected JSON", "expected 4 numbers", "no colour picture"), strict=True
    ):
        assert part in problem


def test_a_truncated_picture_is_an_error_with_its_name(tmp_path: Path) -> None:
    path = write_annotated(tmp_path, REARTMIX, frames=2)
    depth = path / "depth/scene/000001.png"
    depth.write_bytes(depth.read_bytes()[:200])
    assert any("000001" in line for line in errors(found(path)))


def test_splits_that_share_pictures_or_name_missing_ones_are_said(tmp_path: Path) -> None:
    path = write_annotated(tmp_path, REARTMIX, frames=3)
    (path / "train.txt").write_text("scene/000000_0\nscene/000001_0\n")
    (path / "test.txt").write_text("scene/000001_0\nscene/000009_0\n")
    findings = found(path)
    said = errors(findings)
    assert any("1 pictures are both in train.txt and in test.txt" in line for line in said)
    assert any("test.txt: 1 of 2 pictures are not there" in line for line in said)
    assert any("objects [3]" in one.what for one in findings if one.severity == "warning")


def test_masks_are_those_that_were_written(tmp_path: Path) -> None:
    for name, category in (("reartmix", "box"), ("artimage", "laptop")):
        layout = annotated_layout(name)
        _, masks = seen_object(posed_object(CATEGORIES[category]))
        dataset = read_annotated(write_annotated(tmp_path / name, layout, category=category), layout)
        read = dataset.frames[0].mask(0, 1, layout.first_link)
        assert np.mean(read != masks[1]) < 0.002


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "expected TOML"),
        ('name = "x"', "missing"),
        ('joint_order = ["x", "x", "z"]', "joint_order: expected"),
        ("metres_per_unit = 0", "metres_per_unit: expected > 0"),
        ('first_link = "one"', "first_link: expected int"),
        ('models = "{name}.json"', "no placeholder but"),
        ("objects = 3", r"objects: expected tables \[\[objects\]\]"),
        ('objects = [{named = "box"}]', "expected a table of named, category and parts"),
        ('objects = [{named = "box", category = "box", parts = [3]}]', "part 0: expected {part = NAME"),
        ('objects = [{named = "box", category = "box", parts = []}]', "expected parts of different names"),
        (
            'objects = [{named = "b", category = "b", parts = [{part = "p", axes = ["x", "y", "-z"]}]}]',
            "expected a right-handed frame",
        ),
    ],
)
def test_a_wrong_layout_is_named(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    lines = {name: f"{name} = {value}" for name, value in spelled(REARTMIX).items()}
    own = text.split(" = ")[0]
    file.write_text(
        "\n".join([*(line for name, line in lines.items() if name != own), text] if "=" in text else [text])
    )
    if message == "missing":
        file.write_text(text)
    with pytest.raises(SourceError, match=message):
        read_layout(str(file))


def test_an_own_layout_reads_what_it_describes(tmp_path: Path) -> None:
    described = replace(REARTMIX, first_link=0, depth="range")
    layout = annotated_layout(str(written_layout(tmp_path, described)))
    assert layout == described
    assert errors(found(write_annotated(tmp_path, layout), layout)) == []


def test_signed_permutations_are_orthonormal() -> None:
    for order in (["x", "y", "z"], ["-z", "x", "y"], ["y", "-x", "-z"]):
        matrix = signed_permutation(order)
        np.testing.assert_array_equal(matrix @ matrix.T, np.eye(3))


@pytest.mark.parametrize("fault", [Fault(link_shift=-1), Fault(sheared=True)])
def test_the_doctor_recognises_reartmix_and_examines_it_though_it_is_faulty(fault: Fault, tmp_path: Path) -> None:
    path = write_annotated(tmp_path, REARTMIX, fault=fault)
    assert errors(examine(path)) == errors(found(path)) != []


def test_annotations_of_nothing_depth_of_another_size_and_polygons_without_inside_are_said(tmp_path: Path) -> None:
    path = write_annotated(tmp_path, REARTMIX, frames=1)
    file = next((path / "annotations").rglob("*.json"))
    document = json.loads(file.read_text())
    document["instances"][0]["links"][0]["segmentation"].append([])
    file.write_text(json.dumps(document))
    assert errors(found(path)) == []
    document["instances"][0]["links"][0]["segmentation"] = 5
    file.write_text(json.dumps(document))
    with pytest.raises(SourceError, match="segmentation: expected a list"):
        read_annotated(path, REARTMIX)
    file.write_text(json.dumps({"instances": []}))
    assert any("not one link" in line for line in errors(found(path)))
    small = write_annotated(tmp_path / "small", REARTMIX, frames=1)
    depth = next((small / "depth").rglob("*.png"))
    pixels = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    cv2.imwrite(str(depth), pixels[::2, ::2])
    assert any("register depth to colour first" in line for line in errors(found(small)))


def test_the_doctor_examines_recordings_and_says_their_unit(toy_recording: Path, tmp_path: Path) -> None:
    assert errors(examine(toy_recording)) == []
    broken = tmp_path / "broken"
    toy.write_toy_recording(broken)
    file = broken / "scene_camera.json"
    cameras = json.loads(file.read_text())
    for camera in cameras.values():
        camera["depth_scale"] *= 10
    file.write_text(json.dumps(cameras))
    assert any("agree with depth_scale 0.1" in line for line in errors(examine(broken)))


def test_the_command_prints_findings_and_ends_with_the_right_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right, wrong = write_annotated(tmp_path / "a", REARTMIX), write_annotated(
        tmp_path / "b", REARTMIX, fault=Fault(link_shift=1)
    )  # fmt: skip
    assert main(["doctor", str(right), "--layout", "reartmix"]) == 0
    assert main(["doctor", str(wrong), "--layout", "reartmix", "--json", str(tmp_path / "findings.json")]) == 1
    assert "first_link" in capsys.readouterr().out
    assert any(one["severity"] == "error" for one in json.loads((tmp_path / "findings.json").read_text()))
    assert main(["doctor", str(tmp_path / "nothing"), "--layout", "reartmix"]) == 2
    assert main(["doctor", str(right), "--layout", "unknown"]) == 2
    assert "expected one of artimage, bop, reartmix, robotarm" in capsys.readouterr().err


def test_the_real_sample_is_fine_but_for_the_scale_in_its_matrices(shared_data: Path) -> None:
    findings = examine(shared_data / "reartmix_box")
    assert errors(findings) == []
    assert [one.check for one in findings if one.severity == "warning"] == ["matrices"]
