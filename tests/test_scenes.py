"""Laws of the procedural scenes: truth agrees with what is seen, and all of it follows from the generator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from page_runtime.geometry import apply, invert, rotation_about
from page_training.categories import category_named
from page_training.scenes import CATEGORIES, SceneView, full_view, sample_scene, training_view
from page_training.scenes.articulated import ArticulatedObject
from page_training.scenes.kinds import scene_category
from page_training.scenes.statistics import joint_geometry, part_statistics

VIEWS = 16
OBJECTS = 60


@pytest.fixture(scope="module", params=sorted(CATEGORIES))
def category(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def views(category: str) -> list[SceneView]:
    rng = np.random.default_rng(7)
    return [training_view(sample_scene(category, rng), rng) for _ in range(VIEWS)]


@pytest.fixture(scope="module")
def objects(category: str) -> list[ArticulatedObject]:
    rng = np.random.default_rng(5)
    return [scene_category(category).sample_object(rng) for _ in range(OBJECTS)]


def _pixels(mask: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(mask)
    return np.stack([columns, rows], axis=-1).astype(float)


def test_the_generator_alone_decides_a_view(category: str) -> None:
    one, other, another = (
        training_view(sample_scene(category, rng), rng)
        for rng in (np.random.default_rng(3), np.random.default_rng(3), np.random.default_rng(4))
    )
    np.testing.assert_array_equal(one.frame.color, other.frame.color)
    np.testing.assert_array_equal(one.frame.depth_m, other.frame.depth_m)
    np.testing.assert_array_equal(one.part_mask, other.part_mask)
    np.testing.assert_array_equal(one.truths[1].T_camera_part, other.truths[1].T_camera_part)
    assert not np.array_equal(one.frame.color, another.frame.color)


def test_every_point_of_a_part_lies_in_its_box(views: list[SceneView]) -> None:
    for view in views:
        for k, truth in enumerate(view.truths):
            mask = view.part_mask == k + 1
            points_camera = view.frame.camera.backproject(_pixels(mask), view.noiseless_depth_m[mask])
            points_part = apply(invert(truth.T_camera_part), points_camera)
            assert (np.abs(points_part) <= truth.extents_m / 2 + 1e-3).all()


def test_part_poses_obey_the_joints_of_the_category(category: str, views: list[SceneView]) -> None:
    for view in views:
        for joint, state in zip(category_named(category).joints, view.joint_states, strict=True):
            parent, child = (view.truths[k].T_camera_part for k in (joint.parent, joint.child))
            turn = (invert(parent) @ child)[:3, :3]
            expected = rotation_about(np.array(joint.axis), state) if joint.kind == "revolute" else np.eye(3)
            np.testing.assert_allclose(turn, expected, atol=1e-9)
            assert joint.limits[0] <= state <= joint.limits[1]


def test_a_joint_is_one_point_at_every_state_but_for_its_slide(objects: list[ArticulatedObject]) -> None:
    for model in objects[:4]:
        for share in np.linspace(0, 1, 5):
            states = tuple(float(low + share * (high - low)) for low, high in (j.limits for j in model.joints))
            poses = model.poses(np.eye(4), states)
            for joint, state in zip(model.joints, states, strict=True):
                one = apply(poses[joint.joint.parent], joint.pivot_parent)
                other = apply(poses[joint.joint.child], joint.pivot_child)
                if joint.joint.kind == "prismatic":
                    one = one + poses[joint.joint.parent][:3, :3] @ (state * np.array(joint.joint.axis))
                np.testing.assert_allclose(one, other, atol=1e-12)


def test_states_lie_within_the_limits_of_the_object_and_those_within_the_category_s(
    category: str, objects: list[ArticulatedObject]
) -> None:
    rng = np.random.default_rng(9)
    for model in objects:
        states = scene_category(category).sample_states(rng, model)
        for joint, state in zip(model.joints, states, strict=True):
            assert joint.limits[0] <= state <= joint.limits[1]
            assert joint.joint.limits[0] <= joint.limits[0] < joint.limits[1] <= joint.joint.limits[1]


def test_a_lid_that_opens_rises_at_its_front() -> None:
    for category in ("box", "laptop"):
        model = CATEGORIES[category].sample_object(np.random.default_rng(5))
        front_of_lid = np.array([0.0, -model.parts[1].extents_m[1] / 2, 0.0])
        heights = [apply(model.poses(np.eye(4), (state,))[1], front_of_lid)[2] for state in (0.0, 0.5, 1.0)]
        assert heights[0] < heights[1] < heights[2]


def test_drawers_come_out_at_the_front_in_the_order_of_their_names() -> None:
    model = CATEGORIES["drawer"].sample_object(np.random.default_rng(5))
    pulled = tuple(joint.limits[1] for joint in model.joints)
    closed, opened = (np.array(model.poses(np.eye(4), states))[:, :3, 3] for states in ((0.0,) * 3, pulled))
    np.testing.assert_allclose((opened - closed)[1:, 1], -np.array(pulled))
    assert closed[1, 2] > closed[2, 2] > closed[3, 2]


def test_the_category_describes_the_objects_of_its_scenes(category: str, objects: list[ArticulatedObject]) -> None:
    described = category_named(category)
    for k, part in enumerate(described.parts):
        measured = part_statistics(objects, k)
        np.testing.assert_allclose(part.extents_unit, measured.extents_unit, atol=0.08)
        for model in objects:
            assert part.diagonal_range_m[0] <= np.linalg.norm(model.parts[k].extents_m) <= part.diagonal_range_m[1]
    for j, joint in enumerate(described.joints):
        assert joint.geometry is not None
        assert {(m.joints[j].joint.axis, m.joints[j].joint.kind) for m in objects} == {(joint.axis, joint.kind)}
        geometry = joint_geometry(objects, j)
        for side in ("parent", "child"):
            given, found = (getattr(one, f"pivot_{side}") for one in (joint.geometry, geometry))
            sigma = np.array(getattr(geometry, f"sigma_{side}"))
            shares = described.parts[getattr(joint, side)].extents_unit
            assert (np.abs(np.subtract(given, found)) * shares <= 0.6 * sigma + 0.01).all()
        assert abs(joint.geometry.log_size_ratio - geometry.log_size_ratio) < 0.6 * geometry.log_size_sigma + 0.03


def test_the_region_holds_the_object(category: str, views: list[SceneView]) -> None:
    radius_m = category_named(category).region_radius_m
    lost = []
    for view in views:
        mask = view.part_mask > 0
        if not mask.any():
            continue
        points = view.frame.camera.backproject(_pixels(mask), view.noiseless_depth_m[mask])
        middle = np.median(points, axis=0)
        lost.append(float(np.mean(np.linalg.norm(points - middle, axis=1) > radius_m)))
    assert np.mean(lost) < 0.01


def test_normals_are_unit_and_face_the_camera(views: list[SceneView]) -> None:
    for view in views:
        seen = view.part_mask > 0
        normals = view.normals_camera[seen]
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-4)
        rays = view.frame.camera.rays(_pixels(seen))
        assert (np.einsum("nc,nc->n", normals, rays) <= 1e-6).all()


def test_normals_agree_with_the_noiseless_surface(views: list[SceneView]) -> None:
    agreement = []
    for view in views:
        size = view.part_mask.shape[0]
        grid = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).astype(float)
        points = view.frame.camera.backproject(grid, view.noiseless_depth_m)
        across, along = points[:-1, 1:] - points[:-1, :-1], points[1:, :-1] - points[:-1, :-1]
        cross = np.cross(along, across)
        cross /= np.linalg.norm(cross, axis=-1, keepdims=True) + 1e-12
        label = view.part_mask
        # Within one part, away from its rim: thin parts are mostly rim.
        seen = (label[:-1, :-1] > 0) & (label[:-1, :-1] == label[:-1, 1:]) & (label[:-1, :-1] == label[1:, :-1])
        agreement.append(np.abs(np.einsum("hwc,hwc->hw", cross, view.normals_camera[:-1, :-1]))[seen])
    assert np.mean(np.concatenate(agreement) > 0.99) > 0.55


def test_the_sensor_keeps_most_of_the_object_and_errs_around_the_truth(category: str, views: list[SceneView]) -> None:
    kept, errors = [], []
    for view in views:
        depth, truth = view.frame.depth_m, view.noiseless_depth_m
        assert depth.dtype == np.float32
        assert (depth >= 0).all()
        np.testing.assert_allclose(depth * 1000, np.round(depth * 1000), atol=1e-3)
        seen = view.part_mask > 0
        kept.append(np.mean(depth[seen] > 0))
        measured = seen & (depth > 0)
        if measured.any():
            errors.append(np.median((depth[measured] - truth[measured]) / truth[measured]))
    assert np.median(kept) > 0.65
    assert np.mean(np.array(kept) > 0.4) > 0.85
    assert abs(np.median(errors)) < 0.004
    # Thin things are smeared with what is behind them, as stereo cameras do.
    assert np.percentile(np.abs(errors), 90) < (0.06 if category == "eyeglasses" else 0.02)


def test_masks_regions_and_shares_agree(views: list[SceneView]) -> None:
    for view in views:
        assert set(np.unique(view.part_mask)) <= set(range(len(view.truths) + 1))
        rows, columns = np.nonzero(view.part_mask)
        x, y, width, height = view.region
        assert (x, y) == (columns.min(), rows.min())
        assert (x + width - 1, y + height - 1) == (columns.max(), rows.max())
        for k, truth in enumerate(view.truths):
            assert truth.visible_px == np.count_nonzero(view.part_mask == k + 1)
            assert 0 <= truth.visible_share <= 1
    best = [max(truth.visible_share for truth in view.truths) for view in views]
    assert np.mean(np.array(best) > 0.3) > 0.9


def test_a_full_view_shows_the_same_poses_as_a_crop(category: str) -> None:
    rng = np.random.default_rng(11)
    scene = sample_scene(category, rng)
    crop, whole = training_view(scene, rng, 96), full_view(scene, rng, 320)
    assert crop.frame.color.shape == (96, 96, 3)
    height = round(scene.camera.height * 320 / scene.camera.width)
    assert whole.frame.depth_m.shape == (height, 320)
    for one, other in zip(crop.truths, whole.truths, strict=True):
        np.testing.assert_allclose(one.T_camera_part, other.T_camera_part)
        np.testing.assert_allclose(one.extents_m, other.extents_m)


def test_nothing_is_seen_beyond_the_image_of_the_camera() -> None:
    rng = np.random.default_rng(11)
    scene = sample_scene("laptop", rng)
    middle = int((scene.coverage.low[0] + scene.coverage.high[0]) / 2)
    cut = replace(scene, camera=scene.camera.cropped(0, 0, middle, scene.camera.height))
    view = training_view(cut, rng)
    camera = view.frame.camera
    rays = camera.rays(np.stack([np.arange(224.0), np.full(224, 112.0)], axis=1))
    columns = rays[:, 0] * cut.camera.K[0, 0] + cut.camera.K[0, 2]
    outside = columns >= middle - 0.5
    assert outside.any()
    assert not outside.all()
    assert not view.frame.color[:, outside].any()
    assert not view.frame.depth_m[:, outside].any()
    assert not view.part_mask[:, outside].any()
    assert view.frame.depth_m[:, ~outside].any()
    assert view.region[0] + view.region[2] <= np.flatnonzero(outside)[0]


def test_an_unknown_category_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"'box', .*'laptop'.*'teapot'"):
        sample_scene("teapot", np.random.default_rng(0))
