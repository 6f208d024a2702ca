"""The layers of `page_training.layers` for one object, as `edge_network` needs them: the same weights and numbers.

Values are points by channels, without a batch dimension. Shapes: P points, F of a finer or asked-for level, A answered,
G neighbours of each, C channels. What the training network writes side by side is here a list of pieces (P,C_i).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from page_training.layers import (
    ConcatenationFuser,
    Dense,
    DenseFuser,
    FeaturePropagation,
    GeometryGuidedFuser,
    SetAbstraction,
)


class CornerSampler(nn.Module):
    """`page_training.layers.sample_bilinear` for all maps at once.

    pixels (A,2) to flat places (A,4) of the four pixels around each in every map, and their weights (A,4).
    """

    scale: Tensor
    shift: Tensor
    largest: Tensor
    last_corner: Tensor
    to_index: Tensor
    steps: Tensor
    to_x: Tensor
    to_y: Tensor
    from_x: Tensor
    from_y: Tensor

    def __init__(self, image_size: int, strides: tuple[int, ...], points: int) -> None:
        super().__init__()
        widths = [image_size // stride for stride in strides]
        scale = torch.tensor([width / image_size for width in widths])
        maps = torch.eye(len(widths))
        # Columns: x and y in each map; then the corners of each map.
        self.register_buffer("scale", torch.kron(scale, torch.eye(2)))
        self.register_buffer("shift", (0.5 * scale - 0.5).repeat_interleave(2))
        largest = torch.tensor(widths, dtype=torch.float32).repeat_interleave(2) - 1.0
        # As tall as what they are compared with: one row would be broadcast row by row.
        self.register_buffer("largest", largest.repeat(points, 1))
        self.register_buffer("last_corner", largest.repeat(points, 1) - 1.0)
        to_index = torch.zeros(2 * len(widths), 4 * len(widths))
        for level, width in enumerate(widths):
            to_index[2 * level, 4 * level : 4 * level + 4] = 1.0
            to_index[2 * level + 1, 4 * level : 4 * level + 4] = width
        self.register_buffer("to_index", to_index)
        self.register_buffer("steps", torch.tensor([[0, 1, width, width + 1] for width in widths]).float().flatten())
        # Of the corners' weights: (1-x)(1-y), x(1-y), (1-x)y, xy.
        self.register_buffer("to_x", torch.kron(maps, torch.tensor([[-1.0, 1, -1, 1], [0, 0, 0, 0]])))
        self.register_buffer("to_y", torch.kron(maps, torch.tensor([[0, 0, 0, 0], [-1.0, -1, 1, 1]])))
        self.register_buffer("from_x", torch.tensor([1.0, 0, 1, 0]).repeat(len(widths)))
        self.register_buffer("from_y", torch.tensor([1.0, 1, 0, 0]).repeat(len(widths)))

    def forward(self, pixels: Tensor) -> list[tuple[Tensor, Tensor]]:
        place = torch.minimum(functional.relu(torch.addmm(self.shift, pixels, self.scale)), self.largest)
        corner = torch.minimum(place.floor(), self.last_corner)
        inside = place - corner
        weight = torch.addmm(self.from_x, inside, self.to_x) * torch.addmm(self.from_y, inside, self.to_y)
        # Whole numbers below 2^24: exact in float32.
        index = torch.addmm(self.steps, corner, self.to_index).to(torch.int32)
        return list(zip(index.split(4, dim=1), weight.split(4, dim=1), strict=True))


def weighted(rows: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """(F,C): sums of G rows of (P,C) at index (F,G), by weight (F,G)."""
    return (weight.unsqueeze(1) @ functional.embedding(index, rows)).squeeze(1)


def affine(weight: Tensor, bias: Tensor) -> Tensor:
    """(I+1,O), whose product with [x, 1] is the layer's of x (P,I)."""
    return torch.cat([weight.t(), bias[None]])


