"""The baselines of the paper's kind: exact heads give exact poses, losses are least at the truth, training helps."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from benchmarks.approaches import POSE_OF, Way, trained_by
from benchmarks.baselines.anchors import AnchorOutputs
from benchmarks.baselines.bins import Bins, cross_entropy
from benchmarks.baselines.normalised import NormalisedOutputs, normalised_targets, ransac_similarity
from benchmarks.baselines.pair_votes import TOLERANCE_RAD, VOXEL
from benchmarks.baselines.pairs import ALONG, OFF, SIZE, TURN, PairOutputs, pair_truth, pairs_within, voted_axes
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.geometry import rotation_angle, transform_from
from page_runtime.pose import ArticulatedPose, NotSeen
from page_runtime.recorded import PartTruth
from page_runtime.sampling import RegionSample
from page_runtime.similarity import so3_exp
from page_training.batches import Batch, make_batch
from page_training.cache import make_shard
from page_training.categories import CATEGORIES
from page_training.evaluate import metadata_for
from page_training.losses import Targets
from page_training.network import ObjectOutputs
from page_training.records import open_shards, shard_path
from page_training.targets import Truth, targets_of
from toy import toy_camera

BOX = CATEGORIES["box"]
AXES = voted_axes(BOX)
WAYS: tuple[Way, ...] = ("anchors", "normalised", "pairs")
POINTS = 256
SURE = 60.0
# A direction takes votes from as far as the tolerance, and an axis's two may each be as far off across the other.
AXES_DEG = float(np.degrees(np.sqrt(2.0) * TOLERANCE_RAD))
# The centre is a mean over a cube of three voxels: half its diagonal.
CENTER = 1.5 * np.sqrt(3.0) * VOXEL
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> Batch:
    root = tmp_path_factory.mktemp("cache")
    make_shard(BOX, "train", 0, shard_path(root, "box", "train", 0), size=2)
    records = np.array(open_shards(root, "box", "train")[0])
    return make_batch(records, BOX, dense_points=256, generator=torch.Generator().manual_seed(0), augmentation=None)


def surface_points(extents_m: np.ndarray, rng: np.random.Generator, faces: tuple[int, ...]) -> np.ndarray:
    """(POINTS,3) on the given upper faces of a box."""
    points = (rng.random((POINTS, 3)) - 0.5) * extents_m
    face = rng.choice(faces, POINTS)
    points[np.arange(POINTS), face] = 0.5 * extents_m[face]
    return points


def posed_boxes(seed: int, faces: tuple[int, ...] = (0, 1, 2)) -> tuple[RegionSample, tuple[PartTruth, ...], Targets]:
    """Base and lid anywhere and of any plausible size, their points, and what a network should say of them."""
    rng = np.random.default_rng(seed)
    R = so3_exp(rng.normal(size=(2, 3)) * 2.0)
    t = np.array([[0.05, 0.0, 0.8], [-0.05, 0.1, 0.85]]) + 0.02 * rng.normal(size=(2, 3))
    extents = np.array([0.3, 0.2, 0.1]) * rng.uniform(0.5, 1.5, (2, 3))
    extents[1, 2] *= 0.2
    points = np.concatenate([surface_points(e, rng, faces) @ r.T + x for e, r, x in zip(extents, R, t, strict=True)])
    center = points.mean(axis=0)
    labels = np.repeat([0, 1], POINTS)

    def tensor(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.asarray(values))[None].float()

    whole = torch.from_numpy(labels)[None]
    truth = Truth(
        tensor(R), tensor(t - center), tensor(extents), whole, whole, tensor(points - center), tensor(0 * points)
    )
    sample = RegionSample(
        np.zeros((224, 224, 3), np.uint8), points.astype(np.float32), np.zeros((2 * POINTS, 2), np.float32),
        center.astype(np.float64), toy_camera(), np.arange(2 * POINTS), 2 * POINTS,
    )  # fmt: skip
    poses = tuple(
        PartTruth(part.name, transform_from(r, x), e, 1.0)
        for part, r, x, e in zip(BOX.parts, R, t, extents, strict=True)
    )
    return sample, poses, targets_of(truth, BOX)


def common_of(targets: Targets) -> dict[str, Any]:
    """What every network that is right says of the objects."""
    classes = len(BOX.parts) + 1
    return {
        "part_logits": SURE * torch.nn.functional.one_hot(targets.labels, classes).float(),
        "coarse_logits": SURE * torch.nn.functional.one_hot(targets.coarse_labels, classes).float(),
        "log_extents": targets.extents_m.log(),
        "part_keypoints": (targets.part_keypoints,) * 2,
    }


def exact_anchors(targets: Targets, rng: np.random.Generator) -> AnchorOutputs:
    """One of five anchors, at the part's origin, is picked and right; the others propose anything."""
    away = torch.from_numpy(rng.normal(size=(*targets.origins.shape[:2], 5, 3))).float()
    away[:, :, 2] = 0.0
    proposals = targets.part_keypoints.unsqueeze(2) + away.unsqueeze(3)
    attention = SURE * torch.eye(5)[2].expand(*away.shape[:3]) - 0.5 * SURE
    return AnchorOutputs(
        attention=attention, anchors=targets.origins.unsqueeze(2) + away, proposals=proposals, **common_of(targets)
    )


