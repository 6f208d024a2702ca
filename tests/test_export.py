"""A bundle is the checkpoint's network and says all the runtime needs; anything else is refused with the reason."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import onnx
import pytest
import torch

from page_export.cli import main
from page_export.edge_network import EdgeNetwork
from page_export.onnx_export import OPSET, RuntimeSignature, example_inputs, folded, graph_of, write_bundle
from page_export.parity import (
    MAX_OUTPUT_DIFFERENCE,
    MAX_ROTATION_DEG,
    MAX_TRANSLATION_MM,
    MAX_UNDECIDED_SHARE,
    Difference,
    Parity,
    compare,
    samples_of,
)
from page_export.parity_commands import table
from page_runtime.bundle import METADATA_KEY
from page_runtime.bundle_fields import BundleError
from page_runtime.capture.playback import open_source
from page_runtime.category_document import category_document
from page_runtime.neighbours import find_neighbours
from page_runtime.network import Network
from page_runtime.onnx_file import sealed
from page_runtime.signature import INPUT_NAMES, OUTPUT_NAMES
from page_training.categories import CATEGORIES
from page_training.checkpoint import save_checkpoint
from page_training.config import Fusion
from page_training.layers import FUSERS
from page_training.network import PageNetwork, network_for
from page_training.record import record_split

BOX = CATEGORIES["box"]


@pytest.fixture(scope="module")
def network() -> PageNetwork:
    """Untrained, but with batch norms that do something, negative slopes included."""
    torch.manual_seed(0)
    network = network_for(BOX).eval()
    with torch.no_grad():
        for module in network.modules():
            if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
                assert module.running_mean is not None
                assert module.running_var is not None
                module.running_mean.normal_(0, 0.2)
                module.running_var.uniform_(0.5, 2.0)
                module.weight.uniform_(-0.5, 2.0)
                module.bias.normal_()
    return network


@pytest.fixture(scope="module")
def bundle(network: PageNetwork, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bundle") / "box.onnx"
    write_bundle(graph_of(network), BOX, path, mirrored=True, provenance={"note": "untrained"})
    return path


def test_folding_batch_norms_changes_nothing(network: PageNetwork) -> None:
    inputs = example_inputs()
    with torch.no_grad():
        for plain, fused in zip(
            RuntimeSignature(network)(*inputs), RuntimeSignature(folded(network))(*inputs), strict=True
        ):
            torch.testing.assert_close(fused, plain, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("category", sorted(CATEGORIES))
def test_the_edge_form_is_the_same_function(category: str) -> None:
    torch.manual_seed(2)
    network = folded(network_for(CATEGORIES[category]))
    with torch.no_grad():
        # As much as trained ones say: heads that start at zero would hide what is wrong before them.
        for layer in (network.refiner.correction, network.refiner.to_vector):
            layer.weight.normal_(0, 0.02)
        compared_with_edge(network)


@pytest.mark.parametrize("fusion", sorted(FUSERS))
def test_the_edge_form_is_the_same_function_for_every_fusion(fusion: Fusion) -> None:
    torch.manual_seed(3)
    with torch.no_grad():
        compared_with_edge(folded(network_for(BOX, fusion)))


def compared_with_edge(network: PageNetwork) -> None:
    for inputs in (example_inputs(), real_inputs()):
        plain, edge = RuntimeSignature(network)(*inputs), EdgeNetwork(network).eval()(*inputs)
        for ours, theirs in zip(edge, plain, strict=True):
            assert ours.shape == theirs.shape
            torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=1e-4)


def real_inputs() -> tuple[torch.Tensor, ...]:
    """Points of a bent sheet, 200 of them repeated, as for an object far away; pixels up to the picture's border."""
    image, _, _, *_ = example_inputs()
    generator = torch.Generator().manual_seed(1)
    pixels = (torch.rand(200, 2, generator=generator) * 226 - 1.5).clamp(-0.5, 223.5)
    x, y = (pixels / 224 - 0.5).unbind(1)
    points = torch.stack([x, y, 0.3 * (x * x - y).abs()], dim=1)
    rows = torch.arange(2048) % 200
    points, pixels = points[rows], pixels[rows]
    neighbours = find_neighbours(points.numpy())
    tables = [torch.from_numpy(getattr(neighbours, name)[None]) for name in INPUT_NAMES[3:]]
    return image, points[None], pixels[None], *tables


def test_bundle_and_checkpoint_agree_on_outputs_and_poses(network: PageNetwork, bundle: Path, tmp_path: Path) -> None:
    record_split("box", tmp_path / "recording", split="validation", frames=3, width=480)
    loaded = Network(bundle, threads=1)
    source = open_source(tmp_path / "recording")
    parity, again = (
        compare(loaded.metadata, loaded.run_raw, network, samples_of(loaded.metadata, source)) for _ in range(2)
    )
    assert parity.samples == 3
    assert max(difference.max for difference in parity.outputs.values()) < 1e-4
    assert parity.rotation_deg.max < 0.02
    assert parity.translation_mm.max < 0.1
    assert parity.holds
    assert parity.document() == again.document()
    assert all(0.0 < rounding < 1e-3 for rounding in parity.rounding.values())


