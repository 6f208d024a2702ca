"""Categories of the user's own beyond one folder and one object: unseen objects, meshes that stand on y, checkpoints
that are taken elsewhere."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from own_models import JOINT_FILE, URDF, beside
from page_runtime.category import Category
from page_runtime.category_document import category_document
from page_runtime.geometry import apply
from page_training.cache import make_shard
from page_training.categories import own_folder
from page_training.checkpoint import trained_category
from page_training.cli import main
from page_training.own.category import T_part_link, own_category
from page_training.own.files import read_own, write_own
from page_training.own.joint_file import read_joint_file
from page_training.own.model import OwnModel
from page_training.templates import with_templates

FOOT = 'size="0.3 0.2 0.1"'


def _other_crane(crane: Path, folder: Path, foot: str) -> Path:
    """The crane on another foot."""
    (folder / "meshes").mkdir(parents=True)
    for name in ("mast.stl", "slide.obj"):
        (folder / "meshes" / name).write_bytes((crane.parent / "meshes" / name).read_bytes())
    (folder / "crane.urdf").write_text(URDF.replace(FOOT, foot))
    return folder / "crane.urdf"


def test_objects_given_for_a_split_are_in_its_frames_alone(
    crane: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    wide = _other_crane(crane, tmp_path / "wide", 'size="0.5 0.2 0.1"')
    flat = _other_crane(crane, tmp_path / "flat", 'size="0.3 0.2 0.04"')
    words = ["from-urdf", "crane", str(crane), "--validation", str(wide), "--test", str(flat), "--scale-sigma", "0"]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "split validation: objects that training never sees, 1 of them" in told
    own = read_own(own_folder("crane"))
    sizes = {"train": (0.3, 0.2, 0.1), "validation": (0.5, 0.2, 0.1), "test": (0.3, 0.2, 0.04)}
    for split, size in sizes.items():
        make_shard(own.category, split, 0, tmp_path / f"{split}.npy", size=3)
        extents = np.load(tmp_path / f"{split}.npy")["extents_m"][:, 0]
        np.testing.assert_allclose(extents, np.tile(size, (3, 1)), atol=1e-6)
    low, high = own.category.parts[0].diagonal_range_m
    assert low < np.linalg.norm(sizes["train"]) < high < np.linalg.norm(sizes["validation"])
    links = json.loads((own_folder("crane") / "category.json").read_text())["T_part_link"]
    assert list(links) == [str(crane), str(wide), str(flat)]
    mast = [np.array(of_file["mast"]["lamp"]) for of_file in links.values()]
    np.testing.assert_allclose(mast[0], T_part_link(own.models[0])["mast"]["lamp"])


def test_an_object_is_in_one_split_and_a_split_without_objects_shows_those_of_training(crane_model: OwnModel) -> None:
    with pytest.raises(ValueError, match="expected models of different names"):
        own_category("crane", [crane_model], unseen={"test": [crane_model]})
    with pytest.raises(ValueError, match="expected models for validation and test, got tset"):
        own_category("crane", [crane_model], unseen={"tset": []})
    own = own_category("crane", [crane_model], scale_sigma=0.0, unseen={"test": []})
    one, other = (own.sample_object(np.random.default_rng(0), split) for split in ("train", "test"))
    np.testing.assert_array_equal(one.parts[0].mesh.vertices, other.parts[0].mesh.vertices)


@pytest.mark.parametrize("split", ["test", "tset"])
def test_a_category_file_without_objects_to_learn_from_or_of_an_unknown_split_is_refused(
    crane_model: OwnModel, tmp_path: Path, split: str
) -> None:
    write_own(own_category("crane", [crane_model]), tmp_path)
    path = tmp_path / "category.json"
    path.write_text(path.read_text().replace('"split": "train"', f'"split": "{split}"'))
    with pytest.raises(ValueError, match=f"got models of the splits {split}; make it again"):
        read_own(tmp_path)


@pytest.mark.parametrize("up", ["x", "y"])
def test_meshes_that_stand_on_another_axis_are_set_upright(cupboard: Path, tmp_path: Path, up: str) -> None:
    """Up in the file is up in the model, and links keep the file's axes."""
    turned = read_joint_file(beside(cupboard, tmp_path, f'up = "{up}"\n' + JOINT_FILE))
    plain = read_joint_file(cupboard)
    T_model_file = turned.parts[0].links["frame"]
    np.testing.assert_allclose(T_model_file[:3, :3] @ np.eye(3)["xyz".index(up)], [0.0, 0.0, 1.0])
    assert np.isclose(np.linalg.det(T_model_file[:3, :3]), 1.0)
    for a, b in zip(turned.parts, plain.parts, strict=True):
        moved = apply(T_model_file, b.surface.vertices.astype(float))
        apart = np.linalg.norm(a.surface.vertices[:, None] - moved, axis=-1)
        assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-5
    one, other = turned.joints[0], plain.joints[0]
    np.testing.assert_allclose(one.axis, T_model_file[:3, :3] @ other.axis)
    np.testing.assert_allclose(one.point, apply(T_model_file, np.array([other.point]))[0])
    assert one.limits == other.limits


def test_an_axis_that_cannot_be_up_is_refused(cupboard: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="up: expected one of x, y, z, got '-z'"):
        read_joint_file(beside(cupboard, tmp_path, 'up = "-z"\n' + JOINT_FILE))


def test_a_checkpoint_needs_no_category_files_and_takes_none_of_the_same_name(
    crane_model: OwnModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = own_category("crane", [crane_model])
    state = {"category": json.dumps(category_document(own.category))}
    for folder in ("empty", "other"):
        (tmp_path / folder).mkdir()
        monkeypatch.chdir(tmp_path / folder)
        if folder == "other":
            write_own(own_category("crane", [crane_model], scale_sigma=0.2), own_folder("crane"))
        again = with_templates(trained_category(state))
        assert _without_templates(again) == _without_templates(own.category)
        for part, same in zip(again.parts, own.category.parts, strict=True):
            assert part.template is not None
            assert same.template is not None
            np.testing.assert_allclose(part.template.points_unit, same.template.points_unit, atol=1e-3)


def _without_templates(category: Category) -> dict[str, Any]:
    """All that a file says of it, rounded as files are."""
    return category_document(replace(category, parts=tuple(replace(part, template=None) for part in category.parts)))
