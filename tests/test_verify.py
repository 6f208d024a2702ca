"""A bundle says which weights it was made from, and keeps the comparison that rests on most."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import torch

from page_export import provenance
from page_export.bundle_writer import bundle_bytes
from page_export.cli import main
from page_export.provenance import commit, trained_on, weights_sha256
from page_runtime.bundle_file import read_bundle
from page_runtime.category_document import category_document
from page_training.categories import CATEGORIES
from page_training.checkpoint import keep_weights, load_checkpoint, save_checkpoint
from page_training.network import network_for

ROOT = Path(__file__).resolve().parents[1]
RECORDING = ROOT / "tests" / "data" / "laptop"
LAPTOP = CATEGORIES["laptop"]
POINTS = 512


def write_checkpoint(path: Path, average: dict[str, Any], **further: Any) -> Path:
    config = json.dumps({"augmentation": {"flip_probability": 0.5}, "also_from": "/cache/of/mine", "also_share": 0.5})
    document = json.dumps(category_document(LAPTOP))
    save_checkpoint(path, average=average, category=document, config=config, step=1, samples=1, **further)
    return path


@pytest.fixture(scope="module")
def average() -> dict[str, torch.Tensor]:
    """Untrained, but with heads that say something."""
    torch.manual_seed(4)
    network = network_for(LAPTOP).eval()
    with torch.no_grad():
        for layer in (network.refiner.correction, network.refiner.to_vector):
            layer.weight.normal_(0, 0.02)
    return network.state_dict()


@pytest.fixture(scope="module")
def checkpoint(average: dict[str, torch.Tensor], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a run, which holds more than what is kept of it."""
    return write_checkpoint(tmp_path_factory.mktemp("run") / "checkpoint.pt", average, optimizers=[], network=average)


@pytest.fixture(scope="module")
def exported(checkpoint: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command writes, of 512 points. Read only."""
    path = tmp_path_factory.mktemp("bundle") / "laptop.onnx"
    command = ["onnx", str(checkpoint), "-o", str(path), "--compare-on", str(RECORDING)]
    assert main([*command, "--points", str(POINTS)]) == 0
    return path


@pytest.fixture
def bundle(exported: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(exported, tmp_path))


def verified(bundle: Path, checkpoint: Path, *further: str) -> int:
    return main(["verify", str(bundle), "--against", str(checkpoint), "--data", str(RECORDING), *further])


def test_a_bundle_of_other_points_says_so_and_what_it_was_made_from(
    exported: Path, average: dict[str, torch.Tensor]
) -> None:
    metadata = read_bundle(exported).metadata
    assert metadata.num_points == POINTS
    assert metadata.provenance["weights_sha256"] == weights_sha256(average)
    assert metadata.provenance["parity"]["weights_sha256"] == weights_sha256(average)
    assert metadata.provenance["parity"]["samples"] == 5
    assert metadata.provenance["trained_on"].startswith("procedural scenes and imported frames of mine")


def test_the_weights_kept_of_a_run_verify_the_bundle_made_from_it(
    bundle: Path, checkpoint: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keep_weights(checkpoint, tmp_path / "kept.pt")
    assert (tmp_path / "kept.pt").read_bytes() != checkpoint.read_bytes()
    assert verified(bundle, tmp_path / "kept.pt") == 0
    said = capsys.readouterr().out
    assert "made from the weights in" in said
    assert "this comparison is kept in the bundle" in said


def test_a_comparison_of_fewer_samples_does_not_replace_one_of_more(
    bundle: Path, checkpoint: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = bundle.read_bytes()
    assert verified(bundle, checkpoint, "--frames", "2") == 0
    assert "keeps the comparison of 5 samples it holds, as this one rests on 2" in capsys.readouterr().out
    assert bundle.read_bytes() == before


def test_other_weights_fail_even_where_the_answers_are_the_same(
    bundle: Path, average: dict[str, torch.Tensor], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A counter that no answer depends on."""
    name = next(name for name in average if name.endswith("num_batches_tracked"))
    other = write_checkpoint(tmp_path / "other.pt", average | {name: average[name] + 1})
    before = bundle.read_bytes()
    assert verified(bundle, other, "--frames", "2") == 1
    said = capsys.readouterr().out
    assert "\nsame network" in said
    assert f"NOT made from the weights in {other}" in said
    assert "the comparison of 5 samples it holds is of before, and stays" in said
    assert bundle.read_bytes() == before


def test_a_bundle_of_before_is_compared_and_said_not_to_name_its_weights(
    bundle: Path, checkpoint: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import onnx

    metadata = read_bundle(bundle).metadata
    del metadata.provenance["weights_sha256"]
    metadata.provenance["parity"] = {"checkpoint_sha256": "of a file that is gone", "samples": 2, "holds": True}
    bundle.write_bytes(bundle_bytes(onnx.load(bundle), metadata))
    assert verified(bundle, checkpoint, "--frames", "2") == 0
    assert "does not say which weights it was made from" in capsys.readouterr().out
    assert read_bundle(bundle).metadata.provenance["parity"]["weights_sha256"]


def test_a_hash_is_of_names_types_shapes_and_values_and_of_no_order() -> None:
    weights = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.tensor(3)}
    of = weights_sha256(weights)
    assert weights_sha256(dict(reversed(weights.items()))) == of
    assert weights_sha256({"a": weights["a"].t().contiguous().t(), "b": weights["b"]}) == of
    others = [
        {"a": weights["a"].reshape(3, 2), "b": weights["b"]},
        {"a": weights["a"].double(), "b": weights["b"]},
        {"a": weights["a"], "c": weights["b"]},
        {"a": weights["a"] + 1e-3, "b": weights["b"]},
        {"a": weights["a"]},
    ]
    assert len({of, *(weights_sha256(other) for other in others)}) == 1 + len(others)


def test_kept_weights_have_the_hash_of_the_run(checkpoint: Path, tmp_path: Path) -> None:
    keep_weights(checkpoint, tmp_path / "kept.pt")
    one, other = (weights_sha256(load_checkpoint(path)["average"]) for path in (checkpoint, tmp_path / "kept.pt"))
    assert one == other


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({}, "procedural scenes only"),
        ({"also_from": None, "also_share": 0.5, "start_from": None}, "procedural scenes only"),
        ({"also_from": "a/real", "also_share": 0.0}, "procedural scenes only"),
        ({"also_from": "a/real", "also_share": 1.0}, "imported frames of real only"),
        (
            {"also_from": "a/real", "also_share": 0.25, "start_from": "box.pt"},
            "procedural scenes and imported frames of real (25 % of the samples); began with the weights that the "
            "settings name as start_from",
        ),
    ],
)
def test_what_a_network_was_trained_on_is_its_settings_word(config: dict[str, Any], words: str) -> None:
    assert trained_on(config) == words


def test_the_commit_is_that_of_the_package_wherever_it_is_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = commit()
    monkeypatch.chdir(tmp_path)
    assert commit() == here
    for call in (
        ["init", "--quiet"],
        ["-c", "user.name=a", "-c", "user.email=a", "commit", "--allow-empty", "-qm", "x"],
    ):
        subprocess.run(["git", *call], check=True, cwd=tmp_path)
    installed = Path(shutil.copy(provenance.__file__, tmp_path))
    assert commit(installed).startswith("unknown")
