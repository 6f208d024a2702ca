"""The layers the network is built of: image pyramid, point levels, and the geometry-guided colour fusion."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional


class Dense(nn.Sequential):
    """Linear, layer norm, ReLU over the last dimension of (..., C).

    Not batch norm: what matters here is constant over an object's points (where it lies, how it is turned), and a
    dozen objects a batch make noisy statistics of that. Memorising 48 laptops for 250 steps left a keypoint error of
    12 % of the part's diagonal with layer norm and 15 % with batch norm.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(nn.Linear(inputs, outputs), nn.LayerNorm(outputs), nn.ReLU())


class Convolution(nn.Sequential):
    """3x3 convolution, batch norm, ReLU."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )


def gather_rows(features: Tensor, index: Tensor) -> Tensor:
    """features (B,P,C) at index (B,...) -> (B,...,C), as one flat gather (cheaper in ONNX than GatherElements)."""
    batch, count, channels = features.shape
    offset = torch.arange(batch, device=index.device).view(-1, *[1] * (index.dim() - 1)) * count
    rows = features.reshape(batch * count, channels).index_select(0, (index + offset).reshape(-1))
    return rows.view(*index.shape, channels)


def weighted_rows(features: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """Sums over the last dimension of index and weight (B,P,G) of rows of features (B,F,C): (B,P,C).

    In training the gathered rows are never written down, which with its gradient takes a quarter of the time; ONNX has
    no operator for that.
    """
    if not features.requires_grad:
        return torch.matmul(weight.unsqueeze(2), gather_rows(features, index)).squeeze(2)
    batch, count, channels = features.shape
    rows = index + torch.arange(batch, device=index.device).view(-1, 1, 1) * count
    summed = functional.embedding_bag(
        rows.flatten(0, 1),
        features.reshape(batch * count, channels),
        mode="sum",
        per_sample_weights=weight.flatten(0, 1),
    )
    return summed.view(*index.shape[:2], channels)


class GroupMaximum(torch.autograd.Function):
    """Maximum over dimension 2. The built-in one's gradient writes four tensors of the input's size; this one, one."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        values, index = x.max(dim=2, keepdim=True)
        ctx.save_for_backward(index)
        ctx.shape = x.shape
        return values.squeeze(2)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        (index,) = ctx.saved_tensors
        return gradient.new_zeros(ctx.shape).scatter_(2, index, gradient.unsqueeze(2))


def group_maximum(x: Tensor) -> Tensor:
    """(B,C) maxima over dimension 2 of (B,P,G,C)."""
    return GroupMaximum.apply(x) if x.requires_grad else x.amax(dim=2)  # pyright: ignore[reportReturnType]


