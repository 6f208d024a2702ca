"""A network for several objects at once says of each what it says of it alone; the runtime refuses it in words."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest
import torch

from page_export.batched import with_rows
from page_export.cli import main
from page_export.onnx_export import write_bundle
from page_export.parity import samples_of
from page_runtime.bundle_fields import BundleError
from page_runtime.bundle_file import read_bundle
from page_runtime.capture.playback import open_source
from page_runtime.category_document import category_document
from page_runtime.cli import main as runtime
from page_runtime.network import Network, feeds
from page_runtime.signature import INPUT_NAMES, OUTPUT_NAMES
from page_training.categories import CATEGORIES
from page_training.checkpoint import save_checkpoint
from page_training.network import PageNetwork, network_for

ROOT = Path(__file__).resolve().parents[1]
RECORDING = ROOT / "tests" / "data" / "laptop"
LAPTOP = CATEGORIES["laptop"]


@pytest.fixture(scope="module")
def network() -> PageNetwork:
    torch.manual_seed(4)
    network = network_for(LAPTOP).eval()
    with torch.no_grad():
        # Heads that start at zero would hide what comes before them.
        for layer in (network.refiner.correction, network.refiner.to_vector):
            layer.weight.normal_(0, 0.02)
    return network


@pytest.fixture(scope="module")
def exported(network: PageNetwork, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command writes."""
    folder = tmp_path_factory.mktemp("batch")
    config = json.dumps({"augmentation": {"flip_probability": 0.5}})
    state = {"average": network.state_dict(), "category": json.dumps(category_document(LAPTOP)), "config": config}
    save_checkpoint(folder / "laptop.pt", **state, step=1, samples=1)
    command = ["onnx", str(folder / "laptop.pt"), "-o", str(folder / "dynamic.onnx"), "--compare-on", str(RECORDING)]
    assert main([*command, "--batch", "dynamic"]) == 0
    return folder / "dynamic.onnx"


@pytest.fixture(scope="module")
def dynamic(exported: Path) -> onnx.ModelProto:
    return onnx.load(exported)


def rows(model: onnx.ModelProto) -> set[str | int]:
    values = (*model.graph.input, *model.graph.output)
    dims = [value.type.tensor_type.shape.dim[0] for value in values]
    assert {value.name for value in values} == {*INPUT_NAMES, *OUTPUT_NAMES}
    return {dim.dim_param or dim.dim_value for dim in dims}


def test_of_several_objects_it_says_what_it_says_of_each_alone(dynamic: onnx.ModelProto) -> None:
    two = with_rows(dynamic, 2)
    assert (rows(dynamic), rows(two)) == ({"batch"}, {2})
    metadata = read_bundle(ROOT / "runtime" / "bundles" / "laptop.onnx").metadata
    given = [feeds(metadata, *sample) for sample in samples_of(metadata, open_source(RECORDING), 3)]
    free, fixed = (
        ort.InferenceSession(one.SerializeToString(), providers=["CPUExecutionProvider"]) for one in (dynamic, two)
    )
    alone = [[np.asarray(value) for value in free.run(OUTPUT_NAMES, one)] for one in given]
    for session, chosen in ((free, (0, 1, 2)), (free, (2, 1)), (fixed, (0, 1)), (fixed, (2, 0))):
        stacked = {name: np.concatenate([given[k][name] for k in chosen]) for name in INPUT_NAMES}
        for nth, together in enumerate(map(np.asarray, session.run(OUTPUT_NAMES, stacked))):
            assert len(together) == len(chosen)
            for ours, k in zip(together, chosen, strict=True):
                np.testing.assert_allclose(ours, alone[k][nth][0], atol=1e-5)


def test_the_runtime_refuses_any_batch_but_one_says_how_to_get_it_and_shows_what_it_is(
    exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(BundleError, match=r"dynamic\.onnx: it takes a free number of objects .* without --batch"):
        Network(exported)
    assert runtime(["inspect", str(exported)]) == 0
    assert "category       laptop" in capsys.readouterr().out
    write_bundle(with_rows(onnx.load(exported), 2), LAPTOP, tmp_path / "two.onnx", mirrored=True, provenance={})
    with pytest.raises(BundleError, match=r"two\.onnx: it takes 2 objects at once"):
        Network(tmp_path / "two.onnx")


@pytest.mark.parametrize("wrong", ["0", "-1", "17", "many", "2.5"])
def test_a_batch_that_is_none_is_refused_before_anything_is_read(
    wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["onnx", str(tmp_path / "none.pt"), "-o", str(tmp_path / "none.onnx"), "--compare-on", str(RECORDING)]
    assert main([*command, "--batch", wrong]) == 2
    assert "--batch: expected dynamic or 2 to 16" in capsys.readouterr().err
