"""A bundle is untrusted input: it is refused with a reason before onnxruntime sees it, or runs as it should.

Mutants are loaded in another process whose memory is limited: a crash or a bomb fails the test and nothing else.
"""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from page_export.bundle_writer import bundle_bytes
from page_runtime.allowed_operators import RULES
from page_runtime.bundle import METADATA_KEY, BundleError, BundleMetadata
from page_runtime.bundle_file import MAX_BUNDLE_BYTES, read_bundle
from page_runtime.graph_limits import size_of
from page_runtime.network import Network
from page_runtime.onnx_file import CHECKSUM_KEY, checksum_of, read_onnx, sealed

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = ROOT / "runtime" / "bundles" / "box.onnx"


def initializer(model: onnx.ModelProto, name: str, value: Any, dtype: type = np.float32) -> str:
    model.graph.initializer.append(numpy_helper.from_array(np.asarray(value, dtype), name))
    return name


def operator(model: onnx.ModelProto, kind: str, inputs: list[str], output: str = "bomb", **attributes: Any) -> None:
    model.graph.node.append(helper.make_node(kind, inputs, [output], **attributes))


def some_graph() -> onnx.GraphProto:
    value = helper.make_tensor_value_info("inner", TensorProto.FLOAT, [1])
    node = helper.make_node("Identity", ["points"], ["inner"])
    return helper.make_graph([node], "inner", [], [value])


