"""A bundle is untrusted input: it is refused with a reason before onnxruntime sees it."""

from __future__ import annotations

import ast
import os
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import helper

from bundle_attacks import ATTACKS
from metadata_attacks import METADATA_ATTACKS
from page_export.bundle_writer import bundle_bytes
from page_runtime.allowed_operators import RULES
from page_runtime.bundle import METADATA_KEY, BundleMetadata
from page_runtime.bundle_fields import BundleError
from page_runtime.bundle_file import MAX_BUNDLE_BYTES, read_bundle
from page_runtime.graph_limits import MAX_MADE_BYTES, MAX_MOVED_BYTES, MAX_MULTIPLICATIONS, size_of
from page_runtime.network import Network
from page_runtime.onnx_file import CHECKSUM_KEY, checksum_of, read_onnx, sealed

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = ROOT / "runtime" / "bundles" / "box.onnx"


def twice_the_graph(data: bytes) -> bytes:
    model = onnx.load_from_string(data)
    part = onnx.ModelProto()
    part.graph.CopyFrom(model.graph)
    return data + part.SerializeToString()


@pytest.mark.parametrize("attack", ATTACKS | METADATA_ATTACKS)
def test_an_attack_with_a_right_checksum_is_refused_with_its_reason(
    oracle_bundle: Path, tmp_path: Path, attack: str
) -> None:
    change, reason = (ATTACKS | METADATA_ATTACKS)[attack]
    model = onnx.load(oracle_bundle)
    change(model)
    path = tmp_path / "attack.onnx"
    path.write_bytes(sealed(model.SerializeToString()))
    with pytest.raises(BundleError, match=reason):
        read_bundle(path)


def test_a_graph_given_twice_is_refused(oracle_bundle: Path, tmp_path: Path) -> None:
    path = tmp_path / "twice.onnx"
    path.write_bytes(sealed(twice_the_graph(oracle_bundle.read_bytes())))
    with pytest.raises(BundleError, match="graph is given twice"):
        read_bundle(path)


def test_a_file_larger_than_any_bundle_is_refused_without_reading_it(tmp_path: Path) -> None:
    path = tmp_path / "large.onnx"
    path.touch()
    os.truncate(path, 1 << 40)
    with pytest.raises(BundleError, match=f"expected 1 to {MAX_BUNDLE_BYTES} bytes"):
        read_bundle(path)


def test_a_file_of_nothing_but_small_fields_is_refused_early(tmp_path: Path) -> None:
    path = tmp_path / "fields.onnx"
    path.write_bytes(b"\x32\x00" * (MAX_BUNDLE_BYTES // 2))
    with pytest.raises(BundleError, match="fields"):
        read_bundle(path)


@pytest.mark.parametrize("words", ["x" * (1 << 20), "\x1b[2J" * 9])
def test_what_is_said_of_a_refused_file_is_short_and_no_command_to_a_terminal(
    oracle_bundle: Path, tmp_path: Path, words: str
) -> None:
    model = onnx.load(oracle_bundle)
    model.graph.node[0].op_type = words
    path = tmp_path / "talkative.onnx"
    path.write_bytes(sealed(model.SerializeToString()))
    with pytest.raises(BundleError, match=r"operator 0 .* not an operator that bundles use") as told:
        read_bundle(path)
    assert len(str(told.value)) < 1000 + len(str(path))
    assert str(told.value).isprintable()


def test_the_checksum_is_of_all_other_bytes(oracle_bundle: Path) -> None:
    data = oracle_bundle.read_bytes()
    (stated,) = [e.value for e in onnx.load(oracle_bundle).metadata_props if e.key == CHECKSUM_KEY]
    assert stated == checksum_of(data)
    assert sealed(data) == data
    at = data.index(b"oracle of a test")
    assert checksum_of(data[:at] + b"O" + data[at + 1 :]) != stated


def test_shapes_and_types_are_those_onnx_infers() -> None:
    """The bound is the size itself: an independent inference finds as many elements and bytes."""
    model = onnx.load(SHIPPED)
    inferred = onnx.shape_inference.infer_shapes(model, strict_mode=True, data_prop=True).graph
    values = {value.name: value for value in (*inferred.value_info, *inferred.output, *inferred.input)}
    made = {value.name for value in inferred.input} | {name for node in inferred.node for name in node.output if name}
    elements = made_bytes = 0
    for name in made:
        kind = values[name].type.tensor_type
        count = int(np.prod([dim.dim_value for dim in kind.shape.dim], dtype=np.int64))
        elements += count
        made_bytes += count * helper.tensor_dtype_to_np_dtype(kind.elem_type).itemsize
    size = size_of(read_onnx(SHIPPED.read_bytes()).graph)
    assert (size.elements, size.made_bytes) == (elements, made_bytes)


@pytest.mark.parametrize("path", sorted(SHIPPED.parent.glob("*.onnx")), ids=lambda path: path.stem)
def test_a_network_eight_times_as_large_as_a_shipped_one_is_within_the_limits(path: Path) -> None:
    size = read_bundle(path).size
    assert 8 * size.made_bytes <= MAX_MADE_BYTES
    assert 8 * size.moved_bytes <= MAX_MOVED_BYTES
    assert 8 * size.multiplications <= MAX_MULTIPLICATIONS


def test_every_operator_with_a_rule_is_an_operator_of_onnx() -> None:
    for kind, (_, attributes) in RULES.items():
        schema = onnx.defs.get_schema(kind, 18)
        old = onnx.defs.get_schema(kind, 11) if kind.startswith("Reduce") else schema
        newer = onnx.defs.get_schema(kind, 21)
        assert attributes <= set(schema.attributes) | set(old.attributes) | set(newer.attributes), kind


def test_nothing_unpickles_what_comes_from_outside() -> None:
    """torch.load takes weights only; numpy.load, which takes no pickles by default, is not told to; pickle itself is
    for messages between a camera's process and its parent."""
    for path in [*ROOT.glob("runtime/**/*.py"), *ROOT.glob("export/**/*.py"), *ROOT.glob("calibration/**/*.py")]:
        name = path.relative_to(ROOT).as_posix()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            called = ast.unparse(node.func)
            keywords = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            if called == "torch.load":
                assert keywords.get("weights_only") == "True", name
            assert keywords.get("allow_pickle", "False") == "False", name
            if called in ("pickle.loads", "pickle.load", "pickle.Unpickler"):
                assert name.startswith("runtime/page_runtime/capture/"), name


def test_what_the_writer_writes_is_read_and_is_the_same_network(oracle_bundle: Path, tmp_path: Path) -> None:
    model = onnx.load(oracle_bundle)
    metadata = BundleMetadata.from_json(next(e.value for e in model.metadata_props if e.key == METADATA_KEY))
    again = tmp_path / "again.onnx"
    again.write_bytes(bundle_bytes(model, metadata))
    assert again.read_bytes() == oracle_bundle.read_bytes()
    assert Network(again, threads=1).metadata.to_json() == metadata.to_json()
