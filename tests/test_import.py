"""Annotated pictures as training samples, training on them, and evaluating a checkpoint by object."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from annotated_folder import annotated_layout, write_annotated
from page_runtime.camera import Camera
from page_runtime.capture.playback import open_source
from page_runtime.geometry import apply, invert
from page_training.categories import category_named
from page_training.checkpoint import save_checkpoint
from page_training.cli import main
from page_training.config import TrainingConfig
from page_training.datasets.annotated import read_annotated
from page_training.datasets.labelled import chosen_objects, objects_of, only_objects, open_labelled
from page_training.datasets.samples import import_samples, normals_camera
from page_training.network import network_for
from page_training.records import open_shards, shard_path
from page_training.train import train

BOX = category_named("box")
# The number that write_annotated gives the object.
OBJECT = 3
DATA = Path(__file__).resolve().parent / "data"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_annotated(tmp_path_factory.mktemp("reartmix"), annotated_layout("reartmix"))


@pytest.fixture(scope="module")
def imported(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    cache = tmp_path_factory.mktemp("imported")
    arguments = ["import", "box", str(dataset), "--layout", "reartmix", "--cache", str(cache), "--repeats", "3"]
    assert main(arguments) == 0
    return cache


def test_samples_hold_the_truth_and_points_of_the_parts_they_name(imported: Path, dataset: Path) -> None:
    (records,) = open_shards(imported, "box", "train")
    assert len(records) == 2 * 3
    played = open_source(dataset).entries[0].instances[0].truths
    assert played is not None
    truths = np.stack([truth.T_camera_part for truth in played])
    extents = np.stack([truth.extents_m for truth in played])
    for record in records:
        assert np.allclose(record["extents_m"], extents, atol=1e-5)
        center = truths[0][:3, 3] - record["T_center_part"][0][:3, 3]
        assert np.allclose(record["T_center_part"][1][:3, 3] + center, truths[1][:3, 3], atol=1e-4)
        assert np.allclose(record["T_center_part"][:, :3, :3], truths[:, :3, :3], atol=1e-4)
        counts = np.bincount(record["labels"], minlength=3)
        assert (counts > 50).all()
        for k in (0, 1):
            own = apply(invert(truths[k]), record["points"][record["labels"] == k] + center)
            assert (np.abs(own) <= extents[k] / 2 + 0.016).all()
    assert not np.array_equal(records[0]["pixels"], records[1]["pixels"])


def test_normals_of_a_tilted_plane_are_its_own_and_face_the_camera() -> None:
    camera = Camera(np.array([[200.0, 0, 80], [0, 200.0, 60], [0, 0, 1]]), 160, 120)
    normal = np.array([0.3, -0.5, -1.0]) / np.linalg.norm([0.3, -0.5, -1.0])
    rows, columns = np.indices((120, 160))
    rays = camera.rays(np.stack([columns, rows], axis=-1).astype(float))
    depth = (normal @ [0.0, 0.0, 1.0] / (rays @ normal)).astype(np.float32)
    depth[40:44, 50:54] = 0.0
    normals = normals_camera(depth, camera)
    assert np.allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-5)
    assert (np.einsum("hwk,hwk->hw", normals, rays) < 0).all()
    inner = np.zeros(depth.shape, bool)
    inner[5:-5, 5:-5] = True
    inner[35:50, 45:60] = False
    assert np.degrees(np.arccos(np.clip(normals[inner] @ normal, -1, 1))).max() < 0.5


def test_a_recording_of_the_project_becomes_samples(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = DATA / "box"
    labelled = open_labelled(recording, None, BOX)
    source = labelled.source
    assert main(["import", "box", str(recording), "--cache", str(tmp_path / "cache"), "--repeats", "2"]) == 0
    (records,) = open_shards(tmp_path / "cache", "box", "train")
    assert len(records) == 2 * len(source)
    assert f"{len(source)} instances" in capsys.readouterr().out
    for instance, record in zip(labelled.instances(), records[::2], strict=True):
        seen = np.bincount(instance.part_mask.ravel(), minlength=3)[1:]
        counts = np.bincount(record["labels"], minlength=3)[:2]
        # Points are sampled evenly over the crop, so they are shared as the pixels with depth are.
        assert (counts[seen == 0] == 0).all()
        assert (counts > 0).any()
        center = instance.truths[0].T_camera_part[:3, 3] - record["T_center_part"][0][:3, 3]
        for k, truth in enumerate(instance.truths):
            own = apply(invert(truth.T_camera_part), record["points"][record["labels"] == k] + center)
            assert (np.abs(own) <= truth.extents_m / 2 + 0.016).all()
    assert main(["import", "laptop", str(recording), "--cache", str(tmp_path / "other")]) == 2
    assert "category 'laptop', got 'box'" in capsys.readouterr().err


def test_a_recording_whose_parts_nobody_marked_is_refused(
    toy_recording: Path, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    unmarked = tmp_path / "unmarked"
    shutil.copytree(DATA / "box", unmarked)
    lost = next((unmarked / "mask_visib").iterdir())
    lost.unlink()
    arguments = ["--cache", str(tmp_path / "cache")]
    assert main(["import", "box", str(unmarked), *arguments]) == 2
    assert f"{lost}: expected a mask of" in capsys.readouterr().err
    shutil.rmtree(unmarked / "mask_visib")
    for folder in (unmarked, dataset):
        assert main(["import", "box", str(folder), *arguments]) == 2
        assert "expected a recording of this project" in capsys.readouterr().err
    assert not (tmp_path / "cache").exists()
    assert main(["import", "box", str(toy_recording), "--objects", "1", *arguments]) == 2
    assert "expected a --layout" in capsys.readouterr().err


def test_objects_are_counted_and_chosen(dataset: Path) -> None:
    layout = annotated_layout("reartmix")
    annotated = read_annotated(dataset, layout)
    assert objects_of(annotated) == {OBJECT: 2}
    assert len(only_objects(annotated, [OBJECT]).frames) == 2
    assert len(only_objects(annotated, [4]).frames) == 0
    assert chosen_objects([1, 2, 3], [2], []) == {2}
    assert chosen_objects([1, 2, 3], [], [2]) == {1, 3}
    assert chosen_objects([1, 2], [], []) == {1, 2}
    with pytest.raises(ValueError, match="no instance that was chosen"):
        import_samples([], BOX, 1, 0)


def test_what_is_not_of_the_layout_or_the_category_is_refused(toy_recording: Path, dataset: Path) -> None:
    with pytest.raises(ValueError, match="recording of page-edge, which needs no --layout"):
        open_labelled(toy_recording, "reartmix", BOX)
    with pytest.raises(ValueError, match="says nothing of the part frames of 'laptop', only of box"):
        open_labelled(dataset, "reartmix", category_named("laptop"))
    with pytest.raises(ValueError, match="the category 'laptop', got 'box'"):
        open_labelled(toy_recording, None, category_named("laptop"))


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--objects", "9"], "expected objects among [3], got [9]"),
        (["--without", "3"], "--without: expected to leave some of [3], got none"),
        (["--repeats", "0"], "--repeats: expected at least 1"),
    ],
)
def test_an_import_that_cannot_be_is_refused(
    more: list[str], sentence: str, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["import", "box", str(dataset), "--layout", "reartmix", "--cache", str(tmp_path / "c"), *more]
    assert main(arguments) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "c").exists()


def test_an_import_does_not_mix_with_what_is_there(
    imported: Path, dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", "box", str(dataset), "--layout", "reartmix", "--cache", str(imported)]) == 2
    assert "expected a folder without samples" in capsys.readouterr().err


def test_training_draws_from_both_caches_by_their_share(imported: Path, tmp_path: Path) -> None:
    """With all samples from the second cache the first one's do not matter, and with none the second's do not."""
    settings = {"category": "box", "samples": 4, "batch_size": 2, "dense_points": 64, "also_from": str(imported)}
    weights = {}
    for share in (0.0, 1.0):
        for first in (0, 1):
            cache = tmp_path / f"cache{first}"
            if not cache.exists():
                target = shard_path(cache, "box", "train", 0)
                target.parent.mkdir(parents=True)
                (records,) = open_shards(imported, "box", "train")
                np.save(target, np.array(records[first : first + 1]))
            config = TrainingConfig(**settings, also_share=share, validate_every=100, save_every=100)
            run = train(config, BOX, cache, tmp_path / f"run{share}{first}", lambda _: None)
            weights[share, first] = torch.load(run, weights_only=True)["network"]["keypoints.weight"]
    assert torch.equal(weights[1.0, 0], weights[1.0, 1])
    assert not torch.equal(weights[0.0, 0], weights[0.0, 1])


def test_a_run_without_samples_to_draw_is_refused_before_it_begins(
    imported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for more, sentence in (
        (["--cache", str(tmp_path / "none")], "run page-train scenes first"),
        (["--cache", str(imported), "--also", str(tmp_path / "none")], "run page-train import first"),
    ):
        assert main(["pose", "box", "--run", str(tmp_path / "run"), *more]) == 2
        assert sentence in capsys.readouterr().err
        assert not (tmp_path / "run").exists()


def test_a_checkpoint_is_evaluated_by_object(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from page_runtime.category_document import category_document

    network = network_for(BOX)
    path = tmp_path / "untrained.pt"
    save_checkpoint(
        path,
        average=network.state_dict(),
        samples=0,
        category=json.dumps(category_document(BOX)),
        config="{}",
        step=0,
    )
    out = tmp_path / "figures.json"
    arguments = ["evaluate", str(path), str(dataset)]
    assert main([*arguments, "--layout", "reartmix", "--objects", "3", "--json", str(out)]) == 0
    document = json.loads(out.read_text())
    assert document["instances"] == document["frames"] == 2
    assert [part["name"] for part in document["parts"]] == ["base", "lid"]
    assert "untrained.pt" in capsys.readouterr().out
    assert main([*arguments, "--objects", "3"]) == 2
    assert "expected a --layout" in capsys.readouterr().err
    assert main([*arguments, "--json", str(tmp_path / "nowhere" / "f.json")]) == 2
    assert "no folder" in capsys.readouterr().err
    assert main([*arguments, "--layout", "artimage"]) == 2
    assert "train: no annotations/ folder" in capsys.readouterr().err


def test_the_real_sample_becomes_samples(shared_data: Path) -> None:
    path = shared_data / "reartmix_box"
    layout = annotated_layout("reartmix")
    counts = objects_of(read_annotated(path, layout))
    assert len(counts) == 6
    rarest = min(counts, key=lambda one: counts[one])
    records = import_samples(open_labelled(path, "reartmix", BOX, objects=[rarest]).instances(), BOX, 1, 0)
    assert counts[rarest] * 0.9 <= len(records) <= counts[rarest]
    # Marked points lie in the parts' boxes: of 2048 in a crop a box covers a tenth and more.
    assert np.mean([(record["labels"] < 2).mean() for record in records]) > 0.1


def test_the_layout_gives_the_real_sample_the_poses_that_the_runtime_plays(shared_data: Path) -> None:
    path = shared_data / "reartmix_box"
    played, labelled = open_source(path), open_labelled(path, "reartmix", BOX).source
    assert labelled.format == played.format
    for one, other in zip(labelled.entries, played.entries, strict=True):
        assert (one.index, one.color_path, one.metres_per_unit) == (
            other.index,
            other.color_path,
            other.metres_per_unit,
        )
        for mine, theirs in zip(one.instances, other.instances, strict=True):
            assert mine.region == theirs.region
            for a, b in zip(mine.truths or (), theirs.truths or (), strict=True):
                np.testing.assert_allclose(a.T_camera_part, b.T_camera_part, atol=1e-12)
                np.testing.assert_allclose(a.extents_m, b.extents_m, atol=1e-12)
                assert (a.joint_state is None) == (b.joint_state is None)
                assert a.joint_state is None or a.joint_state == pytest.approx(b.joint_state, abs=1e-9)
