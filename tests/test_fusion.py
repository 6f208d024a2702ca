"""The paper's alternatives to the gate, by what each must and must not look at."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch

from page_training.cache import make_shard
from page_training.categories import CATEGORIES
from page_training.config import Fusion, TrainingConfig
from page_training.evaluate import answer, metadata_for
from page_training.layers import FUSERS, ConcatenationFuser, DenseFuser
from page_training.network import network_for
from page_training.records import shard_path
from page_training.train import train
from page_training.trained import load_trained
from toy import toy_frame

BOX = CATEGORIES["box"]


def test_every_fusion_has_its_layer_and_says_its_width() -> None:
    assert set(FUSERS) == set(get_args(Fusion))
    geometry, color = torch.randn(2, 30, 16), torch.randn(2, 30, 8)
    for fuser in FUSERS.values():
        one = fuser(16, 8, 12).eval()
        assert one(geometry, color).shape == (2, 30, one.outputs)


def test_a_point_feels_others_only_in_the_dense_fuser() -> None:
    torch.manual_seed(0)
    geometry, color = torch.randn(1, 30, 16), torch.randn(1, 30, 8)
    changed = color.clone()
    changed[:, 0] += 1.0
    for kind, feels in ((ConcatenationFuser, False), (DenseFuser, True)):
        fuser = kind(16, 8, 12).eval()
        others = (fuser(geometry, changed) - fuser(geometry, color))[:, 1:]
        assert bool(others.abs().max() > 0) is feels


@pytest.mark.parametrize("fusion", get_args(Fusion))
def test_colour_matters_to_all_but_depth(fusion: Fusion) -> None:
    from page_runtime.estimator import sample_for
    from page_runtime.sampling import RegionSample

    torch.manual_seed(0)
    network = network_for(BOX, fusion).eval()
    recorded, _ = toy_frame()
    region = recorded.instances[0].region
    assert region is not None
    metadata = metadata_for(BOX)
    sample = sample_for(metadata, recorded.frame, region)
    assert isinstance(sample, RegionSample)
    before = answer(network, sample, metadata)
    sample.image[:] = 255 - sample.image
    after = answer(network, sample, metadata)
    assert np.array_equal(before.part_logits, after.part_logits) is (fusion == "depth")


@pytest.mark.parametrize("fusion", ["dense", "depth"])
def test_a_trained_alternative_is_loaded_as_what_it_is(fusion: Fusion, tmp_path: Path) -> None:
    make_shard(BOX, "train", 0, shard_path(tmp_path, "box", "train", 0), size=4)
    config = TrainingConfig("box", fusion=fusion, samples=2, batch_size=2, dense_points=64)
    checkpoint = train(config, BOX, tmp_path, tmp_path / "run", lambda _: None)
    trained = load_trained(checkpoint)
    assert trained.config["fusion"] == fusion
    assert isinstance(trained.network.fuser, FUSERS[fusion])
    gated = TrainingConfig("box", start_from=str(checkpoint), samples=2, batch_size=2, dense_points=64)
    with pytest.raises(ValueError, match="another network"):
        train(gated, BOX, tmp_path, tmp_path / "other", lambda _: None)
