"""Categories of the user's own: kinematics as the loader's own, and scenes of them as of any other category."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
import yourdfpy

from own_models import BOLT, JOINT_FILE, URDF, beside
from page_runtime.geometry import Array, apply, invert, rotation_about
from page_runtime.symmetry import Symmetry
from page_training.batches import make_batch
from page_training.cache import make_shard, write_shard
from page_training.categories import category_named, known_categories, own_folder
from page_training.cli import main
from page_training.config import Augmentation
from page_training.own.category import OwnCategory, T_part_link, own_category
from page_training.own.files import read_own, write_own
from page_training.own.joint_file import read_joint_file
from page_training.own.model import OwnModel
from page_training.own.surfaces import MOST_TRIANGLES
from page_training.own.urdf import read_urdf
from page_training.records import open_shards, record_type, scenes_version, shard_path
from page_training.scenes import sample_scene, training_view
from page_training.scenes.kinds import scene_category
from page_training.templates import part_templates


@pytest.fixture
def own_crane(crane_model: OwnModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> OwnCategory:
    """The crane as a category of the working directory."""
    monkeypatch.chdir(tmp_path)
    own = own_category("crane", [crane_model], symmetries=[("slide", Symmetry((1.0, 0.0, 0.0), 0))])
    write_own(own, own_folder("crane"))
    return own


def test_links_are_where_the_urdf_s_own_kinematics_have_them(crane: Path, crane_model: OwnModel) -> None:
    own = own_category("crane", [crane_model], scale_sigma=0.0)
    robot = yourdfpy.URDF.load(str(crane), load_meshes=False)
    rng = np.random.default_rng(0)
    model = own.sample_object(rng)
    names = [part.name for part in own.category.parts]
    assert names == ["foot", "mast", "boom", "slide"]
    assert set(T_part_link(crane_model)["mast"]) == {"mast", "lamp"}
    for _ in range(5):
        states = tuple(float(rng.uniform(*joint.limits)) for joint in model.joints)
        robot.update_cfg(dict(zip((joint.name for joint in own.category.joints), states, strict=True)))
        poses = model.poses(np.eye(4), states)
        T_foot_links = {
            link: invert(poses[0] @ T_part_link(crane_model)["foot"]["foot"]) @ pose @ T
            for name, pose in zip(names, poses, strict=True)
            for link, T in T_part_link(crane_model)[name].items()
        }
        for link, T in T_foot_links.items():
            np.testing.assert_allclose(T, robot.get_transform(link, "foot"), atol=1e-6)


def test_surfaces_lie_where_the_urdf_has_them_and_are_made_simple(crane_model: OwnModel) -> None:
    model = crane_model
    assert sum(len(part.surface.triangles) for part in model.parts) <= 1.1 * MOST_TRIANGLES
    foot, mast, _, slide = (part.surface for part in model.parts)
    np.testing.assert_allclose(np.ptp(foot.vertices, axis=0), (0.3, 0.2, 0.1), atol=1e-6)
    np.testing.assert_allclose(np.ptp(slide.vertices, axis=0), (0.05, 0.05, 0.05), atol=1e-3)
    T_foot_mast = model.parts[1].links["mast"]
    local = apply(invert(T_foot_mast), mast.vertices.astype(float))
    lamp = np.linalg.norm(local - [0.0, 0.03, 0.31], axis=1) < 0.031
    np.testing.assert_allclose(np.ptp(local[~lamp], axis=0), (0.05, 0.04, 0.3), atol=1e-5)
    assert lamp.sum() > 20
    colors = foot.palette[foot.color]
    np.testing.assert_allclose(colors, np.tile([0.9, 0.5, 0.1], (len(colors), 1)), atol=0.02)


def test_a_joint_that_follows_another_stands_at_its_own_zero(crane: Path, tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    for name in ("mast.stl", "slide.obj"):
        (tmp_path / "meshes" / name).write_bytes((crane.parent / "meshes" / name).read_bytes())
    limit = '<limit lower="0" upper="0.1"'
    for multiplier, leader in ((-1, "lift"), (0, "turn")):
        follows = f'<mimic joint="{leader}" multiplier="{multiplier}" offset="0.07"/>'
        (tmp_path / "crane.urdf").write_text(URDF.replace(limit, follows + limit))
        for fixed in ([], ["lift"], ["reach"]):
            model, free = read_urdf(tmp_path / "crane.urdf", fixed), read_urdf(crane, fixed)
            for part, same in zip(model.parts, free.parts, strict=True):
                np.testing.assert_allclose(part.surface.vertices, same.surface.vertices, atol=1e-7)
                for link, T in part.links.items():
                    np.testing.assert_allclose(T, same.links[link], atol=1e-9)
            assert [joint.point for joint in model.joints] == [joint.point for joint in free.joints]


def test_a_joint_taken_for_fixed_joins_its_links(crane: Path) -> None:
    model = read_urdf(crane, ["lift"])
    assert [part.name for part in model.parts] == ["foot", "mast", "slide"]
    assert set(model.parts[1].links) == {"mast", "lamp", "boom"}
    assert [(joint.name, joint.parent, joint.child) for joint in model.joints] == [("turn", 0, 1), ("reach", 1, 2)]


def test_a_joint_file_says_what_it_means(cupboard: Path) -> None:
    model = read_joint_file(cupboard)
    frame, door = (part.surface for part in model.parts)
    np.testing.assert_allclose(np.ptp(frame.vertices, axis=0), (0.4, 0.3, 0.5), atol=1e-6)
    np.testing.assert_allclose(door.vertices.min(axis=0), (-0.198, -0.045, 0.005), atol=1e-4)
    assert (np.abs(door.palette[door.color] - [1, 0, 0]) < 0.1).all(axis=1).any()
    (joint,) = model.joints
    np.testing.assert_allclose([*joint.axis, *joint.point, *joint.limits], [0, 0, 1, -0.2, 0, 0, 0, np.radians(110)])
    own = own_category("cupboard", [model], scale_sigma=0.0)
    item = own.sample_object(np.random.default_rng(0))
    closed, opened = item.poses(np.eye(4), (0.0,))[1], item.poses(np.eye(4), (np.pi / 2,))[1]
    hinge = np.array([-0.2, 0.0, 0.0]) - np.array([0.0, 0.15, 0.25])
    turn = rotation_about(np.array([0.0, 0.0, 1.0]), np.pi / 2)
    np.testing.assert_allclose(opened[:3, 3], hinge + turn @ (closed[:3, 3] - hinge), atol=1e-6)


def test_a_joint_of_a_joint_file_taken_for_fixed_joins_its_parts(cupboard: Path, tmp_path: Path) -> None:
    path = beside(cupboard, tmp_path, JOINT_FILE + BOLT)
    apart, joined = read_joint_file(path), read_joint_file(path, ["slide"])
    assert [part.name for part in joined.parts] == ["frame", "door"]
    assert [joint.name for joint in joined.joints] == ["hinge"]
    assert set(joined.parts[1].links) == {"door", "bolt"}
    count = [len(part.surface.triangles) for part in apart.parts]
    assert [len(part.surface.triangles) for part in joined.parts] == [count[0], count[1] + count[2]]
    carried = read_joint_file(path, ["hinge"])
    assert [part.name for part in carried.parts] == ["frame", "bolt"]
    assert [(joint.name, joint.parent, joint.child) for joint in carried.joints] == [("slide", 0, 1)]


@pytest.mark.usefixtures("own_crane")
def test_an_own_category_is_used_as_any_other(tmp_path: Path) -> None:
    assert "crane" in known_categories()
    category = category_named("crane")
    assert not category.joints_mirror
    assert category.parts[3].symmetry == Symmetry((1.0, 0.0, 0.0), 0)
    rng = np.random.default_rng(2)
    seen = set()
    for _ in range(6):
        view = training_view(sample_scene("crane", rng), rng)
        seen |= set(np.unique(view.part_mask).tolist())
        for k, (part, truth) in enumerate(zip(category.parts, view.truths, strict=True)):
            low, high = part.diagonal_range_m
            assert low < np.linalg.norm(truth.extents_m) < high
            mask = view.part_mask == k + 1
            rows, columns = np.nonzero(mask)
            pixels = np.stack([columns, rows], axis=-1).astype(float)
            points = view.frame.camera.backproject(pixels, view.noiseless_depth_m[mask])
            assert (np.abs(apply(invert(truth.T_camera_part), points)) <= truth.extents_m / 2 + 1e-3).all()
        for joint, state in zip(category.joints, view.joint_states, strict=True):
            assert joint.limits[0] <= state <= joint.limits[1]
    assert seen >= {1, 2, 3, 4}
    make_shard(category, "train", 0, tmp_path / "shard.npy", size=2)
    records = np.load(tmp_path / "shard.npy")
    never_turned = Augmentation(flip_probability=1.0, turn_sigma_rad=0.0, scale_sigma=0.0)
    batch = make_batch(
        records, category, dense_points=64, generator=torch.Generator().manual_seed(0), augmentation=never_turned
    )
    # A mirror would show another crane.
    np.testing.assert_allclose(batch.truth.R.numpy(), records["T_center_part"][..., :3, :3], atol=1e-6)
    templates = part_templates(scene_category("crane").sample_object, rng, instances=3, points=64)
    assert [len(template.points_unit) for template in templates] == [64] * 4


def test_a_category_read_back_makes_the_same_scenes(own_crane: OwnCategory) -> None:
    again = read_own(own_folder("crane"))
    one, other = (own.sample_object(np.random.default_rng(5)) for own in (own_crane, again))
    for a, b in zip(one.parts, other.parts, strict=True):
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        np.testing.assert_array_equal(a.mesh.triangles, b.mesh.triangles)
    for a, b in zip(one.joints, other.joints, strict=True):
        np.testing.assert_array_equal(a.pivot_child, b.pivot_child)
        assert a.joint.axis == b.joint.axis
    ours, theirs = (T_part_link(own.models[0])["mast"]["lamp"] for own in (own_crane, again))
    np.testing.assert_allclose(ours, theirs)


@pytest.mark.usefixtures("own_crane")
def test_what_stands_does_not_reach_below_its_foot() -> None:
    kind, rng = scene_category("crane"), np.random.default_rng(3)
    for _ in range(10):
        model = kind.sample_object(rng)
        poses: list[Array] = model.poses(np.eye(4), kind.sample_states(rng, model))
        floor = model.parts[0].mesh.vertices[:, 2].min()
        for part, T in zip(model.parts, poses, strict=True):
            assert apply(T, part.mesh.vertices.astype(float))[:, 2].min() > floor - 0.01


def test_parts_without_a_joint_between_them_keep_out_of_each_other(crane_model: OwnModel) -> None:
    """The slide, let down, would stand inside the foot in many of the states that the joints allow."""
    turn, lift, reach = crane_model.joints
    folding = (turn, replace(lift, limits=(-1.75, -1.2)), replace(reach, limits=(0.0, 0.2)))
    own = own_category("folding", [replace(crane_model, joints=folding)], rest="any", scale_sigma=0.0)
    rng = np.random.default_rng(0)
    model = own.sample_object(rng)

    def inside(states: tuple[float, ...]) -> bool:
        poses = model.poses(np.eye(4), states)
        points = apply(invert(poses[0]) @ poses[3], model.parts[3].mesh.vertices.astype(float))
        return bool((np.abs(points) < 0.2 * model.parts[0].extents_m).all(axis=1).any())

    allowed = [tuple(float(rng.uniform(*joint.limits)) for joint in model.joints) for _ in range(60)]
    assert sum(map(inside, allowed)) > 5
    assert not any(inside(own.sample_states(rng, model)) for _ in range(60))


def test_several_models_make_one_category_and_must_be_alike(
    crane: Path, crane_model: OwnModel, cupboard: Path, tmp_path: Path
) -> None:
    larger = tmp_path / "larger"
    (larger / "meshes").mkdir(parents=True)
    for name in ("mast.stl", "slide.obj"):
        (larger / "meshes" / name).write_bytes((crane.parent / "meshes" / name).read_bytes())
    (larger / "crane.urdf").write_text(URDF.replace('size="0.3 0.2 0.1"', 'size="0.5 0.2 0.1"'))
    own = own_category("cranes", [crane_model, read_urdf(larger / "crane.urdf")], scale_sigma=0.0)
    rng = np.random.default_rng(0)
    widths = {round(float(own.sample_object(rng).parts[0].extents_m[0]), 3) for _ in range(20)}
    assert widths == {0.3, 0.5}
    with pytest.raises(ValueError, match=r"cupboard.toml: expected the parts of .*crane.urdf"):
        own_category("mixed", [crane_model, read_joint_file(cupboard)])


def test_the_command_makes_a_category_that_the_others_take(
    crane: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["from-urdf", "crane", str(crane), "--fix", "reach", "--symmetric", "boom", "x", "2"]) == 0
    told = capsys.readouterr().out
    assert "part boom" in told
    assert "joint lift: revolute, mast to boom, -11.5 to 68.8 deg" in told
    assert json.loads((tmp_path / "export/categories/crane/category.json").read_text())["rest"] == "stand"
    assert main(["preview", "crane", "--out", "sheet.png", "--rows", "1", "--columns", "2"]) == 0
    assert (tmp_path / "sheet.png").stat().st_size > 10_000


def test_sizes_of_every_file_are_told_before_what_refuses_them(
    crane: Path, cupboard: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own").mkdir()
    metres = beside(cupboard, tmp_path / "own", JOINT_FILE.replace('unit = "mm"', ""))
    assert main(["from-urdf", "mixed", str(crane), str(metres)]) == 2
    told = capsys.readouterr().out
    assert "crane.urdf: part foot: 300 x 200 x 100 mm" in told
    assert "cupboard.toml: part frame: 400000 x 300000 x 500000 mm" in told
    assert [line for line in told.splitlines() if "is the unit right?" in line] == [
        'cupboard.toml: a part measures 500 m: is the unit right? Where lengths are in mm, say so: unit = "mm"'
    ]


@pytest.mark.parametrize(
    ("scale", "asked"),
    [(1.0, None), (0.03, 'scale="1 1 1"'), (50.0, 'scale="0.001 0.001 0.001"')],
)
def test_a_urdf_of_no_likely_size_is_asked_for_its_unit(
    scale: float, asked: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    box = trimesh.creation.box((0.3, 0.2, 0.1))
    box.export(tmp_path / "box.stl")
    link = f'<visual><geometry><mesh filename="box.stl" scale="{scale} {scale} {scale}"/></geometry></visual></link>'
    (tmp_path / "two.urdf").write_text(
        f'<robot name="two"><link name="a">{link}<link name="b">{link}<joint name="turn" type="continuous">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>'
    )
    main(["from-urdf", "two", "two.urdf"])
    told = capsys.readouterr().out
    assert ("is the unit right?" in told) == (asked is not None)
    assert asked is None or asked in told


def test_a_category_made_again_does_not_use_the_frames_of_the_one_before(
    own_crane: OwnCategory, crane: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = shard_path(tmp_path, "crane", "train", 0)
    write_shard(before, np.zeros(1, record_type(4)))
    write_own(own_crane, own_folder("crane"))
    assert shard_path(tmp_path, "crane", "train", 0) == before
    assert len(open_shards(tmp_path, "crane", "train")) == 1
    assert main(["from-urdf", "crane", str(crane), "--fix", "reach"]) == 0
    assert "replaces the category crane" in capsys.readouterr().out
    assert shard_path(tmp_path, "crane", "train", 0).parent != before.parent
    assert not open_shards(tmp_path, "crane", "train")
    assert main(["pose", "crane", "--cache", str(tmp_path), "--run", str(tmp_path / "run")]) == 2
    told = capsys.readouterr().err
    assert f"{before.parent.name}: of another make of it" in told
    assert "page-train scenes" in told
    assert shard_path(tmp_path, "box", "train", 0).parent.name == f"box-v{scenes_version('box')}"


@pytest.mark.usefixtures("own_crane")
def test_a_folder_that_holds_something_else_is_refused() -> None:
    path = own_folder("crane") / "category.json"
    path.write_text(path.read_text().replace('"version": 2', '"version": 9', 1))
    with pytest.raises(ValueError, match="expected version 2, got 9; make it again"):
        read_own(own_folder("crane"))
