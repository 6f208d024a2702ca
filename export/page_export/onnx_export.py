"""From a trained checkpoint to a bundle: one .onnx file with everything the runtime needs inside."""

from __future__ import annotations

import copy
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn
from torch.export import Dim
from torch.nn.utils.fusion import fuse_conv_bn_eval

from page_export.bundle_writer import bundle_bytes, write_file
from page_export.edge_network import EdgeNetwork
from page_export.simplified import simplified
from page_runtime.bundle import BundleMetadata
from page_runtime.category import Category
from page_runtime.neighbours import GROUP_SIZE, INTERPOLATION_SIZE, LEVELS, answered_of, levels_of
from page_runtime.signature import INPUT_NAMES, OUTPUT_NAMES
from page_training.config import VOXEL_M
from page_training.layers import Convolution
from page_training.network import NetworkInputs, PageNetwork
from page_training.records import IMAGE_SIZE

OPSET = 18


class RuntimeSignature(nn.Module):
    """The network with the runtime's plain inputs and outputs, training signals left out."""

    def __init__(self, network: PageNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        outputs = self.network(NetworkInputs(*inputs))
        return outputs.part_logits, outputs.radii, outputs.side_logits, outputs.log_extents


def folded(network: PageNetwork) -> PageNetwork:
    """A copy in evaluation mode with every batch norm folded into its convolution."""
    network = copy.deepcopy(network).eval()
    for module in network.modules():
        if isinstance(module, Convolution):
            convolution, norm = module[0], module[1]
            assert isinstance(convolution, nn.Conv2d)
            assert isinstance(norm, nn.BatchNorm2d)
            module[0], module[1] = fuse_conv_bn_eval(convolution, norm), nn.Identity()
    return network


def example_inputs(num_points: int = LEVELS[0], image_size: int = IMAGE_SIZE) -> tuple[Tensor, ...]:
    """Random inputs of the exported shapes, batch of one."""
    generator = torch.Generator().manual_seed(0)
    levels = levels_of(num_points)
    full, *coarse = levels
    groups = [
        torch.randint(fine, (1, count, GROUP_SIZE), generator=generator, dtype=torch.int32)
        for fine, count in zip(levels[:-1], coarse, strict=True)
    ]
    ups = [
        torch.randint(count, (1, fine, INTERPOLATION_SIZE), generator=generator, dtype=torch.int32)
        for fine, count in zip((answered_of(num_points), *coarse[:-1]), coarse, strict=True)
    ]
    image = torch.rand(1, 3, image_size, image_size, generator=generator)
    points = torch.randn(1, full, 3, generator=generator)
    pixels = torch.rand(1, full, 2, generator=generator) * (image_size - 1)
    return image, points, pixels, *groups, *ups


def graph_of(network: PageNetwork, num_points: int = LEVELS[0]) -> onnx.ModelProto:
    """The network as a checked ONNX model of standard operators, without metadata, for so many points and pictures of
    its own size."""
    examples = example_inputs(num_points, network.image_size)
    return simplified(exported(EdgeNetwork(folded(network), num_points).eval(), examples, INPUT_NAMES, OUTPUT_NAMES))


def exported(
    module: nn.Module,
    examples: tuple[Tensor, ...],
    inputs: Sequence[str],
    outputs: Sequence[str],
    free: dict[int, Dim] | None = None,
) -> onnx.ModelProto:
    """A module as a checked ONNX model of standard operators; ValueError where others would be needed.

    free: dimensions, the same of all inputs, that are not those of the examples but known when it runs.
    """
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with torch.no_grad():
        program = torch.onnx.export(
            module,
            examples,
            input_names=list(inputs),
            output_names=list(outputs),
            opset_version=OPSET,
            dynamic_shapes=None if free is None else (tuple(free for _ in examples),),
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    foreign = {node.domain for node in model.graph.node} - {""}
    if foreign:
        raise ValueError(f"export: expected standard operators only, got domains {sorted(foreign)}")
    onnx.checker.check_model(model, full_check=True)
    return model


def bundle_metadata(
    category: Category,
    *,
    mirrored: bool,
    provenance: dict[str, Any],
    num_points: int = LEVELS[0],
    image_size: int = IMAGE_SIZE,
) -> BundleMetadata:
    """Of a bundle that this release exports, not calibrated; all as in `BundleMetadata`."""
    return BundleMetadata(
        category=category,
        num_points=num_points,
        image_size=image_size,
        voxel_m=VOXEL_M,
        opset=OPSET,
        mirrored=mirrored,
        provenance=provenance,
    )


def write_bundle(
    model: onnx.ModelProto,
    category: Category,
    path: Path,
    *,
    mirrored: bool,
    provenance: dict[str, Any],
    num_points: int = LEVELS[0],
    image_size: int = IMAGE_SIZE,
) -> BundleMetadata:
    """Write model and metadata, which are given back, as one file, whole or not at all; all but `model` as in
    `BundleMetadata`."""
    metadata = bundle_metadata(
        category, mirrored=mirrored, provenance=provenance, num_points=num_points, image_size=image_size
    )
    write_file(bundle_bytes(model, metadata), path)
    return metadata
