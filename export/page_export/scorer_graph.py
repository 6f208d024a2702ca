"""The scorer as part of the ONNX graph, for accelerators that run the whole pipeline in one piece.

`page_runtime.scoring` finds the voxel of most votes by branch and bound; a graph has no branches. Here every level
keeps a fixed number of cells, those that the most shells, thickened by the cell, reach (the same bound), and splits
them. With BEAM of them the result is the numpy scorer's within one voxel, though nothing certifies it, and no second
mode is listed. It costs ten times the votes: on a CPU the numpy scorer is far ahead (export/README.md), and the runtime
does not load such a graph.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from page_export.onnx_export import OPSET, exported
from page_runtime.bundle import BundleMetadata
from page_runtime.category import Category
from page_runtime.neighbours import answered_of
from page_runtime.part_poses import MAX_VOTERS, MIN_PART_POINTS

# Of 288 keypoints, half of them with correlated radius errors, the votes were the maximum for 91 % with 64 cells, 98 %
# with 128, 99 % with 256 and all with 384.
BEAM = 384
# Cells of 32 voxels a side at first: an object is ten of them wide.
TOP_LEVEL = 5
WINDOW = 2
CENTER, DISTINCT = "center_camera", "num_distinct"
INPUTS = ("points", "part_logits", "radii", CENTER, DISTINCT)
OUTPUTS = ("voted_keypoints", "keypoint_votes")
_PREFIX = "scorer/"


class VoteGraph(nn.Module):
    """Eq. 16-18 about the middle of each part's points, of standard operators only.

    Inputs: the network's points (1,N,3), centred, part_logits (1,A,K+1) and radii (1,A,n) of the first A of them,
    lengths in region radii; and
    the centre that was subtracted, center_camera (1,3) m, which places the lattice of voxels; num_distinct (1,) int64,
    points before repetition. Outputs: voted_keypoints
    (1,K,v,3) m camera, the voxel centres with the most votes; keypoint_votes (1,K,v), as float, 0 for a part of fewer
    than MIN_PART_POINTS points.
    """

    octants: Tensor
    window: Tensor
    roots: Tensor

    def __init__(self, category: Category, answered: int, voxel_m: float, beam: int = BEAM) -> None:
        super().__init__()
        self.num_parts, self.num_voted, self.beam = len(category.parts), category.num_voted, beam
        self.num_voters = min(MAX_VOTERS, answered)
        self.voxel_m, self.voxels_per_unit = voxel_m, category.region_radius_m / voxel_m
        farthest = max(
            part.diagonal_range_m[1] * (0.5 + float(np.linalg.norm(part.keypoints_unit, axis=1).max()))
            for part in category.parts
        )
        side = 2**TOP_LEVEL
        count = math.ceil(2.0 * farthest / (side * voxel_m))
        # First voxels of the root cells, so that centres of every level follow from whole numbers.
        first = side * torch.arange(count) - side * count // 2
        cube = torch.stack(torch.meshgrid(first, first, first, indexing="ij"), dim=-1).view(1, 1, -1, 3)
        self.register_buffer("roots", cube.float(), persistent=False)
        self.register_buffer("octants", _lattice(0, 1), persistent=False)
        self.register_buffer("window", _lattice(-WINDOW, WINDOW), persistent=False)

    def forward(
        self, points: Tensor, part_logits: Tensor, radii: Tensor, center_camera: Tensor, num_distinct: Tensor
    ) -> tuple[Tensor, Tensor]:
        points = points[:, : part_logits.shape[1]]
        members = part_logits[0].argmax(dim=-1).unsqueeze(0) == torch.arange(self.num_parts).unsqueeze(1)
        members = members & (torch.arange(points.shape[1]) < num_distinct).unsqueeze(0)
        # The first points of each part, which cover it evenly: those that are no members are taken last.
        order = torch.arange(points.shape[1], 0, -1).float()
        taken, index = (members.float() * order).topk(self.num_voters, dim=-1)
        votes = taken > 0.0
        # Lengths in voxels from here on.
        own = (points[0] * self.voxels_per_unit + center_camera / self.voxel_m)[index]
        own_radii = self.voxels_per_unit * radii[0, :, : self.num_voted][index].transpose(1, 2)
        share = votes.float().unsqueeze(-1)
        middle = (own * share).sum(dim=1, keepdim=True) / share.sum(dim=1, keepdim=True).clamp_min(1.0)
        origin = torch.round(middle)
        relative = own - origin

        corners = self.roots.expand(self.num_parts, self.num_voted, -1, 3)
        for level in range(TOP_LEVEL, 0, -1):
            reached = self._counted(corners, level, relative, own_radii, votes)
            best = reached.topk(min(self.beam, corners.shape[2]), dim=-1).indices
            corners = _chosen(corners, best)
            corners = (corners.unsqueeze(3) + 2 ** (level - 1) * self.octants).flatten(2, 3)
        best = self._counted(corners, 0, relative, own_radii, votes).argmax(dim=-1, keepdim=True)
        corners = _chosen(corners, best) + self.window
        reached = self._counted(corners, 0, relative, own_radii, votes)
        best = reached.argmax(dim=-1, keepdim=True)
        voxels = _chosen(corners, best).squeeze(2)
        enough = members.sum(dim=1) >= MIN_PART_POINTS
        counts = torch.take_along_dim(reached, best, dim=2).squeeze(2) * enough.float().unsqueeze(1)
        return ((voxels + origin) * self.voxel_m).unsqueeze(0), counts.unsqueeze(0)

    def _counted(self, corners: Tensor, level: int, points: Tensor, radii: Tensor, votes: Tensor) -> Tensor:
        """(K,v,C) shells, thickened by half the diagonal of the cells' voxel centres, that the cells' centres lie in.

        As in `page_runtime.vote_shells`, without a root: | |g|^2 - 2 g.p + |p|^2 - m | <= t.
        """
        side = 2**level - 1
        centres = corners + 0.5 * side
        reach = math.sqrt(3.0) * (1.0 + 0.5 * side)
        outer, inner = (radii + reach).square(), (radii - reach).clamp_min(0.0).square()
        middle, half = 0.5 * (outer + inner), 0.5 * (outer - inner)
        points = points.unsqueeze(1)
        product = (-2.0 * centres) @ points.transpose(2, 3).expand(-1, radii.shape[1], -1, -1)
        offset = points.square().sum(-1) - middle
        inside = (product + centres.square().sum(-1, keepdim=True) + offset.unsqueeze(2)).abs() <= half.unsqueeze(2)
        return (inside & votes[:, None, None, :]).float().sum(dim=-1)


def _lattice(first: int, last: int) -> Tensor:
    return torch.tensor(list(itertools.product(range(first, last + 1), repeat=3)), dtype=torch.float32)


def _chosen(cells: Tensor, index: Tensor) -> Tensor:
    """Cells (K,v,C,3) at index (K,v,B)."""
    return torch.take_along_dim(cells, index.unsqueeze(-1).expand(-1, -1, -1, 3), dim=2)


def scorer_graph(metadata: BundleMetadata, beam: int = BEAM) -> onnx.ModelProto:
    """The scorer alone, as an ONNX model from INPUTS to OUTPUTS."""
    category = metadata.category
    generator = torch.Generator().manual_seed(0)
    answered = answered_of(metadata.num_points)
    shapes = ((metadata.num_points, 3), (answered, len(category.parts) + 1), (answered, category.num_keypoints))
    examples = [torch.rand(1, *shape, generator=generator) for shape in shapes]
    examples += [torch.rand(1, 3, generator=generator), torch.tensor([metadata.num_points])]
    graph = VoteGraph(category, answered, metadata.voxel_m, beam).eval()
    return exported(graph, tuple(examples), INPUTS, OUTPUTS)


def with_scorer(bundle: onnx.ModelProto, metadata: BundleMetadata, beam: int = BEAM) -> onnx.ModelProto:
    """A bundle's network followed by the scorer in one graph, with the outputs of both. The metadata stays inside."""
    model = onnx.ModelProto()
    model.CopyFrom(bundle)
    scorer = onnx.compose.add_prefix(scorer_graph(metadata, beam), _PREFIX)
    shared = {_PREFIX + name: name for name in (*INPUTS, *OUTPUTS)}
    for value in scorer.graph.input:
        if value.name in (_PREFIX + CENTER, _PREFIX + DISTINCT):
            value.name = shared[value.name]
            model.graph.input.append(value)
    for node in scorer.graph.node:
        for names in (node.input, node.output):
            names[:] = [shared.get(name, name) for name in names]
    for output in scorer.graph.output:
        output.name = shared[output.name]
    model.graph.node.extend(scorer.graph.node)
    model.graph.initializer.extend(scorer.graph.initializer)
    model.graph.output.extend(scorer.graph.output)
    assert {opset.version for opset in model.opset_import if opset.domain == ""} == {OPSET}
    onnx.checker.check_model(model, full_check=True)
    return model
