"""Thin objects: points are taken again where a first look saw them, on the device as in training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.estimator import examine, sample_for, sampled_again
from page_runtime.focus import FEWEST, REACH, Focus, focus_on
from page_runtime.network import Network, NetworkOutput
from page_runtime.pose import PartPose
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import RegionSample, sample_region, square_region
from page_runtime.sessions import DeadlineExceeded
from page_training.categories import CATEGORIES
from page_training.datasets.labelled import LabelledInstance
from page_training.datasets.samples import records_of
from page_training.focusing import MISSED_SHARE, guessed_focus, samples_of_region
from page_training.scenes.kinds import scene_category
from page_training.thinness import are_thin, part_shares
from toy import CATEGORY, toy_frame
from watched_network import WatchedNetwork

THIN = replace(CATEGORY, focused=True)


def sampled(frame, region, focus: Focus | None = None, num_points: int = 512) -> RegionSample:
    sample = sample_region(frame, region, image_size=224, num_points=num_points, radius_m=0.42, focus=focus)
    assert not isinstance(sample, str)
    return sample


def pixels_of(sample: RegionSample, width: int) -> np.ndarray:
    rows, columns = np.divmod(sample.source_index[: sample.num_distinct], width)
    return np.stack([columns, rows], axis=1)


@given(st.integers(0, 2**32 - 1), st.floats(2.0, 30.0))
@settings(max_examples=25, deadline=None)
def test_points_within_reach_come_first_each_kind_in_its_own_order(seed: int, reach_px: float) -> None:
    rng = np.random.default_rng(seed)
    recorded, _ = toy_frame()
    frame, region = recorded.frame, recorded.instances[0].region
    assert region is not None
    x, y, side, _ = square_region(region)
    seen = rng.integers((x, y), (x + side, y + side), (rng.integers(1, 20), 2)).astype(np.float32)
    everything = pixels_of(sampled(frame, region, num_points=224 * 224), frame.camera.width)
    focus = Focus(seen, np.zeros(len(seen), np.intp), reach_px)
    focused = pixels_of(sampled(frame, region, focus, num_points=224 * 224), frame.camera.width)
    away = np.linalg.norm(everything[:, None] - seen[None], axis=2).min(axis=1)
    assert len(focused) == len(everything)
    # Reach is told to a cell of the lattice, a pixel and a half at most, and to a fiftieth.
    sure = everything[away < 0.98 * reach_px - 3]
    order = {tuple(pixel): k for k, pixel in enumerate(focused.tolist())}
    places = [order[tuple(pixel)] for pixel in sure.tolist()]
    assert places == sorted(places)
    others = [order[tuple(pixel)] for pixel in everything[away > 1.02 * reach_px + 3].tolist()]
    assert others == sorted(others)
    assert not places or not others or max(places) < min(others)


@pytest.mark.parametrize("side", [97, 120, 224, 240, 269, 300, 400])
def test_every_pixel_of_the_lattice_lies_in_its_own_cell(side: int) -> None:
    grid = min(side, 224) // 16 * 16
    lattice = np.floor((np.arange(grid) + 0.5) * (side / grid))
    seen = np.stack([lattice + 7, lattice + 9], axis=1).astype(np.float32)
    focus = Focus(seen, np.zeros(grid, np.intp), 0.01)
    ordered = focus.in_order(np.arange(grid * grid), (7, 9, side, side), grid)
    assert ordered[:grid].tolist() == [k * (grid + 1) for k in range(grid)]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_small_parts_get_more_than_their_share_and_every_prefix_as_much(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid, square = 96, (10, 20, 192, 192)
    seen = [rng.integers((10, 20), (202, 212), (count, 2)).astype(np.float32) for count in (3, 40)]
    focus = focus_on(seen, 192)
    assert focus is not None
    cells = rng.permutation(grid * grid)
    ordered = focus.in_order(cells, square, grid)
    assert sorted(ordered) == list(range(grid * grid))
    at = np.stack([ordered % grid, ordered // grid], axis=1) * 2.0 + (10.5, 20.5)
    away = [np.linalg.norm(at[:, None] - own[None], axis=2).min(axis=1) for own in seen]
    near = np.minimum(*away) < 0.98 * focus.reach_px - 4
    # Where both parts are about as near, a lattice does not say whose a cell is.
    sure = near & (np.abs(away[0] - away[1]) > 6)
    first = (away[0] < away[1])[: np.flatnonzero(near).max() + 1]
    sizes = np.array([first.sum(), (~first).sum()])
    shares = np.sqrt(sizes) / np.sqrt(sizes).sum()
    half = int(0.5 * min(sizes / shares))
    assert first[:half].mean() == pytest.approx(shares[0], abs=0.12)
    for k in range(2):
        own = ordered[sure & (away[k] < away[1 - k])]
        place = {cell: index for index, cell in enumerate(cells.tolist())}
        assert [place[cell] for cell in own.tolist()] == sorted(place[cell] for cell in own.tolist())


def test_a_focus_elsewhere_changes_nothing() -> None:
    recorded, _ = toy_frame()
    region = recorded.instances[0].region
    assert region is not None
    elsewhere = Focus(np.full((9, 2), -1000, np.float32), np.zeros(9, np.intp), 10.0)
    one, other = sampled(recorded.frame, region), sampled(recorded.frame, region, elsewhere)
    np.testing.assert_array_equal(one.source_index, other.source_index)
    assert other.focus is elsewhere


def test_points_too_few_to_be_an_object_are_no_focus() -> None:
    one, others = np.zeros((1, 2), np.float32), np.zeros((FEWEST - 2, 2), np.float32)
    assert focus_on([one, others], 100) is None
    focus = focus_on([one, others, one], 100)
    assert focus is not None
    assert focus.parts.tolist() == [0, *[1] * len(others), 2]
    assert focus.reach_px == pytest.approx(100 * REACH)


def true_members(sample: RegionSample, masks, answered: int) -> list[np.ndarray]:
    """What a network would say that knows the parts of all points."""
    return [np.flatnonzero(mask.ravel()[sample.source_index[:answered]]) for mask in masks]


def test_a_second_sample_has_the_object_and_little_else(oracle_bundle) -> None:
    metadata = replace(Network(oracle_bundle).metadata, category=THIN)
    recorded, masks = toy_frame()
    x, y, w, h = recorded.instances[0].region or (0, 0, 0, 0)
    wide = (x - 80, y - 80, w + 160, h + 160)
    first = sample_for(metadata, recorded.frame, wide)
    assert isinstance(first, RegionSample)
    members = true_members(first, masks, 1024)
    second = sampled_again(metadata, recorded.frame, wide, first, members)
    assert second is not None
    shares = [np.any(masks, axis=0).ravel()[one.source_index[:1024]].mean() for one in (first, second)]
    assert shares[1] > 1.5 * shares[0]
    nothing = [own[:0] for own in members]
    assert sampled_again(metadata, recorded.frame, wide, first, nothing) is None
    broad = replace(metadata, category=CATEGORY)
    assert sampled_again(broad, recorded.frame, wide, first, members) is None


@pytest.mark.parametrize("focused", [False, True])
def test_a_thin_object_is_looked_at_twice(oracle_bundle, focused: bool) -> None:
    network = WatchedNetwork(oracle_bundle, focused=focused)
    recorded: RecordedFrame = toy_frame()[0]
    region = recorded.instances[0].region
    assert region is not None
    examined = examine(network, recorded.frame, region, max_looks=1)
    assert examined.sample is network.samples[-1]
    assert network.focused() == [False, True][: 1 + focused]


class Nearsighted(WatchedNetwork):
    """One that recognises nothing from nearby."""

    def run(self, sample: RegionSample, *arguments, **more) -> NetworkOutput:
        output = super().run(sample, *arguments, **more)
        if sample.focus is None:
            return output
        return replace(output, part_logits=np.tile(np.array([0, 0, 1], np.float32), (len(output.part_logits), 1)))


def test_what_is_not_recognised_from_nearby_is_what_the_first_sample_showed(oracle_bundle) -> None:
    network = Nearsighted(oracle_bundle, focused=True)
    recorded = toy_frame()[0]
    region = recorded.instances[0].region
    assert region is not None
    examined = examine(network, recorded.frame, region, max_looks=1)
    assert examined.sample is network.samples[0]
    assert all(isinstance(part, PartPose) for part in examined.pose.parts)
    assert network.focused() == [False, True]


class Late(WatchedNetwork):
    """One whose second pass takes too long."""

    def run(self, sample: RegionSample, *arguments, **more) -> NetworkOutput:
        output = super().run(sample, *arguments, **more)
        if sample.focus is not None:
            raise DeadlineExceeded("too late")
        return output


def test_where_the_second_pass_takes_too_long_the_first_answers(oracle_bundle) -> None:
    network = Late(oracle_bundle, focused=False)
    recorded = toy_frame()[0]
    region = recorded.instances[0].region
    assert region is not None
    expected = examine(network, recorded.frame, region, max_looks=1).pose
    network.metadata = replace(network.metadata, category=THIN)
    examined = examine(network, recorded.frame, region, max_looks=1)
    assert len(network.samples) == 3
    assert examined.sample is network.samples[1]
    for one, other in zip(expected.parts, examined.pose.parts, strict=True):
        assert isinstance(one, PartPose)
        assert isinstance(other, PartPose)
        np.testing.assert_array_equal(one.T_camera_part, other.T_camera_part)


def test_a_guess_without_errors_is_the_object_itself(monkeypatch) -> None:
    monkeypatch.setattr("page_training.focusing.MISSED_SHARE", 0.0)
    monkeypatch.setattr("page_training.focusing.PIECE_PROBABILITY", 0.0)
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 224, (1024, 2)).astype(np.float32)
    labels = np.minimum(pixels[:, 0] // 30, 2).astype(np.int64)
    focus = guessed_focus(pixels, labels, 2, 224, rng)
    assert focus is not None
    np.testing.assert_array_equal(focus.pixels, np.concatenate([pixels[labels == 0], pixels[labels == 1]]))
    np.testing.assert_array_equal(focus.parts, np.sort(labels[labels < 2]))


def test_a_guess_errs_now_and_then_but_sees_most_of_the_object() -> None:
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 224, (1024, 2)).astype(np.float32)
    on_object = pixels[:, 0] < 60
    beside, missed = [], []
    for _ in range(200):
        focus = guessed_focus(pixels, np.where(on_object, 0, 1), 1, 224, rng)
        assert focus is not None
        beside.append((focus.pixels[:, 0] >= 60).sum())
        missed.append(1.0 - (focus.pixels[:, 0] < 60).sum() / on_object.sum())
    assert 0.05 < np.mean(np.array(beside) > 0) < 0.5
    assert 0.5 * MISSED_SHARE / 2 < np.mean(missed) < MISSED_SHARE
    assert guessed_focus(pixels, np.full(1024, 1), 1, 224, np.random.default_rng(3)) is None


@pytest.mark.parametrize("category", [CATEGORY, THIN], ids=["broad", "thin"])
def test_training_has_the_samples_the_runtime_takes(category) -> None:
    recorded, masks = toy_frame()
    region = recorded.instances[0].region
    assert region is not None
    part = np.where(masks[0], 0, np.where(masks[1], 1, 2)).ravel()
    samples = samples_of_region(
        category, recorded.frame, region, 0.1, lambda one: part[one.source_index], np.random.default_rng(0)
    )
    np.testing.assert_array_equal(
        samples[0].points_camera, sampled(recorded.frame, region, num_points=2048).points_camera
    )
    assert [one.focus is not None for one in samples] == [False, True][: 1 + category.focused]
    for second in samples[1:]:
        focus = second.focus
        assert focus is not None
        assert focus.reach_px == pytest.approx(REACH * square_region(region)[2])
        again = sampled(recorded.frame, region, focus, num_points=2048)
        np.testing.assert_array_equal(second.points_camera, again.points_camera)
        columns, rows = focus.pixels.astype(int).T
        on_object = part[rows * recorded.frame.camera.width + columns] < 2
        assert on_object.mean() > 0.6
    blind = replace(recorded.frame, depth_m=np.zeros_like(recorded.frame.depth_m))
    assert samples_of_region(category, blind, region, 0.1, lambda _: part[:2048], np.random.default_rng(0)) == []


def test_cuts_of_real_pictures_are_two_samples_of_a_thin_object() -> None:
    recorded, masks = toy_frame()
    (instance,) = recorded.instances
    assert instance.region is not None
    assert instance.truths is not None
    part_mask = np.where(masks[0], 1, np.where(masks[1], 2, 0)).astype(np.uint8)
    labelled = LabelledInstance(recorded.frame, instance.region, part_mask, instance.truths)
    broad, thin = (records_of(labelled, one, 3, np.random.default_rng(0)) for one in (CATEGORY, THIN))
    assert (len(broad), len(thin)) == (3, 6)
    shares = (thin["labels"] < 2).mean(axis=1)
    assert (shares[1::2] > shares[::2]).all()


@pytest.mark.parametrize("name", CATEGORIES)
def test_categories_of_thin_objects_are_those_that_say_so(name: str) -> None:
    kind, rng = scene_category(name), np.random.default_rng(0)
    objects = [(model, kind.sample_states(rng, model)) for model in (kind.sample_object(rng) for _ in range(64))]
    assert are_thin(objects, rng) == CATEGORIES[name].focused


def test_what_parts_fill_does_not_change_with_the_size_of_the_object() -> None:
    kind = scene_category("drawer")
    model = kind.sample_object(np.random.default_rng(0))
    parts = tuple(
        replace(part, mesh=replace(part.mesh, vertices=3 * part.mesh.vertices), extents_m=3 * part.extents_m)
        for part in model.parts
    )
    joints = tuple(replace(j, pivot_parent=3 * j.pivot_parent, pivot_child=3 * j.pivot_child) for j in model.joints)
    shares = [
        part_shares(one, (0.0,) * len(joints), np.random.default_rng(1))
        for one in (model, replace(model, parts=parts, joints=joints))
    ]
    np.testing.assert_allclose(shares[0], shares[1], atol=0.002)
    assert (shares[0] > 0.0).all()
    assert (shares[0] <= 1 / 1.2**2).all()
