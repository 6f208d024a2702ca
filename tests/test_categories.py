"""The runtime on every category, given perfect answers of a network about rendered frames: 2, 3, 4 and 7 parts, hinges
and slides. What is wrong then is the runtime's own."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from page_runtime.bundle import BundleMetadata
from page_runtime.category import Category
from page_runtime.evaluation import joint_errors, part_errors
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import apply, transform_from
from page_runtime.mirror import MIRROR, mirrored_pose, mirrored_sample
from page_runtime.network import NetworkOutput
from page_runtime.overlay import draw
from page_runtime.part_poses import MIN_PART_POINTS, pose_from_output
from page_runtime.pose import ArticulatedPose
from page_runtime.recorded import PartTruth, RecordedFrame
from page_runtime.sampling import RegionSample, sample_region
from page_runtime.schema import json_line, pose_record
from page_runtime.validation.figures import figures_of
from page_training.categories import CATEGORIES, category_named
from page_training.record import recorded_frame
from page_training.scenes import SceneView, full_view, sample_scene
from page_training.scenes.kinds import scene_category
from page_training.templates import part_templates

FRAMES = 4


@dataclass(frozen=True, eq=False, slots=True)
class Seen:
    """A rendered frame without noise, what was sampled of it, the parts of the sampled points, and truth."""

    recorded: RecordedFrame
    sample: RegionSample
    labels: np.ndarray
    truths: tuple[PartTruth, ...]


def seen_frames(category: Category) -> list[Seen]:
    rng = np.random.default_rng(21)
    found = []
    while len(found) < FRAMES:
        view: SceneView = full_view(sample_scene(category.name, rng), rng, 480)
        exact = RgbdFrame(view.frame.color, view.noiseless_depth_m, view.frame.camera)
        recorded = recorded_frame(replace(view, frame=exact), category, rng)
        (instance,) = recorded.instances
        assert instance.region is not None
        assert instance.truths is not None
        sample = sample_region(
            exact, instance.region, image_size=224, num_points=2048, radius_m=category.region_radius_m
        )
        if isinstance(sample, str):
            continue
        labels = view.part_mask.ravel()[sample.source_index].astype(int) - 1
        if np.count_nonzero(labels >= 0) >= 4 * MIN_PART_POINTS:
            found.append(Seen(recorded, sample, labels, instance.truths))
    return found


def perfect_output(
    category: Category, sample: RegionSample, labels: np.ndarray, truths: tuple[PartTruth, ...]
) -> NetworkOutput:
    """What a network says that makes no mistake, but does not say on which side of a surface a keypoint is."""
    points = sample.points_camera.astype(float)
    count = len(category.parts)
    radii = np.zeros((len(points), category.num_keypoints))
    for k, (part, truth) in enumerate(zip(category.parts, truths, strict=True)):
        own = labels == k
        keypoints = apply(truth.T_camera_part, np.linalg.norm(truth.extents_m) * part.keypoints_unit)
        radii[own] = np.linalg.norm(points[own, None] - keypoints, axis=2)
    logits = 20.0 * np.eye(count + 1)[np.where(labels < 0, count, labels)]
    extents = np.array([truth.extents_m for truth in truths])
    sides = np.zeros((len(points), category.num_voted), np.float32)
    return NetworkOutput(logits.astype(np.float32), radii.astype(np.float32), sides, extents.astype(np.float32))


def in_the_mirror(category: Category, truths: tuple[PartTruth, ...]) -> tuple[PartTruth, ...]:
    """Truths of the object that a mirror shows: T' = M T F, parts in their images' places."""
    assert category.mirror is not None
    order, F = category.mirror.order(len(truths)), np.diag(category.mirror.reversal)
    images = []
    for part, other in zip(category.parts, (truths[k] for k in order), strict=True):
        T = other.T_camera_part
        R = np.diag(MIRROR) @ T[:3, :3] @ F
        images.append(replace(other, name=part.name, T_camera_part=transform_from(R, MIRROR * T[:3, 3])))
    return tuple(images)


def metadata_of(category: Category) -> BundleMetadata:
    return BundleMetadata(category, 2048, 224, 0.005, 18, category.joints_mirror, {})


@pytest.fixture(scope="module", params=sorted(CATEGORIES))
def category(request: pytest.FixtureRequest) -> Category:
    return category_named(request.param)


@pytest.fixture(scope="module")
def frames(category: Category) -> list[Seen]:
    return seen_frames(category)


def with_enough_points(seen: Seen, truths: tuple[PartTruth, ...]) -> tuple[PartTruth, ...]:
    counts = [np.count_nonzero(seen.labels[: seen.sample.num_distinct] == k) for k in range(len(truths))]
    return tuple(
        replace(truth, visible_share=1.0 if count >= 3 * MIN_PART_POINTS else 0.0)
        for truth, count in zip(truths, counts, strict=True)
    )


def require_right(category: Category, seen: Seen, pose: ArticulatedPose) -> list[float]:
    """Every part with enough points has its pose and every joint between such parts its state, but for what the joints
    of the category know worse than a perfect network; rotation errors in degrees."""
    truths = with_enough_points(seen, seen.truths)
    rotations = []
    for error in part_errors(category, pose, truths):
        assert error.rotation_rad is not None
        assert error.translation_m is not None
        assert error.translation_m < 0.03 * error.diagonal_m
        rotations.append(float(np.degrees(error.rotation_rad)))
    everything = [replace(truth, visible_share=1.0) for truth in seen.truths]
    for joint, error in zip(category.joints, joint_errors(category, pose, everything), strict=True):
        visible = {truth.name for truth in truths if truth.visible_share}
        if {category.parts[k].name for k in (joint.parent, joint.child)} <= visible:
            assert error.error is not None
            # A slide's state counts from where the category's joint is on the mean, the instance's handles or not.
            assert error.error < (0.06 if joint.kind == "prismatic" else np.radians(3.0))
    return rotations


def test_perfect_answers_give_the_poses_and_states(category: Category, frames: list[Seen]) -> None:
    rotations = []
    for seen in frames:
        output = perfect_output(category, seen.sample, seen.labels, seen.truths)
        pose = pose_from_output(metadata_of(category), seen.sample, output)
        rotations += require_right(category, seen, pose)
        line = json.loads(json_line(pose_record(pose, frame=0, timestamp_s=0.0)))
        assert [part["name"] for part in line["parts"]] == [part.name for part in category.parts]
        assert [joint["name"] for joint in line["joints"]] == [joint.name for joint in category.joints]
        picture = draw(seen.recorded.frame, [(seen.recorded.instances[0], pose)], with_truth=True)
        assert not np.array_equal(picture, seen.recorded.frame.color)
    assert np.median(rotations) < 0.6
    assert max(rotations) < 3.0


def test_perfect_answers_about_the_mirror_image_give_the_same(category: Category, frames: list[Seen]) -> None:
    assert category.mirror is not None
    order = category.mirror.order(len(category.parts))
    renamed = np.array([*order, -1])
    rotations = []
    for seen in frames[:3]:
        sample, truths = mirrored_sample(seen.sample), in_the_mirror(category, seen.truths)
        output = perfect_output(category, sample, renamed[seen.labels], truths)
        pose = mirrored_pose(pose_from_output(metadata_of(category), sample, output), category)
        rotations += require_right(category, seen, pose)
    assert np.median(rotations) < 0.6


def test_templates_of_every_part_fit_perfect_poses(category: Category, frames: list[Seen]) -> None:
    sample_object = scene_category(category.name).sample_object
    templates = part_templates(sample_object, np.random.default_rng(0), instances=8, points=256)
    parts = tuple(replace(part, template=one) for part, one in zip(category.parts, templates, strict=True))
    fitted = replace(category, parts=parts)
    for part, template in zip(category.parts, templates, strict=True):
        assert (np.abs(template.points_unit) <= template.extents_unit / 2 + 1e-6).all()
        np.testing.assert_allclose(template.extents_unit, part.extents_unit, atol=0.15)
    seen = frames[0]
    pose = pose_from_output(
        metadata_of(fitted), seen.sample, perfect_output(fitted, seen.sample, seen.labels, seen.truths)
    )
    for error in part_errors(fitted, pose, with_enough_points(seen, seen.truths)):
        assert error.rotation_rad is not None
        assert np.degrees(error.rotation_rad) < 4.0


def test_figures_name_every_part_and_joint(category: Category, frames: list[Seen]) -> None:
    compared = []
    for seen in frames[:2]:
        output = perfect_output(category, seen.sample, seen.labels, seen.truths)
        compared.append((pose_from_output(metadata_of(category), seen.sample, output), seen.truths))
    figures = figures_of(category, compared)
    assert [part["name"] for part in figures["parts"]] == [part.name for part in category.parts]
    assert [joint["unit"] for joint in figures["joints"]] == [
        "m" if joint.kind == "prismatic" else "deg" for joint in category.joints
    ]
