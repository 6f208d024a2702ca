"""Refinement in the part's own frame: look at the points where the first guess says the part stands, and correct it.

A network that sees camera coordinates has to learn every correction anew for every direction a part can face. Points
moved into the guessed part frame look the same from wherever they were seen, and what is left to say, "turn the lid by
five degrees about its hinge", is one thing to learn.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from page_training.layers import Dense

# Spread of a part's points in units of its diagonal.
COORDINATE_SCALE = 0.25


class PartFrames(NamedTuple):
    """Similarity of each part: x = origin + p @ axes for p in part units. axes (B,K,3,3), its rows are scale times the
    part's x, y, z in the centred frame; origin (B,K,3)."""

    axes: Tensor
    origin: Tensor

    def place(self, unit: Tensor) -> Tensor:
        """(B,K,n,3) points of the parts' frames, (K,n,3) or (B,K,n,3), in the centred frame."""
        return self.origin.unsqueeze(2) + unit @ self.axes

    def coordinates(self, points: Tensor) -> Tensor:
        """(B,K,P,3) coordinates of points (B,P,3) in each part's frame."""
        square = self.axes.square().sum(dim=-1).mean(dim=-1)[..., None, None].clamp_min(1e-8)
        return (points.unsqueeze(1) - self.origin.unsqueeze(2)) @ self.axes.transpose(-1, -2) / square


def frames_of(keypoints: Tensor, inverse: Tensor, unit: Tensor) -> PartFrames:
    """The frames that place the unit keypoints (K,n,3) nearest the given ones (B,K,n,3).

    The least-squares affine map by `inverse` (K,3,n), the pseudo-inverse of the centred unit keypoints, made a
    rotation by Gram-Schmidt, normal first: a decomposition would not export to ONNX, and the next look corrects what
    it leaves. A guess of no size at all still gives finite numbers.
    """
    mean = keypoints.mean(dim=2, keepdim=True)
    affine = inverse @ (keypoints - mean)
    scale = affine.square().sum(dim=(-2, -1), keepdim=True).div(3.0).clamp_min(1e-4).sqrt()
    x, _, z = affine.unbind(dim=2)
    z = functional.normalize(z, dim=-1, eps=1e-6)
    x = functional.normalize(x - (x * z).sum(dim=-1, keepdim=True) * z, dim=-1, eps=1e-6)
    y = torch.linalg.cross(z, x, dim=-1)
    axes = scale * torch.stack([x, y, z], dim=2)
    return PartFrames(axes, mean.squeeze(2) - (unit.mean(dim=1, keepdim=True) @ axes).squeeze(2))


def with_normal(keypoints: Tensor) -> Tensor:
    """(...,n,3) keypoints and one more, off the plane of the first three by the root of twice their triangle's area.

    Keypoints in one plane hold no frame by a linear map; with this point they do, on the side their order says.
    """
    first, second, third = keypoints[..., 0, :], keypoints[..., 1, :], keypoints[..., 2, :]
    normal = torch.linalg.cross(second - first, third - first, dim=-1)
    length = normal.square().sum(dim=-1, keepdim=True).clamp_min(1e-12).sqrt()
    return torch.cat([keypoints, ((first + second + third) / 3.0 + normal / length.sqrt()).unsqueeze(-2)], dim=-2)


class CanonicalRefiner(nn.Module):
    """One look at the object from each part's guessed frame.

    Sees all points, the other parts' and the background's too, with the part probabilities: where the base ends tells
    where the lid turns.
    """

    def __init__(self, features: int, num_parts: int, num_keypoints: int, vector: int) -> None:
        super().__init__()
        self.num_keypoints = num_keypoints
        self.known = nn.Linear(features + num_parts + 1, 128)
        self.part = nn.Parameter(torch.zeros(num_parts, 1, 128))
        self.located = nn.Linear(3, 128, bias=False)
        self.described = Dense(128, 160)
        self.pooled = Dense(2 * 160, 192)
        self.correction = nn.Linear(192, 3 * num_keypoints)
        self.to_vector = nn.Linear(192, vector)
        for layer in (self.correction, self.to_vector):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)

    def prepared(self, features: Tensor, probabilities: Tensor) -> Tensor:
        """(B,P,C) what every look knows of the points: features (B,P,F) and part probabilities (B,P,K+1)."""
        return self.known(torch.cat([features, probabilities], dim=-1))

    def forward(
        self, frames: PartFrames, points: Tensor, known: Tensor, probabilities: Tensor
    ) -> tuple[Tensor, Tensor]:
        """points (B,P,3), `known` of `prepared`. Gives keypoint corrections (B,K,n,3) in part units and additions to
        the part vectors (B,K,V)."""
        batch, parts = frames.origin.shape[:2]
        located = self.located(frames.coordinates(points) / COORDINATE_SCALE)
        seen = self.described(functional.relu(located + known.unsqueeze(1) + self.part))
        share = probabilities[..., :parts].transpose(1, 2).unsqueeze(2)
        share = share / (share.sum(dim=-1, keepdim=True) + 1e-3)
        pooled = self.pooled(torch.cat([(share @ seen).squeeze(2), seen.amax(dim=2)], dim=-1))
        return self.correction(pooled).view(batch, parts, self.num_keypoints, 3), self.to_vector(pooled)
