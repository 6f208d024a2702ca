"""The network of PAGE section V-B: image branch, point branch, geometry-guided colour fusion, and its heads.

Inputs, one object per row (B = batch, N = 2048 points, S = 224):
    image (B,3,S,S) RGB in [0,1]; points (B,N,3) centred, in units of the category's region radius, progressive order;
    pixels (B,N,2) crop pixels of the points; six neighbour tables (page_runtime.neighbours.Neighbours).
Outputs, D dense points (all N, or a random subset in training):
    part_logits (B,D,K+1), background last; radii (B,D,n) to the point's own part's keypoints, in region radii;
    side_logits (B,D,n_voted), positive where the keypoint is on the camera's side of the surface;
    log_extents (B,K,3), the parts' full sizes, log of metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from page_runtime.category import Category
from page_runtime.neighbours import LEVELS

# Spread of an object's points in region radii: positions enter beside normalised features as large as those.
POSITION_SCALE = 0.25


class NetworkInputs(NamedTuple):
    image: Tensor
    points: Tensor
    pixels: Tensor
    group1: Tensor
    group2: Tensor
    group3: Tensor
    up1: Tensor
    up2: Tensor
    up3: Tensor


@dataclass(frozen=True, slots=True)
class NetworkOutputs:
    """`keypoints` (B,D,n,3), `coarse_logits` (B,512,K+1) and `part_keypoints` (B,K,n,3) are training signals; the
    export leaves them out."""

    part_logits: Tensor
    radii: Tensor
    side_logits: Tensor
    log_extents: Tensor
    keypoints: Tensor
    coarse_logits: Tensor
    part_keypoints: Tensor


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
    return features.reshape(batch * count, channels)[(index + offset).reshape(-1)].view(*index.shape, channels)


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

    Pixel centres are integers, so pixel c of S is at (2c + 1) / S - 1 in the map's [-1, 1] square at every stride.
    """
    grid = ((2.0 * pixels + 1.0) / image_size - 1.0).unsqueeze(1)
    sampled = functional.grid_sample(feature_map, grid, mode="bilinear", padding_mode="border", align_corners=False)
    return sampled.squeeze(2).transpose(1, 2)