def sample_bilinear(feature_map: Tensor, pixels: Tensor, image_size: int) -> Tensor:
    """Features (B,P,C) of feature_map (B,C,h,w) at crop pixels (B,P,2): p' = M p already applied (Eq. 12).

    Pixel centres are integers, so pixel c of S is at (c + 0.5) w / S - 0.5 of a map w wide. What grid_sample gives for
    the border mode, from four rows each: onnxruntime takes a fifth of GridSample's time for that.
    """
    height, width = feature_map.shape[2:]
    size = torch.tensor([width, height], dtype=pixels.dtype, device=pixels.device)
    place = ((pixels + 0.5) * (size / image_size) - 0.5).clamp_min(0.0).minimum(size - 1.0)
    corner = place.floor().minimum(size - 2.0)
    right, down = (place - corner).unbind(-1)
    column, row = corner.long().unbind(-1)
    first = row * width + column
    index = torch.stack([first, first + 1, first + width, first + width + 1], dim=-1)
    weight = torch.stack([(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down], dim=-1)
    return weighted_rows(feature_map.flatten(2).transpose(1, 2), index, weight)


class Bottleneck(nn.Module):
    """A residual block: 3x3 convolution at half the channels between two 1x1. Starts as the identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        half = channels // 2
        self.reduce = nn.Sequential(nn.Conv2d(channels, half, 1, bias=False), nn.BatchNorm2d(half), nn.ReLU(True))
        self.spread = Convolution(half, half)
        self.expand = nn.Conv2d(half, channels, 1, bias=False)
        self.norm = nn.BatchNorm2d(channels)
        nn.init.zeros_(self.norm.weight)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.norm(self.expand(self.spread(self.reduce(x)))))


class ImageBranch(nn.Module):
    """A small convolutional pyramid; gives maps at strides 4 and 8 (fine detail) and 16 (context).

    Its depth is at strides 8 and 16, where a block costs a tenth of a millisecond: back and front of a box, or base and
    lid, differ in small things (a clasp, a hinge) that have to be recognised, not only seen.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        w = width
        self.stem = nn.Sequential(Convolution(3, w, 2), Convolution(w, 2 * w, 2), Convolution(2 * w, 2 * w))
        self.stage8 = nn.Sequential(
            Convolution(2 * w, 4 * w, 2), Convolution(4 * w, 4 * w), *(Bottleneck(4 * w) for _ in range(3))
        )
        self.stage16 = nn.Sequential(Convolution(4 * w, 6 * w, 2), *(Bottleneck(6 * w) for _ in range(3)))
        self.stage32 = nn.Sequential(
            nn.Conv2d(6 * w, 6 * w, 3, 2, 1, groups=6 * w, bias=False),
            nn.Conv2d(6 * w, 6 * w, 1, bias=False),
            nn.BatchNorm2d(6 * w),
            nn.ReLU(inplace=True),
            Bottleneck(6 * w),
        )
        self.lateral32 = nn.Conv2d(6 * w, 6 * w, 1)
        self.lateral16 = nn.Conv2d(6 * w, 4 * w, 1)
        self.lateral8 = nn.Conv2d(4 * w, 2 * w, 1)
        self.channels = (2 * w, 4 * w, 6 * w)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        x4 = self.stem(image)
        x8 = self.stage8(x4)
        x16 = self.stage16(x8)
        x32 = self.stage32(x16)
        y16 = functional.relu(x16 + functional.interpolate(self.lateral32(x32), scale_factor=2.0, mode="nearest"))
        y8 = functional.relu(x8 + functional.interpolate(self.lateral16(y16), scale_factor=2.0, mode="nearest"))
        y4 = functional.relu(x4 + functional.interpolate(self.lateral8(y8), scale_factor=2.0, mode="nearest"))
        return y4, y8, y16


class SetAbstraction(nn.Module):
    """A PointNet++ level: for each centre, the maximum over its neighbours of an MLP of feature and offset.

    The first linear layer is applied to points and centres before they are gathered, which is the same sum for a
    sixteenth of the multiplications. Offsets count in `radius`, the usual reach of a neighbourhood in region radii:
    left as they are, they drown in the layer's bias and nothing local is learned.
    """

    def __init__(self, inputs: int, hidden: int, outputs: int, radius: float) -> None:
        super().__init__()
        self.radius = radius
        self.feature = nn.Linear(inputs, hidden) if inputs else None
        self.position = nn.Linear(3, hidden)
        self.edge = nn.Linear(hidden, outputs)
        self.norm = nn.LayerNorm(outputs)

    def forward(self, points: Tensor, features: Tensor | None, index: Tensor) -> Tensor:
        position = self.position(points / self.radius)
        source = position if self.feature is None or features is None else position + self.feature(features)
        # Negated before it meets every neighbour: a difference's gradient would negate a tensor as large as the edges.
        centers = self.position.bias - position[:, : index.shape[1]]
        edges = functional.relu(gather_rows(source, index) + centers.unsqueeze(2))
        return functional.relu(self.norm(group_maximum(self.edge(edges))))


def interpolate_up(fine: Tensor, coarse: Tensor, features: Tensor, index: Tensor) -> Tensor:
    """Inverse-distance interpolation of features (B,P,C) at coarse points (B,P,3) to fine points (B,F,3).

    The weights sum to one, so a linear layer may come before it, on the few coarse points, as well as after.
    """
    with torch.no_grad():
        distance = (gather_rows(coarse, index) - fine.unsqueeze(2)).square().sum(-1)
        weight = 1.0 / (distance + 1e-6)
        weight = weight / weight.sum(dim=-1, keepdim=True)
    return weighted_rows(features, index, weight)


class FeaturePropagation(nn.Module):
    """A PointNet++ feature propagation: coarse features interpolated, joined with the fine level's own, one layer."""

    def __init__(self, coarse: int, fine: int, outputs: int) -> None:
        super().__init__()
        self.from_coarse = nn.Linear(coarse, outputs, bias=False)
        self.from_fine = nn.Linear(fine, outputs)
        self.norm = nn.LayerNorm(outputs)

    def forward(
        self, fine_points: Tensor, coarse_points: Tensor, coarse: Tensor, fine: Tensor, index: Tensor
    ) -> Tensor:
        raised = interpolate_up(fine_points, coarse_points, self.from_coarse(coarse), index)
        return functional.relu(self.norm(raised + self.from_fine(fine)))


class GeometryGuidedFuser(nn.Module):
    """GC-Fuser (Eq. 13, 14): geometry decides, channel by channel, how much of the colour feature passes.

    A softmax over one logit would be the constant 1 (METHOD 5). Each channel has two logits, pass and block; their
    Gumbel-softmax is a sigmoid of the difference plus logistic noise, and without the noise it is the deterministic
    gate of inference.
    """

    def __init__(self, geometry: int, color: int, hidden: int) -> None:
        super().__init__()
        self.from_geometry = nn.Linear(geometry, hidden)
        self.from_color = nn.Linear(color, hidden)
        self.gate = nn.Linear(hidden, color)
        # Open at first: a colour branch behind closed gates gets no gradient to become useful.
        nn.init.constant_(self.gate.bias, 2.0)
        self.outputs = geometry + color

    def weights(self, geometry: Tensor, color: Tensor) -> Tensor:
        logits = self.gate(functional.relu(self.from_geometry(geometry) + self.from_color(color)))
        if self.training:
            uniform = torch.rand_like(logits).clamp(1e-4, 1.0 - 1e-4)
            logits = logits + torch.log(uniform) - torch.log1p(-uniform)
        return torch.sigmoid(logits)

    def forward(self, geometry: Tensor, color: Tensor) -> Tensor:
        return torch.cat([self.weights(geometry, color) * color, geometry], dim=-1)


class ConcatenationFuser(nn.Module):
    """Colour and geometry side by side, the paper's first alternative (Table II, IV)."""

    def __init__(self, geometry: int, color: int, hidden: int) -> None:
        super().__init__()
        del hidden
        self.outputs = geometry + color

    def forward(self, geometry: Tensor, color: Tensor) -> Tensor:
        return torch.cat([color, geometry], dim=-1)


class DenseFuser(nn.Module):
    """Both at every point, and their mean over all points after a layer of both: DenseFusion's way (Table II, V)."""

    def __init__(self, geometry: int, color: int, hidden: int) -> None:
        super().__init__()
        self.joint = nn.Sequential(Dense(geometry + color, hidden), nn.Linear(hidden, hidden))
        self.outputs = geometry + color + hidden

    def forward(self, geometry: Tensor, color: Tensor) -> Tensor:
        both = torch.cat([color, geometry], dim=-1)
        whole = self.joint(both).mean(dim=1, keepdim=True).expand(-1, both.shape[1], -1)
        return torch.cat([both, whole], dim=-1)


class GeometryAlone(nn.Module):
    """No colour at all: what depth alone is worth (Table IV)."""

    def __init__(self, geometry: int, color: int, hidden: int) -> None:
        super().__init__()
        del color, hidden
        self.outputs = geometry

    def forward(self, geometry: Tensor, color: Tensor) -> Tensor:
        del color
        return geometry


FUSERS: dict[str, type[GeometryGuidedFuser | ConcatenationFuser | DenseFuser | GeometryAlone]] = {
    "gated": GeometryGuidedFuser,
    "concatenated": ConcatenationFuser,
    "dense": DenseFuser,
    "depth": GeometryAlone,
}