def external_data(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"


def giant_tensor(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    del tensor.dims[:]
    tensor.dims.extend([1 << 40])


def overflowing_tensor(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    del tensor.dims[:]
    tensor.dims.extend([1 << 32, 1 << 32])
    tensor.raw_data = b""


def column_times_row(model: onnx.ModelProto) -> None:
    column, row = np.ones((1 << 17, 1)), np.ones((1, 1 << 17))
    operator(model, "MatMul", [initializer(model, "column", column), initializer(model, "row", row)])


def column_plus_row(model: onnx.ModelProto) -> None:
    column, row = np.ones((1 << 17, 1)), np.ones((1, 1 << 17))
    operator(model, "Add", [initializer(model, "column", column), initializer(model, "row", row)])


def doubled_forty_times(model: onnx.ModelProto) -> None:
    name = initializer(model, "single", [1.0])
    for step in range(40):
        operator(model, "Concat", [name, name], f"twice{step}", axis=0)
        name = f"twice{step}"


def expanded(model: onnx.ModelProto) -> None:
    operator(model, "Expand", [initializer(model, "single", [1.0]), initializer(model, "wide", [1 << 40], np.int64)])


def expanded_to_a_computed_shape(model: onnx.ModelProto) -> None:
    operator(model, "Cast", ["up1"], "computed", to=TensorProto.INT64)
    operator(model, "Expand", [initializer(model, "single", [1.0]), "computed"])


def enlarged(model: onnx.ModelProto) -> None:
    operator(model, "Resize", ["image", "", initializer(model, "scales", [1, 1, 60, 60])])


def gathered(model: onnx.ModelProto) -> None:
    rows = initializer(model, "rows", np.ones((1, 1 << 16)))
    operator(model, "Gather", [rows, initializer(model, "index", np.zeros(1 << 16), np.int64)])


def padded_convolution(model: onnx.ModelProto) -> None:
    kernel = initializer(model, "kernel", np.ones((1, 3, 1, 1)))
    operator(model, "Conv", ["image", kernel], pads=[1 << 20] * 4)


def many_multiplications(model: onnx.ModelProto) -> None:
    name = initializer(model, "square", np.ones((1 << 11, 1 << 11)))
    for step in range(10):
        operator(model, "MatMul", [name, name], f"product{step}")
        name = f"product{step}"


def many_operators(model: onnx.ModelProto) -> None:
    for step in range(5000):
        operator(model, "Relu", ["points"], f"many{step}")


def twice_the_graph(data: bytes) -> bytes:
    model = onnx.load_from_string(data)
    part = onnx.ModelProto()
    part.graph.CopyFrom(model.graph)
    return data + part.SerializeToString()


def with_metadata(change: Callable[[dict[str, Any]], Any]) -> Callable[[onnx.ModelProto], None]:
    def apply(model: onnx.ModelProto) -> None:
        (entry,) = [entry for entry in model.metadata_props if entry.key == METADATA_KEY]
        document = json.loads(entry.value)
        entry.value = change(document) or json.dumps(document)

    return apply


def add_entry(model: onnx.ModelProto) -> None:
    entry = model.metadata_props.add()
    entry.key, entry.value = "surprise", "x"


ATTACKS: dict[str, tuple[Callable[[onnx.ModelProto], Any], str]] = {
    "data outside the file": (external_data, "data outside the file"),
    "a tensor larger than its data": (giant_tensor, "needs .* bytes, got"),
    "a tensor whose size overflows": (overflowing_tensor, "needs .* bytes, got 0"),
    "a tensor of texts": (
        lambda m: m.graph.initializer.append(numpy_helper.from_array(np.array(["x"], object), "t")),
        "raw data",
    ),
    "column times row": (column_times_row, r"'MatMul'\): 'bomb' would be \[131072, 131072\]"),
    "column plus row": (column_plus_row, r"'Add'\): 'bomb' would be"),
    "doubled forty times": (doubled_forty_times, "'Concat'.* would be"),
    "expanded": (expanded, "'Expand'.* would be"),
    "expanded to a computed shape": (expanded_to_a_computed_shape, "decides on sizes"),
    "enlarged": (enlarged, "'Resize'.* would be"),
    "gathered": (gathered, "'Gather'.* would be"),
    "a padded convolution": (padded_convolution, "'Conv'.* would be"),
    "many multiplications": (many_multiplications, "multiplies more than"),
    "many operators": (many_operators, "at most 4096 operators"),
    "a giant input": (lambda m: m.graph.input[0].type.tensor_type.shape.dim[2].__setattr__("dim_value", 1 << 40), "be"),
    "an input without a size": (lambda m: m.graph.input[1].type.tensor_type.shape.dim[1].ClearField("value"), "fixed"),
    "a graph in a node": (
        lambda m: operator(m, "If", ["points"], then_branch=some_graph(), else_branch=some_graph()),
        "a graph inside a node",
    ),
    "a tensor in a node": (
        lambda m: operator(m, "Constant", [], value=numpy_helper.from_array(np.ones(3, np.float32))),
        "a tensor inside a node",
    ),
    "an unknown operator": (lambda m: operator(m, "Frobnicate", ["points"]), "not an operator that bundles use"),
    "an operator without a bound": (lambda m: operator(m, "NonZero", ["points"]), "not an operator that bundles use"),
    "an operator of another domain": (
        lambda m: operator(m, "Gelu", ["points"], domain="com.microsoft"),
        "of the domain 'com.microsoft'",
    ),
    "another domain": (lambda m: m.opset_import.append(helper.make_opsetid("evil", 1)), "domain 'evil'"),
    "another opset": (lambda m: m.opset_import[0].__setattr__("version", 7), "expected one opset"),
    "an unknown attribute": (lambda m: operator(m, "Relu", ["points"], surprise=1), "not understood"),
    "a value from nowhere": (lambda m: operator(m, "Relu", ["nowhere"]), "is not there before it"),
    "a value given twice": (lambda m: operator(m, "Relu", ["points"], "points"), "is given twice"),
    "a cycle": (lambda m: operator(m, "Relu", ["bomb"]), "is not there before it"),
    "a sparse tensor": (lambda m: m.graph.sparse_initializer.add(), "sparse initializers"),
    "declared inner shapes": (
        lambda m: m.graph.value_info.append(helper.make_tensor_value_info("x", 1, [1])),
        "declared shapes",
    ),
    "a function": (lambda m: m.functions.add(), "functions are not allowed"),
    "a training graph": (lambda m: m.training_info.add(), "training graphs are not allowed"),
    "more metadata": (add_entry, "not understood: .*surprise"),
    "metadata twice": (lambda m: m.metadata_props.append(m.metadata_props[0]), "given twice"),
    "metadata of another version": (with_metadata(lambda d: d.update(version=99)), "version 4, got 99"),
    "metadata with a field more": (with_metadata(lambda d: d.update(surprise=1)), "not understood .*surprise"),
    "metadata of another opset": (with_metadata(lambda d: d.update(opset=17)), "opset 17"),
    "metadata nested deeply": (with_metadata(lambda _: "[" * 200_000), "expected JSON"),
    "metadata with a long number": (with_metadata(lambda _: "9" * 100_000), "expected JSON"),
    "metadata with an infinite number": (with_metadata(lambda d: d.update(num_points=float("inf"))), "bundle metadata"),
    "metadata with a field twice": (with_metadata(lambda _: '{"version": 4, "version": 4}'), "given twice"),
    "metadata without end": (with_metadata(lambda _: "{" + " " * (5 << 20)), "at most"),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_an_attack_with_a_right_checksum_is_refused_with_its_reason(
    oracle_bundle: Path, tmp_path: Path, attack: str
) -> None:
    change, reason = ATTACKS[attack]
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


def test_the_checksum_is_of_all_other_bytes(oracle_bundle: Path) -> None:
    data = oracle_bundle.read_bytes()
    (stated,) = [e.value for e in onnx.load(oracle_bundle).metadata_props if e.key == CHECKSUM_KEY]
    assert stated == checksum_of(data)
    assert sealed(data) == data
    at = data.index(b"oracle of a test")
    assert checksum_of(data[:at] + b"O" + data[at + 1 :]) != stated


def test_shapes_are_those_onnx_infers() -> None:
    """The bound is the size itself: an independent inference finds as many elements."""
    model = onnx.load(SHIPPED)
    inferred = onnx.shape_inference.infer_shapes(model, strict_mode=True, data_prop=True).graph
    made = {value.name: value for value in (*inferred.value_info, *inferred.output)}
    count = 0
    for node in inferred.node:
        for name in filter(None, node.output):
            count += int(np.prod([dim.dim_value for dim in made[name].type.tensor_type.shape.dim], dtype=np.int64))
    count += sum(int(np.prod([d.dim_value for d in v.type.tensor_type.shape.dim])) for v in inferred.input)
    assert size_of(read_onnx(SHIPPED.read_bytes()).graph).elements == count


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


LOADS = """
import hashlib, json, resource, signal, sys, time
import numpy as np
from pathlib import Path
from page_runtime.bundle import BundleError
from page_runtime.network import Network
resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
rng = np.random.default_rng(0)
shapes = json.loads(sys.argv[2])
feeds = {name: (rng.integers(0, 32, shape, np.int32) if name[:2] in ("gr", "up") else rng.random(shape, np.float32))
         for name, shape in shapes.items()}
for path in sorted(Path(sys.argv[1]).glob("*.onnx")):
    signal.alarm(20)
    begin = time.perf_counter()
    try:
        digest = hashlib.sha256()
        for value in Network(path, threads=1).session.run(None, feeds):
            digest.update(value.tobytes())
        result = digest.hexdigest()
    except BundleError as error:
        result = "refused: " + str(error)
    print(json.dumps([path.name, result, time.perf_counter() - begin]), flush=True)
"""


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Bits flipped, bytes cut out, repeated, put in, or the end missing."""
    out = bytearray(data)
    kind = rng.integers(6)
    at = int(rng.integers(len(out)))
    length = int(rng.integers(1, 200))
    if kind == 0:
        for place in rng.integers(len(out), size=int(rng.integers(1, 8))):
            out[place] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        del out[at:]
    elif kind == 2:
        del out[at : at + length]
    elif kind == 3:
        out[at:at] = out[at : at + length]
    elif kind == 4:
        out[at:at] = rng.bytes(length)
    else:
        out[at : at + length] = rng.bytes(len(out[at : at + length]))
    return bytes(out)


def loaded(folder: Path, bundle: Path) -> dict[str, tuple[str, float]]:
    """What a process of its own, with limited memory, says of the bundles in a folder."""
    shapes = {v.name: [d.dim_value for d in v.type.tensor_type.shape.dim] for v in onnx.load(bundle).graph.input}
    done = subprocess.run(
        [sys.executable, "-c", LOADS, str(folder), json.dumps(shapes)],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return {name: (result, seconds) for name, result, seconds in map(json.loads, done.stdout.splitlines())}


@pytest.mark.parametrize("which", ["shipped", "toy"])
def test_mutants_are_refused_or_give_the_same_answer(
    which: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """300 in all; half of each kind change the metadata or the graph's structure rather than its many weights."""
    bundle = SHIPPED if which == "shipped" else request.getfixturevalue("oracle_bundle")
    data = bundle.read_bytes()
    (tmp_path / "000.onnx").write_bytes(data)
    rng = np.random.default_rng(7)
    for number in range(1, 151):
        (tmp_path / f"{number:03d}.onnx").write_bytes(mutated(data, rng))
    results = loaded(tmp_path, bundle)
    assert len(results) == 151
    original, _ = results.pop("000.onnx")
    assert not original.startswith("refused")
    for name, (result, seconds) in results.items():
        assert result.startswith("refused: bundle ") or result == original, (name, result)
        assert seconds < 5.0


def test_mutants_with_a_right_checksum_never_crash(oracle_bundle: Path, tmp_path: Path) -> None:
    data = oracle_bundle.read_bytes()
    rng = np.random.default_rng(8)
    made = 0
    while made < 150:
        try:
            mutant = sealed(mutated(data, rng))
        except ValueError:
            continue
        (tmp_path / f"{made:03d}.onnx").write_bytes(mutant)
        made += 1
    results = loaded(tmp_path, oracle_bundle)
    assert len(results) == 150
    assert all(seconds < 5.0 for _, seconds in results.values())
    assert sum(result.startswith("refused") for result, _ in results.values()) > 100


def test_what_the_writer_writes_is_read_and_is_the_same_network(oracle_bundle: Path, tmp_path: Path) -> None:
    model = onnx.load(oracle_bundle)
    metadata = BundleMetadata.from_json(next(e.value for e in model.metadata_props if e.key == METADATA_KEY))
    again = tmp_path / "again.onnx"
    again.write_bytes(bundle_bytes(model, metadata))
    assert again.read_bytes() == oracle_bundle.read_bytes()
    assert Network(again, threads=1).metadata.to_json() == metadata.to_json()