def exact_normalised(targets: Targets) -> NormalisedOutputs:
    return NormalisedOutputs(coordinates=normalised_targets(targets), **common_of(targets))


def exact_pairs(targets: Targets, guessed: float = 1.2) -> PairOutputs:
    """Diagonals guessed 20 % too large, or so; the labels of every pair as its logits."""
    first, second = pairs_within(targets.labels, 4, torch.Generator().manual_seed(0))
    blank = torch.zeros(*first.shape, 1)
    outputs = PairOutputs(
        first=first, second=second, owner=targets.labels.gather(1, first), guessed=guessed * targets.diagonals,
        along=blank, off=blank, turns=blank, sides=blank, sizes=blank, **common_of(targets),
    )  # fmt: skip
    truth = pair_truth(outputs, targets, AXES)

    def logits(bins: Bins, values: torch.Tensor) -> torch.Tensor:
        return bins.labels(values).clamp_min(1e-9).log()

    return replace(
        outputs, along=logits(ALONG, truth.along), off=logits(OFF, truth.off), turns=logits(TURN, truth.turns),
        sides=SURE * (2.0 * truth.sides - 1.0), sizes=logits(SIZE, truth.size),
    )  # fmt: skip


def exact_outputs(way: Way, targets: Targets) -> ObjectOutputs:
    if way == "anchors":
        return exact_anchors(targets, np.random.default_rng(0))
    return exact_normalised(targets) if way == "normalised" else exact_pairs(targets)


def errors_of(pose: ArticulatedPose, truths: tuple[PartTruth, ...]) -> np.ndarray:
    """(K,3) of each part: degrees, then translation and size as shares of its diagonal."""
    found = []
    for part, truth in zip(pose.parts, truths, strict=True):
        assert not isinstance(part, NotSeen), part.reason
        diagonal = np.linalg.norm(truth.extents_m)
        found.append((
            np.degrees(rotation_angle(part.T_camera_part[:3, :3], truth.T_camera_part[:3, :3])),
            np.linalg.norm(part.T_camera_part[:3, 3] - truth.T_camera_part[:3, 3]) / diagonal,
            np.abs(part.extents_m - truth.extents_m).max() / diagonal,
        ))  # fmt: skip
    return np.array(found)


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_the_picked_anchors_exact_keypoints_give_the_exact_pose(seed: int) -> None:
    sample, truths, targets = posed_boxes(seed)
    pose = POSE_OF["anchors"](metadata_for(BOX), sample, exact_anchors(targets, np.random.default_rng(seed)))
    assert (errors_of(pose, truths) < [1e-3, 1e-5, 1e-5]).all()


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_exact_coordinates_give_the_exact_pose_whatever_a_third_of_the_points_says(seed: int) -> None:
    sample, truths, targets = posed_boxes(seed)
    outputs = exact_normalised(targets)
    rng = np.random.default_rng(seed)
    wrong = torch.from_numpy(rng.random((1, 2 * POINTS)) < 1 / 3)
    outputs.coordinates[wrong] = torch.from_numpy(rng.uniform(-0.5, 0.5, (int(wrong.sum()), 3))).float()
    pose = POSE_OF["normalised"](metadata_for(BOX), sample, outputs)
    # What happens to be right to within the inliers' bound is fitted too.
    assert (errors_of(pose, truths) < [1.0, 0.01, 0.01]).all()
    exact = POSE_OF["normalised"](metadata_for(BOX), sample, exact_normalised(targets))
    assert (errors_of(exact, truths) < [1e-3, 1e-5, 1e-5]).all()


@given(seeds, st.sampled_from([(0, 1, 2), (0, 1)]), st.floats(0.75, 1.4))
@settings(max_examples=5, deadline=None)
def test_exact_pairs_vote_the_pose_to_within_the_accumulators_cells(
    seed: int, faces: tuple[int, ...], guessed: float
) -> None:
    sample, truths, targets = posed_boxes(seed, faces)
    pose = POSE_OF["pairs"](metadata_for(BOX), sample, exact_pairs(targets, guessed))
    assert (errors_of(pose, truths) < [AXES_DEG, CENTER, 1e-3]).all()


