"""A damaged bundle, with or without a right checksum, is refused, or runs as it should.

Mutants are loaded in another process whose memory is limited: a crash or a bomb fails the test and nothing else.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest

from page_runtime.onnx_file import sealed

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = ROOT / "runtime" / "bundles" / "box.onnx"


LOADS = """
import hashlib, json, resource, signal, sys, time
import numpy as np
from pathlib import Path
from page_runtime.bundle_fields import BundleError
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
