"""From a trained checkpoint to a bundle: one .onnx file with everything the runtime needs inside."""

from __future__ import annotations

import copy
import logging
from pathlib import Path
from typing import Any

import onnx
import torch
from page_runtime.bundle import METADATA_KEY, BundleMetadata
from page_runtime.category import Category
from page_runtime.neighbours import GROUP_SIZE, INTERPOLATION_SIZE, LEVELS
from page_runtime.network import INPUT_NAMES, OUTPUT_NAMES
from page_training.cache import IMAGE_SIZE
from page_training.network import (
    Convolution,
    Dense,
    FeaturePropagation,
    NetworkInputs,
    PageNetwork,
    SetAbstraction,
)
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval, fuse_linear_bn_eval

OPSET = 18
VOXEL_M = 0.005


class RuntimeSignature(nn.Module):
    """The network with the runtime's plain inputs and outputs, training signals left out."""

    def __init__(self, network: PageNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        outputs = self.network(NetworkInputs(*inputs))
        return outputs.part_logits, outputs.radii, outputs.side_logits, outputs.log_extents


def folded(network: PageNetwork) -> PageNetwork:
    """A copy in evaluation mode with every batch norm folded into the linear or convolution layer before it.

    onnxruntime does not fold a batch norm behind a reshape by itself (TRAINING 4).
    """
    network = copy.deepcopy(network).eval()
    for module in list(network.modules()):
        if isinstance(module, Dense) and isinstance(module.norm, nn.BatchNorm1d):
            module.linear = fuse_linear_bn_eval(module.linear, module.norm)
            module.norm = nn.Identity()
        elif isinstance(module, Convolution):
            convolution, norm = module[0], module[1]
            assert isinstance(convolution, nn.Conv2d)
            assert isinstance(norm, nn.BatchNorm2d)
            module[0], module[1] = fuse_conv_bn_eval(convolution, norm), nn.Identity()
        elif isinstance(module, SetAbstraction) and isinstance(module.norm, nn.BatchNorm1d):
            # The norm comes after the maximum over neighbours, which commutes with it where its slope is positive.
            _fold_after_maximum(module)
        elif isinstance(module, FeaturePropagation) and isinstance(module.norm, nn.BatchNorm1d):
            _fold_sum(module)
    return network


def _slope_and_offset(norm: nn.BatchNorm1d) -> tuple[Tensor, Tensor]:
    assert norm.running_mean is not None
    assert norm.running_var is not None
    slope = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    return slope.detach(), (norm.bias - norm.running_mean * slope).detach()


class Affine(nn.Module):
    """x * slope + offset, what is left of a batch norm that cannot be folded away."""

    def __init__(self, slope: Tensor, offset: Tensor) -> None:
        super().__init__()
        self.slope = nn.Parameter(slope, requires_grad=False)
        self.offset = nn.Parameter(offset, requires_grad=False)

    def forward(self, x: Tensor) -> Tensor:
        return x * self.slope + self.offset


def _fold_after_maximum(module: SetAbstraction) -> None:
    assert isinstance(module.norm, nn.BatchNorm1d)
    module.norm = Affine(*_slope_and_offset(module.norm))


def _fold_sum(module: FeaturePropagation) -> None:
    """Scaling both summands scales the sum; the offset goes into the one with a bias."""
    assert isinstance(module.norm, nn.BatchNorm1d)
    slope, offset = _slope_and_offset(module.norm)
    with torch.no_grad():
        module.from_coarse.weight.mul_(slope.unsqueeze(1))
        module.from_fine.weight.mul_(slope.unsqueeze(1))
        module.from_fine.bias.mul_(slope).add_(offset)
    module.norm = nn.Identity()


def example_inputs() -> tuple[Tensor, ...]:
    """Random inputs of the exported shapes, batch of one."""
    generator = torch.Generator().manual_seed(0)
    full, *coarse = LEVELS
    groups = [
        torch.randint(fine, (1, count, GROUP_SIZE), generator=generator, dtype=torch.int32)
        for fine, count in zip(LEVELS[:-1], coarse, strict=True)
    ]
    ups = [
        torch.randint(count, (1, fine, INTERPOLATION_SIZE), generator=generator, dtype=torch.int32)
        for fine, count in zip(LEVELS[:-1], coarse, strict=True)
    ]
    image = torch.rand(1, 3, IMAGE_SIZE, IMAGE_SIZE, generator=generator)
    points = torch.randn(1, full, 3, generator=generator)
    pixels = torch.rand(1, full, 2, generator=generator) * (IMAGE_SIZE - 1)
    return image, points, pixels, *groups, *ups


def export_bundle(network: PageNetwork, category: Category, path: Path, provenance: dict[str, Any]) -> BundleMetadata:
    """Write the bundle whole or not at all; returns the metadata inside it."""
    metadata = BundleMetadata(
        category=category,
        num_points=LEVELS[0],
        image_size=IMAGE_SIZE,
        voxel_m=VOXEL_M,
        opset=OPSET,
        provenance=provenance,
    )
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with torch.no_grad():
        program = torch.onnx.export(
            RuntimeSignature(folded(network)).eval(),
            example_inputs(),
            input_names=list(INPUT_NAMES),
            output_names=list(OUTPUT_NAMES),
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    foreign = {node.domain for node in model.graph.node} - {""}
    if foreign:
        raise ValueError(f"export: expected standard operators only, got domains {sorted(foreign)}")
    del model.metadata_props[:]
    for node in model.graph.node:
        # The exporter notes Python stack traces on every node: half the file, and paths of this machine.
        del node.metadata_props[:]
        node.doc_string = ""
    entry = model.metadata_props.add()
    entry.key, entry.value = METADATA_KEY, metadata.to_json()
    onnx.checker.check_model(model, full_check=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_bytes(model.SerializeToString())
    partial.rename(path)
    return metadata