@given(seeds)
@settings(max_examples=3, deadline=None)
def test_from_one_face_the_sides_tell_the_axes_and_only_the_center_may_be_its_mirror_image(seed: int) -> None:
    sample, truths, targets = posed_boxes(seed, (2,))
    pose = POSE_OF["pairs"](metadata_for(BOX), sample, exact_pairs(targets))
    errors = errors_of(pose, truths)
    assert (errors[:, [0, 2]] < [AXES_DEG, 1e-3]).all()
    mirrored = tuple(
        replace(one, T_camera_part=one.T_camera_part @ transform_from(np.eye(3), np.array([0, 0, one.extents_m[2]])))
        for one in truths
    )
    assert (np.minimum(errors[:, 1], errors_of(pose, mirrored)[:, 1]) < CENTER).all()


def test_nothing_to_solve_from_is_said_in_a_sentence() -> None:
    sample, _, targets = posed_boxes(0)
    one = np.random.default_rng(0)
    assert "needs 3" in str(ransac_similarity(np.zeros((2, 3)), np.zeros((2, 3)), (0.1, 1.0), one))
    alike = ransac_similarity(np.zeros((20, 3)), one.normal(size=(20, 3)), (0.1, 1.0), one)
    assert "plausible size" in str(alike)
    pairs = exact_pairs(targets)
    pose = POSE_OF["pairs"](metadata_for(BOX), sample, replace(pairs, second=pairs.first))
    assert all(isinstance(part, NotSeen) and "far enough apart" in part.reason for part in pose.parts)
    without_lid = replace(pairs, part_logits=pairs.part_logits.roll(-1, dims=-1))
    lid = POSE_OF["pairs"](metadata_for(BOX), sample, without_lid).parts[1]
    assert isinstance(lid, NotSeen)
    assert "0 points belong to it" in lid.reason


@given(st.floats(-1.5, 1.5))
def test_bins_give_back_what_their_labels_say_and_of_two_peaks_one(value: float) -> None:
    labels = ALONG.labels(torch.tensor([value], dtype=torch.float64))
    assert float(labels.sum()) == pytest.approx(1.0)
    said = labels.clamp_min(1e-12).log().numpy()
    assert ALONG.values(said)[0] == pytest.approx(np.clip(value, -1.0, 1.0), abs=1e-6)
    other = ALONG.labels(torch.tensor([-0.9 if value > 0 else 0.9]))
    two = (0.6 * labels + 0.4 * other).clamp_min(1e-12).log().numpy()
    assert abs(ALONG.values(two)[0] - np.clip(value, -1.0, 1.0)) < 2.0 / 31
    assert float(cross_entropy(torch.from_numpy(said), labels)) == pytest.approx(0.0, abs=1e-6)


def test_pairs_are_of_one_label_and_every_point_begins_as_many() -> None:
    labels = torch.from_numpy(np.random.default_rng(0).integers(0, 3, (3, 50)))
    labels[0, 7] = 3
    first, second = pairs_within(labels, 5, torch.Generator().manual_seed(1))
    assert (labels.gather(1, first) == labels.gather(1, second)).all()
    assert (first.sort(dim=1).values == torch.arange(50).repeat_interleave(5)).all()
    alone = first[0] == 7
    assert (second[0][alone] == 7).all()
    assert (first != second)[1:].all()


@pytest.mark.parametrize("way", WAYS)
def test_a_baselines_loss_is_zero_at_the_truth_and_more_anywhere_else(way: Way, batch: Batch) -> None:
    loss = trained_by(way, BOX).loss
    outputs = exact_outputs(way, batch.targets)
    assert float(loss(outputs, batch.targets)["total"]) < 1e-4
    own = [one.name for one in fields(outputs) if one.name not in {f.name for f in fields(ObjectOutputs)}]
    given = {"anchors", "first", "second", "owner", "guessed"}
    learned = [name for name in own if name not in given]
    assert learned
    for name in learned:
        wrong = getattr(outputs, name).roll(1, dims=-1)
        assert float(loss(replace(outputs, **{name: wrong}), batch.targets)["total"]) > 0.01, name


@pytest.mark.parametrize("way", WAYS)
def test_a_few_steps_of_training_lower_every_baselines_own_loss(way: Way, batch: Batch) -> None:
    approach = trained_by(way, BOX)
    torch.manual_seed(0)
    network = approach.network(BOX, "gated")
    # What the heads start from is learned by every variant alike; here the heads alone are looked at.
    head = [p for name, p in network.named_parameters() if name.split(".")[0] in HEADS[way]]
    assert head
    optimizer = torch.optim.AdamW(head, 3e-3)
    own: list[float] = []
    for _ in range(5):
        torch.manual_seed(0)
        terms = approach.loss(network(batch.inputs, batch.dense), batch.targets)
        network.zero_grad()
        terms["total"].backward()
        assert all(p.grad is not None and bool(p.grad.isfinite().all()) for p in network.parameters())
        optimizer.step()
        own.append(float(terms["total"].detach()))
    assert own[-1] < own[0] - 0.01


HEADS = {
    "anchors": {"pooled", "placed", "part", "anchor", "attention", "offsets"},
    "normalised": {"correction"},
    "pairs": {"alone", "other", "between", "part", "pair", "said"},
}
