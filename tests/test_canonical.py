"""The refiner's geometry: frames are those the keypoints stand in, whatever the pose."""

from __future__ import annotations

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from page_runtime.similarity import so3_exp
from page_training.canonical import CanonicalRefiner, PartFrames, frames_of, with_normal
from page_training.keypoints import off_surface_keypoints

UNIT = torch.from_numpy(off_surface_keypoints()).float().repeat(2, 1, 1)
INVERSE = torch.linalg.pinv(UNIT - UNIT.mean(dim=1, keepdim=True))


def similarity(seed: int, batch: int = 3) -> PartFrames:
    generator = torch.Generator().manual_seed(seed)
    turns = torch.randn(batch * 2, 3, generator=generator) * 1.5
    R = torch.from_numpy(so3_exp(turns.double().numpy())).float().view(batch, 2, 3, 3)
    scale = 0.2 + torch.rand(batch, 2, 1, 1, generator=generator)
    return PartFrames(scale * R.transpose(-1, -2), torch.randn(batch, 2, 3, generator=generator))


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_frames_are_those_the_keypoints_were_placed_by(seed: int) -> None:
    truth = similarity(seed)
    found = frames_of(truth.place(UNIT), INVERSE, UNIT)
    torch.testing.assert_close(found.axes, truth.axes, atol=2e-5, rtol=0)
    torch.testing.assert_close(found.origin, truth.origin, atol=2e-5, rtol=0)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_coordinates_undo_place(seed: int) -> None:
    frames = similarity(seed)
    points = torch.randn(len(frames.axes), 7, 3, generator=torch.Generator().manual_seed(seed + 1))
    there = frames.coordinates(points)
    torch.testing.assert_close(frames.place(there)[:, 0], points, atol=1e-4, rtol=0)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_any_keypoints_give_a_proper_rotation(seed: int) -> None:
    keypoints = torch.randn(2, 2, UNIT.shape[1], 3, generator=torch.Generator().manual_seed(seed))
    axes = frames_of(keypoints, INVERSE, UNIT).axes
    scale = axes.norm(dim=-1, keepdim=True)
    R = axes / scale
    torch.testing.assert_close(R @ R.transpose(-1, -2), torch.eye(3).expand_as(R), atol=1e-4, rtol=0)
    assert (torch.linalg.det(R) > 0).all()


def test_collapsed_keypoints_give_finite_frames() -> None:
    frames = frames_of(torch.zeros(1, 2, UNIT.shape[1], 3), INVERSE, UNIT)
    assert all(torch.isfinite(part).all() for part in frames)
    assert torch.isfinite(frames.coordinates(torch.ones(1, 4, 3))).all()


def test_a_look_is_the_same_from_everywhere() -> None:
    """Corrections are in part units: object, points and guess moved together, nothing changes."""
    torch.manual_seed(0)
    refiner = CanonicalRefiner(6, 2, UNIT.shape[1], 5)
    torch.nn.init.normal_(refiner.correction.weight)
    features, probabilities = torch.randn(3, 40, 6), torch.rand(3, 40, 3)
    known = refiner.prepared(features, probabilities)
    guess, motion = similarity(1), similarity(2)
    motion = PartFrames(motion.axes[:, :1], motion.origin[:, :1])
    points = torch.randn(3, 40, 3)
    moved = PartFrames(guess.axes @ motion.axes, motion.place(guess.origin.unsqueeze(1)).squeeze(1))
    here = refiner(guess, points, known, probabilities)
    there = refiner(moved, motion.place(points.unsqueeze(1)).squeeze(1), known, probabilities)
    torch.testing.assert_close(there, here, atol=1e-3, rtol=1e-3)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_three_keypoints_hold_a_frame_with_the_normal_of_their_triangle(seed: int) -> None:
    three = UNIT[:, :3]
    unit = with_normal(three)
    inverse = torch.linalg.pinv(unit - unit.mean(dim=1, keepdim=True))
    truth = similarity(seed)
    found = frames_of(with_normal(truth.place(three)), inverse, unit)
    torch.testing.assert_close(found.axes, truth.axes, atol=5e-5, rtol=0)
    torch.testing.assert_close(found.origin, truth.origin, atol=5e-5, rtol=0)