def summed(weight: Tensor, pieces: list[Tensor]) -> Tensor:
    """Products of pieces (P,C_i) side by side with weight (O, sum of C_i)."""
    weights = weight.split([piece.shape[1] for piece in pieces], dim=1)
    first, *others = (piece @ part.t() for piece, part in zip(pieces, weights, strict=True))
    return sum(others, start=first)


def linear(layer: nn.Linear, pieces: list[Tensor]) -> Tensor:
    """The layer of pieces (P,C_i) side by side."""
    return summed(layer.weight, pieces) + layer.bias


def dense(layer: nn.Module, pieces: list[Tensor]) -> Tensor:
    """`Dense` of pieces side by side."""
    assert isinstance(layer, Dense)
    product, norm = layer[0], layer[1]
    assert isinstance(product, nn.Linear)
    return functional.relu(norm(linear(product, pieces)))


def dense_with_places(layer: nn.Module, features: Tensor, places: Tensor, scale: float) -> Tensor:
    """`Dense` of features (P,C) and, side by side, coordinates counted in `scale`: those of places (P,4), [x, 1]."""
    assert isinstance(layer, Dense)
    product, norm = layer[0], layer[1]
    assert isinstance(product, nn.Linear)
    weight = product.weight
    return functional.relu(norm(features @ weight[:, :-3].t() + places @ affine(weight[:, -3:] / scale, product.bias)))


def fused(fuser: nn.Module, geometry: Tensor, color: Tensor) -> list[Tensor]:
    """What a fuser gives, in pieces."""
    if isinstance(fuser, GeometryGuidedFuser):
        bias = fuser.from_geometry.bias + fuser.from_color.bias
        hidden = functional.linear(geometry, fuser.from_geometry.weight, bias)
        hidden = torch.addmm(hidden, color, fuser.from_color.weight.t())
        return [torch.sigmoid(fuser.gate(functional.relu(hidden))) * color, geometry]
    if isinstance(fuser, ConcatenationFuser):
        return [color, geometry]
    if isinstance(fuser, DenseFuser):
        widths = [color.shape[1], geometry.shape[1]]
        widths.append(fuser.outputs - sum(widths))
        return list(fuser(geometry[None], color[None])[0].split(widths, dim=1))
    return [fuser(geometry, color)]


def abstracted(layer: SetAbstraction, places: Tensor, features: list[Tensor], index: Tensor) -> Tensor:
    """`SetAbstraction` of places (P,4), [x, 1], with features (P,C_i), index (F,16)."""
    count, group = index.shape
    weight = layer.position.weight / layer.radius
    bias = layer.position.bias if layer.feature is None else layer.position.bias + layer.feature.bias
    source = places @ affine(weight, bias)
    if layer.feature is not None:
        source = source + summed(layer.feature.weight, features)
    centers = places[:count, :3] @ weight.t()
    edges = functional.relu(functional.embedding(index, source) - centers.unsqueeze(1))
    # The bias is the same for all neighbours: once a group, after their maximum.
    edges = (edges.view(group * count, -1) @ layer.edge.weight.t()).view(count, group, -1)
    return functional.relu(layer.norm(edges.amax(dim=1) + layer.edge.bias))


def interpolated(fine: Tensor, coarse: Tensor, features: Tensor, index: Tensor) -> Tensor:
    """`page_training.layers.interpolate_up` for one object."""
    difference = functional.embedding(index.t(), coarse) - fine
    weight = 1.0 / ((difference * difference).sum(dim=-1) + 1e-6)
    return weighted(features, index, (weight / weight.sum(dim=0, keepdim=True)).t())


def propagated(
    layer: FeaturePropagation,
    fine_points: Tensor,
    coarse_points: Tensor,
    coarse: Tensor,
    fine: list[Tensor],
    index: Tensor,
) -> Tensor:
    """`FeaturePropagation` with the fine level's own features in pieces."""
    before = coarse @ layer.from_coarse.weight.t() + layer.from_fine.bias
    total = interpolated(fine_points, coarse_points, before, index) + summed(layer.from_fine.weight, fine)
    return functional.relu(layer.norm(total))
