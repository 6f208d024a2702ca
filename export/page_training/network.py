"""The network of PAGE section V-B: image branch, point branch, geometry-guided colour fusion, and its heads.

Inputs, one object per row (B = batch, N = 2048 points, S = 224):
    image (B,3,S,S) RGB in [0,1]; points (B,N,3) centred, in units of the category's region radius, progressive order;
    pixels (B,N,2) crop pixels of the points; six neighbour tables (page_runtime.neighbours.Neighbours).
Outputs, D dense points (the first ones, as many as up1 has rows, or a random subset of all in training):
    part_logits (B,D,K+1), background last; radii (B,D,n) to the point's own part's keypoints, in region radii;
    side_logits (B,D,n_voted), positive where the keypoint is on the camera's side of the surface;
    log_extents (B,K,3), the parts' full sizes, log of metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from page_runtime.category import Category
from page_runtime.neighbours import levels_of
from page_training.canonical import CanonicalRefiner, PartFrames, frames_of, with_normal
from page_training.config import Fusion
from page_training.layers import (
    FUSERS,
    Dense,
    FeaturePropagation,
    ImageBranch,
    SetAbstraction,
    interpolate_up,
    sample_bilinear,
)

# Spread of an object's points in region radii: positions enter beside normalised features as large as those.
POSITION_SCALE = 0.25
# Of a set of keypoints that holds a frame by itself, in part diagonals (least singular value).
LEAST_THICKNESS = 0.05
# Looks at the object from its parts' guessed frames, by the same weights.
REFINEMENTS = 2
# Points each look sees, of all parts together: its cost, which grows with their number, stays that of two parts.
LOOKED_AT = 1024
# Of every dense point, below the heads.
FEATURES = 96


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
class ObjectOutputs:
    """What is said of an object whatever its points say. `coarse_logits` (B,512,K+1) and `part_keypoints`, the guesses
    (B,K,n,3) from first to last, are training signals; the export leaves them out."""

    part_logits: Tensor
    log_extents: Tensor
    coarse_logits: Tensor
    part_keypoints: tuple[Tensor, ...]


@dataclass(frozen=True, slots=True)
class NetworkOutputs(ObjectOutputs):
    """`keypoints` (B,D,n,3), too, is a training signal."""

    radii: Tensor
    side_logits: Tensor
    keypoints: Tensor


class Described(NamedTuple):
    """What the layers below the heads know of the dense points, in region radii and the centred frame.

    points (B,D,3); features (B,D,FEATURES); owner (B,K,D,1) how far a point is part k's; in_part (B,D,3) its place in
    the guessed frame of its own part; refined (B,D,3n) the guessed keypoints of its own part; frames: the last guess.
    """

    points: Tensor
    features: Tensor
    owner: Tensor
    in_part: Tensor
    refined: Tensor
    frames: PartFrames
    common: ObjectOutputs


class PageNetwork(nn.Module):
    """One network per category, one forward per frame for all its parts (METHOD 3).

    The radii head predicts where each keypoint lies and gives the distance to it. The same numbers as a plain linear
    head, but a keypoint is the same for all points of a part while its distance is different at each of them, so the
    layers before have a constant to learn instead of a field of spheres. Each part as a whole makes a first guess of
    its keypoints; two looks from the frames the guess gives, and then the part's points one by one, correct it.
    """

    unit_keypoints: Tensor
    framed_keypoints: Tensor
    unit_inverse: Tensor

    def __init__(self, keypoints_unit: Tensor, num_voted: int, fusion: Fusion = "gated", image_size: int = 224) -> None:
        """keypoints_unit: (K,n,3), those of each part in units of its diagonal. fusion: how colour joins geometry; all
        but "gated" are the paper's comparisons."""
        super().__init__()
        num_parts, num_keypoints = keypoints_unit.shape[:2]
        self.num_parts, self.num_keypoints, self.image_size = num_parts, num_keypoints, image_size
        self.register_buffer("unit_keypoints", keypoints_unit, persistent=False)
        centred = keypoints_unit - keypoints_unit.mean(dim=1, keepdim=True)
        self.in_plane = bool((torch.linalg.svdvals(centred)[:, 2] < LEAST_THICKNESS).any())
        self.register_buffer("framed_keypoints", self._framed(keypoints_unit), persistent=False)
        centred = self.framed_keypoints - self.framed_keypoints.mean(dim=1, keepdim=True)
        self.register_buffer("unit_inverse", torch.linalg.pinv(centred), persistent=False)
        self.image_branch = ImageBranch(16)
        c4, c8, c16 = self.image_branch.channels
        self.level1 = SetAbstraction(0, 32, 64, radius=0.05)
        self.detail_fuser = FUSERS[fusion](64, c8, 64)
        self.level2 = SetAbstraction(self.detail_fuser.outputs, 96, 128, radius=0.1)
        self.context_fuser = FUSERS[fusion](128, c16, 64)
        self.level3 = SetAbstraction(self.context_fuser.outputs, 160, 224, radius=0.2)
        self.whole = Dense(224 + 3, 224)
        self.up3 = FeaturePropagation(224, self.context_fuser.outputs, 192)
        self.whole_to_up3 = nn.Linear(224, 192, bias=False)
        self.up2 = FeaturePropagation(192, self.detail_fuser.outputs, 128)
        self.coarse_parts = nn.Linear(128, num_parts + 1)
        self.part_vector = nn.Sequential(Dense(128 + 3, 128), Dense(128, 128))
        self.extents = nn.Linear(128, 3)
        self.part_keypoints = nn.Linear(128, 3 * num_keypoints)
        self.looked_at = LOOKED_AT // num_parts
        self.refiner = CanonicalRefiner(128, num_parts, num_keypoints, 128)
        self.up1 = FeaturePropagation(128 + 128 + 3 * num_keypoints, 6, 128)
        self.after_up1 = Dense(128, 128)
        self.fuser = FUSERS[fusion](128, c4 + c8, 64)
        self.head = nn.Sequential(Dense(self.fuser.outputs, 128), Dense(128, FEATURES))
        self.parts = nn.Linear(FEATURES, num_parts + 1)
        self.keypoints = nn.Linear(FEATURES, 3 * num_keypoints)
        self.sides = nn.Linear(FEATURES, num_voted)

    def forward(self, inputs: NetworkInputs, dense: Tensor | None = None) -> NetworkOutputs:
        """`dense` (B,D): evaluate the dense layers at these points, of all that up1 has rows for."""
        known = self.described(inputs, dense)
        # Corrections in the part's frame and in parts of its diagonal, turned back.
        correction = self.keypoints(known.features).view(known.points.shape[0], 1, -1, 3) @ known.frames.axes
        correction = known.owner * correction.view(*known.owner.shape[:3], -1)
        keypoints = (known.refined + correction.sum(dim=1)).view(*known.points.shape[:2], self.num_keypoints, 3)
        common = known.common
        return NetworkOutputs(
            part_logits=common.part_logits,
            radii=(keypoints - known.points.unsqueeze(2)).square().sum(-1).clamp_min(1e-8).sqrt(),
            side_logits=self.sides(known.features),
            log_extents=common.log_extents,
            keypoints=keypoints,
            coarse_logits=common.coarse_logits,
            part_keypoints=common.part_keypoints,
        )

    def described(self, inputs: NetworkInputs, dense: Tensor | None = None) -> Described:
        """All layers but the heads of radii, which other ways to say a pose share; `dense` as in `forward`."""
        points, pixels = inputs.points, inputs.pixels
        y4, y8, y16 = self.image_branch(inputs.image)
        level = [points[:, :count] for count in levels_of(points.shape[1])]
        f1 = self.level1(level[0], None, inputs.group1)
        f1 = self.detail_fuser(f1, sample_bilinear(y8, pixels[:, : level[1].shape[1]], self.image_size))
        f2 = self.level2(level[1], f1, inputs.group2)
        f2 = self.context_fuser(f2, sample_bilinear(y16, pixels[:, : level[2].shape[1]], self.image_size))
        f3 = self.level3(level[2], f2, inputs.group3)
        whole = self.whole(torch.cat([f3, level[3] / POSITION_SCALE], dim=-1)).amax(dim=1, keepdim=True)
        g2 = self.up3(level[2], level[3], f3, f2, inputs.up3)
        g2 = functional.relu(g2 + self.whole_to_up3(whole))
        g1 = self.up2(level[1], level[2], g2, f1, inputs.up2)
        coarse_logits = self.coarse_parts(g1)
        vectors = self._part_vectors(g1, level[1], coarse_logits)
        probabilities = functional.softmax(coarse_logits, dim=-1)
        guess = self.part_keypoints(vectors).view(-1, self.num_parts, self.num_keypoints, 3)
        guesses = [guess]
        looked = min(level[1].shape[1], self.looked_at)
        known = self.refiner.prepared(g1[:, :looked], probabilities[:, :looked])
        for _ in range(REFINEMENTS):
            # Each look learns from where the one before ended; its gradient would only blur what that one learns.
            frames = self._frames(guess)
            correction, addition = self.refiner(frames, level[1][:, :looked], known, probabilities[:, :looked])
            guess = frames.place(self.unit_keypoints + correction)
            vectors = vectors + addition
            guesses.append(guess)
        frames = self._frames(guess)
        own_part = functional.softmax(coarse_logits[..., : self.num_parts], dim=-1)
        refined = own_part @ guess.flatten(2)
        g1 = torch.cat([g1, own_part @ vectors, refined], dim=-1)

        up1 = inputs.up1
        points, pixels = points[:, : up1.shape[1]], pixels[:, : up1.shape[1]]
        if dense is not None:
            points = torch.take_along_dim(points, dense.unsqueeze(-1), dim=1)
            pixels = torch.take_along_dim(pixels, dense.unsqueeze(-1), dim=1)
            up1 = torch.take_along_dim(up1, dense.unsqueeze(-1), dim=1)
        owner = interpolate_up(points, level[1], own_part, up1).transpose(1, 2).unsqueeze(-1)
        in_part = (owner * frames.coordinates(points)).sum(dim=1)
        g0 = self.after_up1(self.up1(points, level[1], g1, torch.cat([points / POSITION_SCALE, in_part], dim=-1), up1))
        color = torch.cat([sample_bilinear(y, pixels, self.image_size) for y in (y4, y8)], dim=-1)
        fused = self.head(self.fuser(g0, color))
        return Described(
            points=points,
            features=fused,
            owner=owner,
            in_part=in_part,
            refined=interpolate_up(points, level[1], refined, up1),
            frames=frames,
            common=ObjectOutputs(self.parts(fused), self.extents(vectors), coarse_logits, tuple(guesses)),
        )

    def _framed(self, keypoints: Tensor) -> Tensor:
        """The keypoints that hold a part's frame: (...,n,3), and one more where they lie in one plane."""
        return with_normal(keypoints) if self.in_plane else keypoints

    def _frames(self, guess: Tensor) -> PartFrames:
        return frames_of(self._framed(guess.detach()), self.unit_inverse, self.framed_keypoints)

    def _part_vectors(self, features: Tensor, points: Tensor, logits: Tensor) -> Tensor:
        """(B,K,C): what the points of each part say together, averaged by the coarse part probabilities."""
        share = functional.softmax(logits, dim=-1)[..., : self.num_parts]
        share = share / (share.sum(dim=1, keepdim=True) + 1e-3)
        described = self.part_vector[0](torch.cat([features, points / POSITION_SCALE], dim=-1))
        return self.part_vector[1](share.transpose(1, 2) @ described)


def keypoints_of(category: Category) -> Tensor:
    """(K,n,3) float32, the keypoints of each part in units of its diagonal."""
    return torch.from_numpy(np.stack([part.keypoints_unit for part in category.parts])).to(torch.float32)


def network_for(category: Category, fusion: Fusion = "gated") -> PageNetwork:
    """An untrained network of the category's shape."""
    return PageNetwork(keypoints_of(category), category.num_voted, fusion)
