"""The network, its targets and its training: laws that hold before any weight is learned."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from page_runtime.category_document import category_document
from page_training.batches import make_batch
from page_training.cache import make_shard
from page_training.categories import CATEGORIES, category_named
from page_training.checkpoint import keep_weights, load_checkpoint, load_start, save_checkpoint, trained_category
from page_training.config import Augmentation, TrainingConfig
from page_training.layers import GeometryGuidedFuser, gather_rows, group_maximum, sample_bilinear, weighted_rows
from page_training.losses import MIN_PART_POINTS, page_loss, part_weights
from page_training.network import NetworkOutputs, network_for
from page_training.records import open_shards, record_type, shard_path
from page_training.train import train

BOX = CATEGORIES["box"]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("cache")
    for split, shard in (("train", 0), ("validation", 0)):
        make_shard(BOX, split, shard, shard_path(root, "box", split, shard), size=12)
    return root


def batch_of(cache: Path, augmentation: Augmentation | None, seed: int = 0):
    records = np.array(open_shards(cache, "box", "train")[0])
    generator = torch.Generator().manual_seed(seed)
    return records, make_batch(records, BOX, dense_points=256, generator=generator, augmentation=augmentation)


def test_targets_without_augmentation_are_the_truth(cache: Path) -> None:
    records, batch = batch_of(cache, None)
    unit = BOX.region_radius_m
    for row in range(len(records)):
        for k, part in enumerate(BOX.parts):
            T = records["T_center_part"][row, k].astype(float)
            kappa = part.keypoints_unit * np.linalg.norm(records["extents_m"][row, k])
            keypoints = kappa @ T[:3, :3].T + T[:3, 3]
            member = batch.targets.labels[row] == k
            points = records["points"][row][batch.dense[row][member]]
            radii = np.linalg.norm(points[:, None] - keypoints, axis=2)
            np.testing.assert_allclose(batch.targets.radii[row][member] * unit, radii, atol=1e-4)


def test_augmentation_keeps_radii_those_of_a_part_of_the_same_hand(cache: Path) -> None:
    _, batch = batch_of(cache, Augmentation(flip_probability=0.5), seed=5)
    points = torch.take_along_dim(batch.inputs.points, batch.dense.unsqueeze(-1), dim=1)
    radii = (batch.targets.keypoints - points.unsqueeze(2)).norm(dim=-1)
    torch.testing.assert_close(radii, batch.targets.radii, atol=1e-5, rtol=1e-4)
    kappa = torch.from_numpy(BOX.parts[0].keypoints_unit).float()
    canonical = torch.linalg.det(kappa[[1, 2, 3]] - kappa[0])
    for row in range(len(points)):
        first = (batch.targets.labels[row] == 0).nonzero().flatten()[:1]
        if len(first) == 0:
            continue
        seen = batch.targets.keypoints[row, first[0]]
        scale = batch.targets.diagonals[row, 0]
        torch.testing.assert_close(torch.cdist(seen, seen), scale * torch.cdist(kappa, kappa), atol=1e-4, rtol=1e-3)
        assert torch.sign(torch.linalg.det(seen[[1, 2, 3]] - seen[0])) == torch.sign(canonical)


def test_pixels_follow_a_flip(cache: Path) -> None:
    never = dict.fromkeys(("gain_sigma", "tint_sigma", "offset_sigma", "noise_sigma", "scale_sigma"), 0.0)
    chance = dict.fromkeys(("shuffle_probability", "gray_probability", "blank_probability", "turn_sigma_rad"), 0.0)
    _, plain = batch_of(cache, None)
    _, flipped = batch_of(cache, Augmentation(flip_probability=1.0, **never, **chance))
    colors = [sample_bilinear(b.inputs.image, b.inputs.pixels, 224) for b in (plain, flipped)]
    torch.testing.assert_close(colors[0], colors[1], atol=1e-4, rtol=0)
    torch.testing.assert_close(flipped.inputs.points[..., 0], -plain.inputs.points[..., 0])


def test_colour_is_sampled_as_torch_samples_a_grid() -> None:
    generator = torch.Generator().manual_seed(0)
    feature_map = torch.randn(3, 5, 14, 28, generator=generator)
    # Beyond the picture, too: its border goes on there.
    pixels = torch.rand(3, 100, 2, generator=generator) * 240 - 8
    grid = ((2.0 * pixels + 1.0) / 224 - 1.0).unsqueeze(1)
    expected = torch.nn.functional.grid_sample(feature_map, grid, padding_mode="border", align_corners=False)
    torch.testing.assert_close(
        sample_bilinear(feature_map, pixels, 224), expected.squeeze(2).transpose(1, 2), atol=1e-5, rtol=0
    )


def test_loss_is_zero_exactly_at_the_truth(cache: Path) -> None:
    _, batch = batch_of(cache, None)
    targets = batch.targets
    sure = 50.0
    outputs = NetworkOutputs(
        part_logits=sure * torch.nn.functional.one_hot(targets.labels, 3).float(),
        radii=targets.radii,
        side_logits=sure * (2 * targets.sides - 1),
        log_extents=targets.extents_m.log(),
        keypoints=targets.keypoints,
        coarse_logits=sure * torch.nn.functional.one_hot(targets.coarse_labels, 3).float(),
        part_keypoints=(targets.part_keypoints,),
    )
    assert float(page_loss(outputs, targets)["total"]) < 1e-6
    shifted = replace(outputs, radii=targets.radii + 0.01)
    assert float(page_loss(shifted, targets)["radius"]) > 0.05


def test_every_part_weighs_the_same_whatever_its_number_of_points() -> None:
    labels = torch.tensor([[0] * 90 + [1] * 10 + [2] * 50, [1] * 100 + [2] * 50])
    weights = part_weights(labels, 2)
    sums = [float(weights[row][labels[row] == part].sum()) for row, part in ((0, 0), (0, 1), (1, 1))]
    assert sums == pytest.approx([1 / 3] * 3)
    assert float(weights[labels == 2].abs().sum()) == 0
    few = torch.tensor([[0] * (MIN_PART_POINTS - 1) + [2] * 20])
    assert float(part_weights(few, 2).sum()) == 0


def test_the_gate_varies_between_points_and_channels_and_is_deterministic_at_inference() -> None:
    torch.manual_seed(0)
    fuser = GeometryGuidedFuser(16, 8, 12)
    geometry, color = torch.randn(2, 30, 16), torch.randn(2, 30, 8)
    fuser.eval()
    gate = fuser.weights(geometry, color)
    assert gate.std(dim=1).min() > 1e-3
    assert ((gate > 0) & (gate < 1)).all()
    torch.testing.assert_close(gate, fuser.weights(geometry, color), rtol=0, atol=0)
    fuser.train()
    assert (fuser.weights(geometry, color) - fuser.weights(geometry, color)).abs().max() > 0.1


def test_gathering_and_maximum_equal_their_plain_forms() -> None:
    torch.manual_seed(0)
    features = torch.randn(3, 20, 5, dtype=torch.double, requires_grad=True)
    index = torch.randint(20, (3, 7, 4))
    gathered = gather_rows(features, index)
    expected = torch.stack([features[b][index[b]] for b in range(3)])
    torch.testing.assert_close(gathered, expected)
    torch.testing.assert_close(group_maximum(gathered), expected.amax(dim=2))
    assert torch.autograd.gradcheck(lambda x: group_maximum(gather_rows(x, index)), (features,))
    weight = torch.rand(3, 7, 4, dtype=torch.double)
    for given in (features, features.detach()):
        torch.testing.assert_close(weighted_rows(given, index, weight), (gathered * weight.unsqueeze(-1)).sum(dim=2))
    assert torch.autograd.gradcheck(lambda x: weighted_rows(x, index, weight), (features,))


def test_dense_subset_gives_the_same_numbers_as_all_points(cache: Path) -> None:
    _, batch = batch_of(cache, None)
    network = network_for(BOX).eval()
    with torch.no_grad():
        every, some = network(batch.inputs), network(batch.inputs, batch.dense)
    for name in ("part_logits", "radii", "side_logits"):
        whole = getattr(every, name)
        picked = torch.take_along_dim(whole, batch.dense.unsqueeze(-1), dim=1)
        torch.testing.assert_close(getattr(some, name), picked, atol=1e-4, rtol=1e-4)


def test_an_interrupted_run_ends_where_an_uninterrupted_one_does(cache: Path, tmp_path: Path) -> None:
    config = TrainingConfig("box", samples=16, batch_size=4, dense_points=64, save_every=1, validate_every=4)

    class Interrupted(Exception):
        pass

    def stop_at_two(report) -> None:
        if report.step == 2:
            raise Interrupted

    whole = load_checkpoint(train(config, BOX, cache, tmp_path / "whole", lambda _: None))
    with pytest.raises(Interrupted):
        train(config, BOX, cache, tmp_path / "parts", stop_at_two)
    parts = load_checkpoint(train(config, BOX, cache, tmp_path / "parts", lambda _: None))
    assert parts["step"] == whole["step"] == 4
    for name, value in whole["average"].items():
        torch.testing.assert_close(parts["average"][name], value, rtol=1e-4, atol=1e-5)


def test_kept_weights_start_a_run_and_a_wrong_file_is_refused(cache: Path, tmp_path: Path) -> None:
    config = TrainingConfig("box", samples=4, batch_size=4, dense_points=64, learning_rate=0.0)
    first = train(config, BOX, cache, tmp_path / "first", lambda _: None)
    keep_weights(first, tmp_path / "kept.pt")
    assert (tmp_path / "kept.pt").stat().st_size < 0.4 * first.stat().st_size
    started = replace(config, start_from=str(tmp_path / "kept.pt"), seed=9)
    again = load_checkpoint(train(started, BOX, cache, tmp_path / "again", lambda _: None))
    kept = load_checkpoint(tmp_path / "kept.pt")
    assert again["samples"] == 8
    for name, parameter in network_for(BOX).named_parameters():
        torch.testing.assert_close(again["average"][name], kept["average"][name], msg=f"{name} {parameter.shape}")
    assert trained_category(kept).name == "box"
    with pytest.raises(ValueError, match="trained for 'box'"):
        load_checkpoint(tmp_path / "kept.pt", CATEGORIES["laptop"])
    moved = replace(BOX, parts=tuple(replace(p, keypoints_unit=1.1 * p.keypoints_unit) for p in BOX.parts))
    with pytest.raises(ValueError, match="other parts, keypoints"):
        load_checkpoint(tmp_path / "kept.pt", moved)
    with pytest.raises(ValueError, match="begun with other seed"):
        train(replace(started, seed=8), BOX, cache, tmp_path / "again", lambda _: None)
    foreign = {name: value for name, value in kept.items() if name != "average"}
    save_checkpoint(tmp_path / "foreign.pt", average=dict(list(kept["average"].items())[1:]), **foreign)
    with pytest.raises(ValueError, match="another network"):
        train(
            replace(config, start_from=str(tmp_path / "foreign.pt")), BOX, cache, tmp_path / "foreign", lambda _: None
        )
    (tmp_path / "cut.pt").write_bytes((tmp_path / "kept.pt").read_bytes()[:5000])
    with pytest.raises(ValueError, match="cannot read"):
        load_checkpoint(tmp_path / "cut.pt")


def test_training_without_frames_says_how_to_make_them(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="page-train scenes"):
        train(TrainingConfig("box", samples=4), BOX, tmp_path, tmp_path / "run", lambda _: None)


def test_an_unknown_category_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"box, .*laptop"):
        category_named("teapot")


def test_shards_are_repeatable_and_splits_differ(cache: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.npy"
    make_shard(BOX, "train", 0, again, size=3)
    first = np.array(open_shards(cache, "box", "train")[0][:3])
    assert np.load(again).tobytes() == first.tobytes()
    other = open_shards(cache, "box", "validation")[0]
    assert other["extents_m"][0].tolist() != first["extents_m"][0].tolist()
    assert first.dtype == record_type(2)


def test_another_categorys_weights_start_a_run_but_for_what_depends_on_its_parts(tmp_path: Path) -> None:
    box, eyeglasses = network_for(BOX), network_for(category_named("eyeglasses"))
    document = json.dumps(category_document(BOX))
    save_checkpoint(tmp_path / "box.pt", average=box.state_dict(), category=document, config="{}", step=3, samples=36)
    before = {name: value.clone() for name, value in eyeglasses.state_dict().items()}
    assert load_start(eyeglasses, category_named("eyeglasses"), tmp_path / "box.pt") == 0
    theirs = box.state_dict()
    for name, value in eyeglasses.state_dict().items():
        if value.shape == theirs[name].shape:
            assert torch.equal(value, theirs[name]), name
        elif name == "refiner.known.weight":
            assert torch.equal(value[:, :128], theirs[name][:, :128])
            assert torch.equal(value[:, 128:], before[name][:, 128:])
        else:
            assert torch.equal(value, before[name]), name
    assert load_start(box, BOX, tmp_path / "box.pt") == 36
    thin = replace(BOX, focused=True)
    assert load_start(box, thin, tmp_path / "box.pt") == 36
    with pytest.raises(ValueError, match=r"trained on other samples of 'box' .*--from"):
        load_checkpoint(tmp_path / "box.pt", thin)
    moved = replace(BOX, parts=tuple(replace(p, keypoints_unit=1.1 * p.keypoints_unit) for p in BOX.parts))
    with pytest.raises(ValueError, match="other parts, keypoints"):
        load_start(box, moved, tmp_path / "box.pt")
