"""The network's function for one object, written in what onnxruntime computes quickly on a CPU.

The same weights and the same numbers as `page_training.network.PageNetwork` in evaluation mode, up to the rounding of
float32 (a test compares every category, and `page-export onnx` every network it exports), in another order:

- Two dimensions, points by channels: a batch dimension costs a Reshape before and after every product.
- A linear layer of things side by side is the sum of one product each, without writing them side by side; a layer of
  interpolated things is interpolated after the layer, where there are fewer points. The weights of an interpolation
  sum to one.
- A bias is not part of a large product, before which one thread would write it: it is a weight of a 1 beside the
  coordinates, or is added after a maximum, or by itself.
- What is mixed by part (frames, guesses, vectors) is mixed by products with the parts' shares.
- Layers of the same input are one product; corners of all maps are found together.

Its layers are in `edge_layers`; here they are put together.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from page_export.edge_layers import (
    CornerSampler,
    abstracted,
    affine,
    dense,
    dense_with_places,
    fused,
    interpolated,
    propagated,
    summed,
    weighted,
)
from page_runtime.neighbours import LEVELS, answered_of, levels_of
from page_training.canonical import COORDINATE_SCALE
from page_training.network import POSITION_SCALE, REFINEMENTS, PageNetwork


class EdgeNetwork(nn.Module):
    """The exported form of a network, its batch norms folded; inputs and outputs as the runtime has them."""

    def __init__(self, network: PageNetwork, num_points: int = LEVELS[0]) -> None:
        """num_points: N of its inputs."""
        super().__init__()
        self.network = network
        self.levels, self.answered = levels_of(num_points), answered_of(num_points)
        parts, count = network.num_parts, network.num_keypoints
        self.sampler = CornerSampler(network.image_size, (4, 8, 16), self.answered)
        self.frames = Frames(network)
        refiner = network.refiner
        # What a look sees of a point ends with a 1, whose weights are the next layer's bias.
        hidden = refiner.located.out_features
        located = refiner.located.weight.new_zeros(3, hidden + 1)
        located[:, :hidden] = refiner.located.weight.t() / COORDINATE_SCALE
        self.register_buffer("located", located)
        part = refiner.part.new_zeros(parts, 4, hidden + 1)
        part[:, 3, :hidden] = refiner.part[:, 0] + refiner.known.bias
        part[:, 3, hidden] = 1.0
        self.register_buffer("part", part)
        self.register_buffer("known", functional.pad(refiner.known.weight, (0, 0, 0, 1)))
        described = refiner.described[0]
        assert isinstance(described, nn.Linear)
        self.register_buffer("described", affine(described.weight, described.bias))
        # From a part's share to its columns, and from the columns of all parts to their sum.
        self.register_buffer("spread3", torch.kron(torch.eye(parts), torch.ones(1, 3)))
        self.register_buffer("spread", torch.kron(torch.eye(parts), torch.ones(1, 3 * count)))
        self.register_buffer("gathered", torch.kron(torch.ones(parts, 1), torch.eye(3 * count)))
        self.register_buffer("per_keypoint", torch.eye(count)[:, None, :, None])
        self.register_buffer("minus_point", -torch.eye(3).repeat(1, count))
        self.register_buffer("summed", torch.kron(torch.eye(count), torch.ones(3, 1)))
        fine = network.up1.from_fine.weight
        self.register_buffer("fine_places", affine(fine[:, :3] / POSITION_SCALE, network.up1.from_fine.bias))
        self.register_buffer("fine_in_part", fine[:, 3:].t().repeat(parts, 1))
        coarse = network.up1.from_coarse.weight
        channels = network.up2.from_coarse.out_features
        self.register_buffer("raise_features", coarse[:, :channels].t().contiguous())
        self.register_buffer("raise_vectors", coarse[:, channels : -3 * count].t().contiguous())
        self.register_buffer("raise_guess", coarse[:, -3 * count :].t().contiguous())
        self.register_buffer("last", torch.cat([x.weight for x in (network.parts, network.sides, network.keypoints)]))
        self.register_buffer(
            "last_bias", torch.cat([x.bias for x in (network.parts, network.sides, network.keypoints)])
        )
        self.register_buffer("coordinates", torch.eye(4, 3))
        self.register_buffer("one", torch.tensor([0.0, 0.0, 0.0, 1.0]))

    def forward(
        self,
        image: Tensor,
        points: Tensor,
        pixels: Tensor,
        group1: Tensor,
        group2: Tensor,
        group3: Tensor,
        up1: Tensor,
        up2: Tensor,
        up3: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        net = self.network
        parts, count = net.num_parts, net.num_keypoints
        points, pixels = points[0], pixels[0, : self.answered]
        places = functional.linear(points, self.coordinates, self.one)
        first, second, third = (points[:n] for n in self.levels[1:])
        maps = [y.flatten(2)[0].t() for y in net.image_branch(image)]
        corners = self.sampler(pixels)
        s4, s8 = (weighted(rows, *corner) for rows, corner in zip(maps[:2], corners[:2], strict=True))
        s16 = weighted(maps[2], *(values[: self.levels[2]] for values in corners[2]))

        f1 = abstracted(net.level1, places, [], group1[0])
        f1 = fused(net.detail_fuser, f1, s8[: self.levels[1]])
        f2 = abstracted(net.level2, places[: self.levels[1]], f1, group2[0])
        f2 = fused(net.context_fuser, f2, s16)
        f3 = abstracted(net.level3, places[: self.levels[2]], f2, group3[0])
        whole = dense_with_places(net.whole, f3, places[: self.levels[3]], POSITION_SCALE).amax(dim=0, keepdim=True)
        g2 = propagated(net.up3, second, third, f3, f2, up3[0])
        g2 = functional.relu(g2 + net.whole_to_up3(whole))
        g1 = propagated(net.up2, first, second, g2, f1, up2[0])

        logits = net.coarse_parts(g1)
        probabilities = functional.softmax(logits, dim=-1)
        share = probabilities[:, :parts].t()
        share = share / (share.sum(dim=1, keepdim=True) + 1e-3)
        described = dense_with_places(net.part_vector[0], g1, places[: self.levels[1]], POSITION_SCALE)
        vectors = net.part_vector[1](share @ described)
        guess = net.part_keypoints(vectors).view(parts, count, 3)
        looked = min(self.levels[1], net.looked_at)
        known = summed(self.known, [g1[:looked], probabilities[:looked]])
        share = probabilities[:looked, :parts].t()
        share = share / (share.sum(dim=1, keepdim=True) + 1e-3)
        for _ in range(REFINEMENTS):
            axes, origin, to_part = self.frames(guess)
            seen = places[:looked] @ (to_part @ self.located + self.part)
            seen = functional.relu(seen + known).view(parts * looked, -1)
            seen = functional.relu(net.refiner.described[1](seen @ self.described)).view(parts, looked, -1)
            pooled = torch.cat([(share.unsqueeze(1) @ seen).squeeze(1), seen.amax(dim=1)], dim=-1)
            pooled = net.refiner.pooled(pooled)
            correction = net.refiner.correction(pooled).view(parts, count, 3)
            guess = origin + (net.unit_keypoints + correction) @ axes
            vectors = vectors + net.refiner.to_vector(pooled)
        axes, _, to_part = self.frames(guess)
        flat_guess = guess.view(parts, 3 * count)

        own_part = functional.softmax(logits[:, :parts], dim=-1)
        coarse = torch.cat([g1 @ self.raise_features, own_part], dim=1)
        points, places = points[: self.answered], places[: self.answered]
        raised = interpolated(points, first, coarse, up1[0])
        g0, owner = raised[:, :-parts], raised[:, -parts:]
        to_all_parts = to_part.transpose(0, 1).reshape(4, 3 * parts)
        in_part = (places @ to_all_parts) * (owner @ self.spread3)
        by_part = vectors @ self.raise_vectors + flat_guess @ self.raise_guess
        weights = torch.cat([by_part, self.fine_places, self.fine_in_part])
        g0 = g0 + torch.cat([owner, places, in_part], dim=1) @ weights
        g0 = dense(net.after_up1, [functional.relu(net.up1.norm(g0))])

        pieces = fused(net.fuser, g0, torch.cat([s4, s8], dim=1))
        said = functional.linear(dense(net.head[1], [dense(net.head[0], pieces)]), self.last, self.last_bias)
        part_logits, sides, corrections = said.split([parts + 1, net.sides.out_features, 3 * count], dim=1)
        turned = (axes[:, None, :, None, :] * self.per_keypoint).view(parts, 3 * count, 3 * count)
        turned = turned.transpose(0, 1).reshape(3 * count, parts * 3 * count)
        mixed = (corrections @ turned) * (owner @ self.spread)
        guessed = torch.cat([owner, points], dim=1) @ torch.cat([flat_guess, self.minus_point])
        offsets = torch.addmm(guessed, mixed, self.gathered)
        radii = ((offsets * offsets) @ self.summed).clamp_min(1e-8).sqrt()
        return part_logits[None], radii[None], sides[None], net.extents(vectors)[None]

    located: Tensor
    part: Tensor
    known: Tensor
    described: Tensor
    spread3: Tensor
    spread: Tensor
    gathered: Tensor
    per_keypoint: Tensor
    minus_point: Tensor
    summed: Tensor
    fine_places: Tensor
    fine_in_part: Tensor
    raise_features: Tensor
    raise_vectors: Tensor
    raise_guess: Tensor
    last: Tensor
    last_bias: Tensor
    coordinates: Tensor
    one: Tensor


class Frames(nn.Module):
    """`page_training.canonical.frames_of` for one object.

    guess (K,n,3) to axes (K,3,3), origin (K,1,3) and to_part (K,4,3): a part's coordinates are [x,1] @ to_part.
    """

    fit: Tensor
    unit_mean: Tensor
    crossed: Tensor

    def __init__(self, network: PageNetwork) -> None:
        super().__init__()
        self.network = network
        inverse, unit = network.unit_inverse, network.framed_keypoints
        self.register_buffer("fit", inverse)
        self.register_buffer("unit_mean", unit.mean(dim=1, keepdim=True))
        # z @ crossed is the matrix whose product with x, from the left, is z cross x.
        basis = torch.eye(3)
        crossed = torch.stack([torch.linalg.cross(z.expand(3, 3), basis) for z in basis])
        self.register_buffer("crossed", crossed.reshape(3, 9))

    def forward(self, guess: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        keypoints = self.network._framed(guess)
        mean = keypoints.mean(dim=1, keepdim=True)
        affine = self.fit @ (keypoints - mean)
        scale = (affine * affine).sum(dim=(1, 2), keepdim=True).mul(1.0 / 3.0).clamp_min(1e-4).sqrt()
        z = unit_length(affine[:, 2:])
        x = affine[:, :1]
        x = unit_length(x - (x * z).sum(dim=-1, keepdim=True) * z)
        y = x @ (z @ self.crossed).view(-1, 3, 3)
        axes = scale * torch.cat([x, y, z], dim=1)
        origin = mean - self.unit_mean @ axes
        square = (axes * axes).sum(dim=(1, 2), keepdim=True).mul(1.0 / 3.0).clamp_min(1e-8)
        rotation = axes.transpose(1, 2) / square
        return axes, origin, torch.cat([rotation, -(origin @ rotation)], dim=1)


def unit_length(vector: Tensor) -> Tensor:
    """As functional.normalize with eps 1e-6, without its Expand."""
    return vector / vector.norm(dim=-1, keepdim=True).clamp_min(1e-6)
