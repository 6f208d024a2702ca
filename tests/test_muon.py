"""The optimizer of weight matrices: what its steps are, and that torch's own would make the same."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from page_training.muon import Muon, orthogonalized


@given(rows=st.integers(2, 24), columns=st.integers(2, 24), seed=st.integers(0, 99))
def test_singular_values_come_near_one_and_vectors_stay(rows: int, columns: int, seed: int) -> None:
    drawn = torch.randn(rows, columns, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    left, _, right = torch.linalg.svd(drawn, full_matrices=False)
    values = torch.linspace(1.0, 0.1, min(rows, columns), dtype=torch.float64)
    found = orthogonalized(left @ torch.diag(values) @ right)
    turned = left.T @ found @ right.T
    assert torch.allclose(turned, torch.diag(turned.diagonal()), atol=1e-9)
    assert turned.diagonal().min() > 0.6
    assert turned.diagonal().max() < 1.25


@pytest.mark.parametrize("shape", [(16, 40), (40, 16), (24, 24)])
def test_steps_are_those_of_torch(shape: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(3)
    start = torch.randn(*shape, generator=generator)
    gradients = [torch.randn(*shape, generator=generator) for _ in range(6)]
    ours, theirs = (nn.Parameter(start.clone()) for _ in range(2))
    optimizers = (
        Muon([ours], lr=0.02, weight_decay=0.1),
        torch.optim.Muon([theirs], lr=0.02, weight_decay=0.1, adjust_lr_fn="match_rms_adamw"),
    )
    for gradient in gradients:
        for parameter, optimizer in zip((ours, theirs), optimizers, strict=True):
            parameter.grad = gradient.clone()
            optimizer.step()
    moved = (theirs - start).norm()
    # Theirs count in bfloat16, of three digits.
    assert (ours - theirs).norm() < 0.02 * moved
    assert ours.detach().isfinite().all()


def test_a_checkpoint_of_torch_goes_on() -> None:
    generator = torch.Generator().manual_seed(5)
    start, first, second = (torch.randn(16, 20, generator=generator) for _ in range(3))
    alone, before = nn.Parameter(start.clone()), nn.Parameter(start.clone())
    earlier = torch.optim.Muon([before], lr=0.0, weight_decay=0.0, adjust_lr_fn="match_rms_adamw")
    ours, going_on = (Muon([alone], lr=0.0, weight_decay=0.0) for _ in range(2))
    for parameter, optimizer in ((alone, ours), (before, earlier)):
        parameter.grad = first.clone()
        optimizer.step()
    going_on.load_state_dict(earlier.state_dict())
    for optimizer in (ours, going_on):
        optimizer.param_groups[0]["lr"] = 0.1
    results = []
    for optimizer in (ours, going_on):
        with torch.no_grad():
            alone.copy_(start)
        alone.grad = second.clone()
        optimizer.step()
        results.append(alone.detach().clone())
    assert torch.equal(*results)


def test_a_parameter_without_gradient_stays() -> None:
    parameter = nn.Parameter(torch.ones(16, 16))
    Muon([parameter], lr=0.1, weight_decay=0.5).step()
    assert torch.equal(parameter.detach(), torch.ones(16, 16))


def test_what_is_no_matrix_is_refused() -> None:
    with pytest.raises(ValueError, match=r"expected matrices, got a parameter of shape \(4,\)"):
        Muon([nn.Parameter(torch.zeros(4))], lr=0.1, weight_decay=0.0)