def test_another_network_is_not_the_same(bundle: Path, tmp_path: Path) -> None:
    record_split("box", tmp_path / "recording", split="validation", frames=1, width=480)
    loaded = Network(bundle, threads=1)
    torch.manual_seed(1)
    samples = samples_of(loaded.metadata, open_source(tmp_path / "recording"))
    parity = compare(loaded.metadata, loaded.run_raw, network_for(BOX), samples)
    assert not parity.holds
    assert max(difference.max for difference in parity.outputs.values()) > 1e-2


def test_verify_keeps_what_it_found_in_the_bundle_and_as_json(
    network: PageNetwork, bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record_split("box", tmp_path / "recording", split="validation", frames=2, width=480)
    copy = tmp_path / "box.onnx"
    copy.write_bytes(bundle.read_bytes())
    config = {"augmentation": {"flip_probability": 0.5}}
    state = {"average": network.state_dict(), "category": json.dumps(category_document(BOX))}
    state["config"] = json.dumps(config)
    save_checkpoint(tmp_path / "box.pt", **state, step=1, samples=1)
    given = ["verify", str(copy), "--against", str(tmp_path / "box.pt"), "--data", str(tmp_path / "recording")]
    assert main([*given, "--json", str(tmp_path / "parity.json")]) == 0
    assert "same network" in capsys.readouterr().out
    document = json.loads((tmp_path / "parity.json").read_text())
    assert document["samples"] == 2
    assert Network(copy, threads=1).metadata.provenance["parity"] == document
    before = copy.read_bytes()
    torch.manual_seed(1)
    save_checkpoint(tmp_path / "box.pt", **(state | {"average": network_for(BOX).state_dict()}), step=1, samples=1)
    assert main(given) == 1
    assert "NOT the same network" in capsys.readouterr().out
    assert copy.read_bytes() == before


def test_bundle_is_one_small_file_of_standard_operators(bundle: Path) -> None:
    model = onnx.load(str(bundle), load_external_data=False)
    assert {node.domain for node in model.graph.node} == {""}
    assert [entry.version for entry in model.opset_import if entry.domain == ""] == [OPSET]
    assert all(tensor.data_location == onnx.TensorProto.DEFAULT for tensor in model.graph.initializer)
    assert not any(node.op_type == "BatchNormalization" for node in model.graph.node)
    assert bundle.stat().st_size <= 8e6
    assert tuple(value.name for value in model.graph.input) == INPUT_NAMES
    assert tuple(value.name for value in model.graph.output) == OUTPUT_NAMES
    for place in (Path.home(), Path(__file__).parent.parent, Path(sys.prefix)):
        assert str(place.resolve()).encode() not in bundle.read_bytes()


def rewritten(bundle: Path, path: Path, change) -> Path:
    model = onnx.load(str(bundle))
    change(model)
    path.write_bytes(sealed(model.SerializeToString()))
    return path


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda b, p: p.write_bytes(b.read_bytes()[: b.stat().st_size // 2]), "cut short"),
        (lambda _, p: p.write_bytes(b"not a model at all" * 100), "is it a complete"),
        (lambda _, p: p.write_bytes(b""), "bytes, got 0"),
        (lambda _, __: None, "no file"),
        (lambda b, p: rewritten(b, p, lambda m: m.metadata_props.pop(0)), METADATA_KEY),
        (lambda b, p: rewritten(b, p, lambda m: m.graph.output.pop()), "outputs"),
    ],
)
def test_a_file_that_is_not_a_bundle_is_refused_with_the_reason(bundle: Path, tmp_path: Path, spoil, word: str) -> None:
    path = tmp_path / "spoilt.onnx"
    spoil(bundle, path)
    with pytest.raises(BundleError, match=word):
        Network(path)


def parity_with(undecided: int) -> Parity:
    same = Difference(0.0, 0.0)
    names: list[str] = list(OUTPUT_NAMES)
    return Parity(
        50, dict.fromkeys(names, same), dict.fromkeys(names, 0.0), same, same, 0, undecided=undecided, parts=200
    )


def test_a_bundle_is_asked_to_be_no_nearer_than_rounding_lets_the_checkpoint_be() -> None:
    off = replace(parity_with(0), outputs=dict.fromkeys(OUTPUT_NAMES, Difference(1.7e-4, 1e-6)))
    assert not off.holds
    assert replace(off, rounding=dict.fromkeys(OUTPUT_NAMES, 1e-4)).holds
    assert not replace(off, rounding=dict.fromkeys(OUTPUT_NAMES, 8e-5)).holds


def test_parts_that_toss_a_coin_are_told_in_words_and_are_few() -> None:
    assert parity_with(10).holds
    assert not parity_with(11).holds
    assert "4 parts (2.0 %, at most 5 %) are undecided and left out: two fits" in table(parity_with(4))
    assert "undecided" not in table(parity_with(0))


@pytest.mark.parametrize("command", ["onnx", "verify"])
def test_help_states_the_bounds_of_a_comparison(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help"])
    told = " ".join(capsys.readouterr().out.split())
    assert f"agrees to {MAX_OUTPUT_DIFFERENCE:g}".replace("0.0001", "1e-4") in told
    assert f"every pose to {MAX_ROTATION_DEG:g} deg and {MAX_TRANSLATION_MM:g} mm" in told
    assert f"at most {100 * MAX_UNDECIDED_SHARE:g} % of all" in told