class ImageBranch(nn.Module):
    """A small convolutional pyramid; gives maps at strides 4 and 8 (fine detail) and 16 (context)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        w = width
        self.stem = nn.Sequential(Convolution(3, w, 2), Convolution(w, 2 * w, 2), Convolution(2 * w, 2 * w))
        self.stage8 = nn.Sequential(Convolution(2 * w, 4 * w, 2), Convolution(4 * w, 4 * w))
        self.stage16 = nn.Sequential(Convolution(4 * w, 6 * w, 2), Convolution(6 * w, 6 * w))
        self.stage32 = nn.Sequential(Convolution(6 * w, 8 * w, 2), Convolution(8 * w, 8 * w))
        self.lateral32 = nn.Conv2d(8 * w, 6 * w, 1)
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
        centers = position[:, : index.shape[1]] - self.position.bias
        edges = functional.relu(gather_rows(source, index) - centers.unsqueeze(2))
        return functional.relu(self.norm(group_maximum(self.edge(edges))))


def interpolate_up(fine: Tensor, coarse: Tensor, features: Tensor, index: Tensor) -> Tensor:
    """Inverse-distance interpolation of features (B,P,C) at coarse points (B,P,3) to fine points (B,F,3).

    The weights sum to one, so a linear layer may come before it, on the few coarse points, as well as after.
    """
    with torch.no_grad():
        distance = (gather_rows(coarse, index) - fine.unsqueeze(2)).square().sum(-1)
        weight = 1.0 / (distance + 1e-6)
        weight = weight / weight.sum(dim=-1, keepdim=True)
    return torch.matmul(weight.unsqueeze(2), gather_rows(features, index)).squeeze(2)


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


class PageNetwork(nn.Module):
    """One network per category, one forward per frame for all its parts (METHOD 3).

    The radii head predicts where each keypoint lies and gives the distance to it. The same numbers as a plain linear
    head, but a keypoint is the same for all points of a part while its distance is different at each of them, so the
    layers before have a constant to learn instead of a field of spheres. Each part as a whole makes a first guess of
    its keypoints; its points correct it.
    """

    def __init__(self, num_parts: int, num_keypoints: int, num_voted: int, image_size: int = 224) -> None:
        super().__init__()
        self.num_parts, self.num_keypoints, self.image_size = num_parts, num_keypoints, image_size
        self.image_branch = ImageBranch(16)
        c4, c8, c16 = self.image_branch.channels
        self.level1 = SetAbstraction(0, 32, 64, radius=0.05)
        self.level2 = SetAbstraction(64, 96, 128, radius=0.1)
        self.context_fuser = GeometryGuidedFuser(128, c16, 64)
        self.level3 = SetAbstraction(self.context_fuser.outputs, 160, 224, radius=0.2)
        self.whole = Dense(224 + 3, 224)
        self.up3 = FeaturePropagation(224, self.context_fuser.outputs, 192)
        self.whole_to_up3 = nn.Linear(224, 192, bias=False)
        self.up2 = FeaturePropagation(192, 64, 128)
        self.coarse_parts = nn.Linear(128, num_parts + 1)
        self.part_vector = nn.Sequential(Dense(128 + 3, 128), Dense(128, 128))
        self.extents = nn.Linear(128, 3)
        self.part_keypoints = nn.Linear(128, 3 * num_keypoints)
        self.up1 = FeaturePropagation(128 + 128 + 3 * num_keypoints, 3, 128)
        self.after_up1 = Dense(128, 128)
        self.fuser = GeometryGuidedFuser(128, c4 + c8, 64)
        self.head = nn.Sequential(Dense(self.fuser.outputs, 128), Dense(128, 96))
        self.parts = nn.Linear(96, num_parts + 1)
        self.keypoints = nn.Linear(96, 3 * num_keypoints)
        self.sides = nn.Linear(96, num_voted)

    def forward(self, inputs: NetworkInputs, dense: Tensor | None = None) -> NetworkOutputs:
        """`dense` (B,D): evaluate the dense layers at these points only; training needs no more than a subset."""
        points, pixels = inputs.points, inputs.pixels
        y4, y8, y16 = self.image_branch(inputs.image)
        level = [points[:, :count] for count in LEVELS]
        f1 = self.level1(level[0], None, inputs.group1)
        f2 = self.level2(level[1], f1, inputs.group2)
        f2 = self.context_fuser(f2, sample_bilinear(y16, pixels[:, : LEVELS[2]], self.image_size))
        f3 = self.level3(level[2], f2, inputs.group3)
        whole = self.whole(torch.cat([f3, level[3] / POSITION_SCALE], dim=-1)).amax(dim=1, keepdim=True)
        g2 = self.up3(level[2], level[3], f3, f2, inputs.up3)
        g2 = functional.relu(g2 + self.whole_to_up3(whole))
        g1 = self.up2(level[1], level[2], g2, f1, inputs.up2)
        coarse_logits = self.coarse_parts(g1)
        vectors = self._part_vectors(g1, level[1], coarse_logits)
        part_keypoints = self.part_keypoints(vectors)
        own_part = functional.softmax(coarse_logits[..., : self.num_parts], dim=-1)
        guess = own_part @ part_keypoints
        g1 = torch.cat([g1, own_part @ vectors, guess], dim=-1)

        up1 = inputs.up1
        if dense is not None:
            points = torch.take_along_dim(points, dense.unsqueeze(-1), dim=1)
            pixels = torch.take_along_dim(pixels, dense.unsqueeze(-1), dim=1)
            up1 = torch.take_along_dim(up1, dense.unsqueeze(-1), dim=1)
        g0 = self.after_up1(self.up1(points, level[1], g1, points / POSITION_SCALE, up1))
        color = torch.cat([sample_bilinear(y, pixels, self.image_size) for y in (y4, y8)], dim=-1)
        fused = self.head(self.fuser(g0, color))
        keypoints = interpolate_up(points, level[1], guess, up1) + self.keypoints(fused)
        keypoints = keypoints.view(*fused.shape[:2], self.num_keypoints, 3)
        radii = (keypoints - points.unsqueeze(2)).square().sum(-1).clamp_min(1e-8).sqrt()
        return NetworkOutputs(
            part_logits=self.parts(fused),
            radii=radii,
            side_logits=self.sides(fused),
            log_extents=self.extents(vectors),
            keypoints=keypoints,
            coarse_logits=coarse_logits,
            part_keypoints=part_keypoints.view(-1, self.num_parts, self.num_keypoints, 3),
        )

    def _part_vectors(self, features: Tensor, points: Tensor, logits: Tensor) -> Tensor:
        """(B,K,C): what the points of each part say together, averaged by the coarse part probabilities."""
        share = functional.softmax(logits, dim=-1)[..., : self.num_parts]
        share = share / (share.sum(dim=1, keepdim=True) + 1e-3)
        described = self.part_vector[0](torch.cat([features, points / POSITION_SCALE], dim=-1))
        return self.part_vector[1](share.transpose(1, 2) @ described)


def network_for(category: Category) -> PageNetwork:
    """An untrained network of the category's shape."""
    return PageNetwork(len(category.parts), category.num_keypoints, category.num_voted)
