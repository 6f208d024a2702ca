"""BOP scenes whose objects are parts: poses recovered exactly, samples made of them, faults named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bop_folder import bop_layout, write_bop_scene
from category_objects import posed_object
from page_training.categories import CATEGORIES
from page_training.cli import main
from page_training.datasets.doctor import examine
from page_training.datasets.findings import Finding
from page_training.datasets.labelled import open_labelled
from page_training.datasets.layout import BopLayout, read_layout
from page_training.records import open_shards


def written(folder: Path, category: str, **said: object) -> tuple[Path, Path]:
    """The scene and its layout's file."""
    file = folder / "layout.toml"
    file.write_text(bop_layout(category, **said))  # type: ignore[arg-type]
    layout = read_layout(str(file))
    assert isinstance(layout, BopLayout)
    return write_bop_scene(folder / "data", layout), file


def errors(findings: list[Finding]) -> list[str]:
    return [f"{one.check}: {one.what}" for one in findings if one.severity == "error"]


@pytest.mark.parametrize(
    ("category", "axes", "first_id"),
    [("box", ("x", "y", "z"), 1), ("laptop", ("z", "x", "y"), 7), ("drawer", ("-y", "x", "z"), 3)],
)
def test_poses_of_parts_are_those_that_were_written_whatever_axes_and_numbers_models_have(
    category: str, axes: tuple[str, ...], first_id: int, tmp_path: Path
) -> None:
    path, layout = written(tmp_path, category, axes=axes, first_id=first_id)
    labelled = open_labelled(path, str(layout), CATEGORIES[category])
    assert labelled.notes == ("BOP: this layout was never checked on real data",)
    assert labelled.count == 2
    for instance in labelled.instances():
        for read, true in zip(instance.truths, posed_object(CATEGORIES[category]), strict=True):
            assert read.name == true.name
            np.testing.assert_allclose(read.T_camera_part, true.T_camera_part, atol=1e-9)
            np.testing.assert_allclose(read.extents_m, true.extents_m, atol=1e-9)
        assert set(np.unique(instance.part_mask)) == set(range(len(instance.truths) + 1))
    assert errors(examine(path, str(layout))) == []
    assert errors(examine(path)) == []


def test_a_scene_becomes_samples(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, layout = written(tmp_path, "box")
    cache = tmp_path / "cache"
    assert main(["import", "box", str(path), "--layout", str(layout), "--cache", str(cache), "--repeats", "1"]) == 0
    (records,) = open_shards(cache, "box", "train")
    assert len(records) == 2
    assert (np.bincount(records[0]["labels"], minlength=3) > 50).all()
    assert "never checked on real data" in capsys.readouterr().err
    assert main(["import", "laptop", str(path), "--layout", str(layout), "--cache", str(cache)]) == 2
    assert "expected the parts base, lid of 'laptop'" in capsys.readouterr().err
    assert main(["import", "box", str(path), "--cache", str(cache / "other")]) == 2
    assert "name the --layout" in capsys.readouterr().err


def test_models_in_metres_and_axes_of_another_frame_are_said(tmp_path: Path) -> None:
    path, layout = written(tmp_path, "box")
    models = tmp_path / "data" / "models" / "models_info.json"
    right = models.read_text()
    in_metres = {key: {name: 1e-3 * v for name, v in box.items()} for key, box in json.loads(right).items()}
    models.write_text(json.dumps(in_metres))
    assert any("is its unit another one?" in line for line in errors(examine(path, str(layout))))
    models.write_text(right)
    layout.write_text(bop_layout("box", axes=("y", "z", "x")))
    assert any("poses or part frames are wrong" in line for line in errors(examine(path, str(layout))))
    models.unlink()
    with pytest.raises(ValueError, match=r"no models_info\.json"):
        examine(path, str(layout))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("obj_ids = [1]", "obj_ids: expected 2 different numbers"),
        ("models = 3", "models: expected str"),
        ("more = 1", "unknown"),
    ],
)
def test_a_wrong_bop_layout_is_named(text: str, message: str, tmp_path: Path) -> None:
    own = text.split(" = ")[0]
    lines = [line for line in bop_layout("box").splitlines() if line.split(" = ")[0] != own]
    file = tmp_path / "mine.toml"
    file.write_text("\n".join([*lines, text]))
    with pytest.raises(ValueError, match=message):
        read_layout(str(file))
