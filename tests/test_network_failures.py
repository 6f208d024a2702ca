"""What onnxruntime raises while it runs a network, or where a provider cannot start, is an error of ours or is told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import helper, numpy_helper

from page_runtime import Network, NetworkError, ProviderChoice, ProviderError, live_results, open_source, providers
from page_runtime.bundle_fields import BundleError
from page_runtime.cli import main
from page_runtime.live.faults import FrameFault
from page_runtime.onnx_file import sealed
from page_runtime.providers import CPU_PROVIDER

UNKNOWN = "AbacusExecutionProvider"


@pytest.fixture(scope="module")
def failing_bundle(oracle_bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The toy's bundle with a Gather whose index, from the neighbour tables, is past the end whatever they hold."""
    model = onnx.load(oracle_bundle)
    graph = model.graph
    graph.initializer.append(numpy_helper.from_array(np.asarray(1 << 20, np.int32), "far"))
    graph.initializer.append(numpy_helper.from_array(np.zeros(1, np.float32), "nothing_there"))
    graph.initializer.append(numpy_helper.from_array(np.asarray([0, 1, 2], np.int64), "all_axes"))
    last = next(node for node in graph.node if "log_extents" in node.output)
    last.output[:] = ["right_extents"]
    graph.node.extend([
        helper.make_node("Add", ["group3", "far"], ["beyond"]),
        helper.make_node("Gather", ["nothing_there", "beyond"], ["gathered"], axis=0),
        helper.make_node("ReduceMax", ["gathered", "all_axes"], ["largest"], keepdims=1),
        helper.make_node("Add", ["right_extents", "largest"], ["log_extents"]),
    ])  # fmt: skip
    onnx.checker.check_model(model)
    path = tmp_path_factory.mktemp("failing") / "failing.onnx"
    path.write_bytes(sealed(model.SerializeToString()))
    return path


@pytest.mark.parametrize("seconds", [None, 60.0])
def test_what_onnxruntime_raises_as_it_runs_names_the_bundle(
    failing_bundle: Path, toy_sample: tuple, seconds: float | None
) -> None:
    network = Network(failing_bundle, threads=1)
    _, sample, _ = toy_sample
    sentence = r"failing\.onnx: onnxruntime failed while it ran on cpu .*indices element out of data bounds.*export it"
    with pytest.raises(NetworkError, match=sentence) as raised:
        network.run(sample, network.neighbours_of(sample), seconds=seconds)
    assert "\n" not in str(raised.value)
    assert type(raised.value.__cause__).__module__.startswith("onnxruntime")
    with pytest.raises(NetworkError):
        network.warm_up()


@pytest.mark.parametrize("command", ["run", "validate", "bench", "live", "doctor"])
def test_a_command_says_it_in_a_sentence_and_writes_no_file(
    command: str, failing_bundle: Path, toy_recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    option = {"run": "--out", "live": "--out", "validate": "--json", "bench": "--json"}.get(command)
    outputs = ["--quiet", option, str(tmp_path / "out")] if option else ["--seconds", "0.1"]
    assert main([command, str(toy_recording), "--bundle", str(failing_bundle), *outputs]) == 2
    out, err = capfd.readouterr()
    assert err.startswith("page-runtime: bundle ")
    assert "failing.onnx: onnxruntime failed while it ran" in err
    assert err.count("\n") == 1
    assert out == ""
    assert not list(tmp_path.iterdir())


def test_in_the_live_loop_it_is_a_fault_of_the_place(failing_bundle: Path, toy_recording: Path) -> None:
    told: list[FrameFault] = []
    # One of the frames has no depth, and so no network to fail.
    with live_results(open_source(toy_recording), Network(failing_bundle, threads=1), on_event=told.append) as loop:
        reasons = [result.reason for result in loop]
    assert ["NetworkError at " in reason for reason in reasons] == [True, False, True]
    assert loop.counts.failed == 2
    assert [type(fault.error) for fault in told] == [NetworkError]
    assert told[0].subject.startswith("the place ")


@pytest.fixture
def abacus(monkeypatch: pytest.MonkeyPatch) -> str:
    """A provider that this onnxruntime is said to have, and for which it refuses a session."""
    monkeypatch.setitem(providers._KNOWN, "xnnpack", (UNKNOWN, "a toy shop", {}))
    have(monkeypatch, UNKNOWN)
    return "xnnpack"


def have(monkeypatch: pytest.MonkeyPatch, provider: str) -> None:
    monkeypatch.setattr(ort, "get_available_providers", lambda: [provider, CPU_PROVIDER])


def poses(lines: str) -> list[object]:
    """Of lines that are all JSON, what does not depend on the time it took."""
    return [json.loads(line)["parts"] for line in lines.splitlines()]


@pytest.mark.filterwarnings("ignore:Specified provider")
def test_a_provider_whose_session_fails_leaves_it_to_the_cpu_and_only_standard_error_says_so(
    abacus: str, oracle_bundle: Path, toy_recording: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    arguments = ["run", str(toy_recording), "--bundle", str(oracle_bundle), "--quiet"]
    assert main(arguments) == 0
    on_the_cpu = poses(capfd.readouterr().out)
    assert main([*arguments, "--provider", abacus]) == 0
    out, err = capfd.readouterr()
    assert poses(out) == on_the_cpu
    (line,) = err.splitlines()
    assert f"provider {abacus}: cannot run {oracle_bundle} (Unknown Provider Type: {UNKNOWN})" in line
    assert "; the network runs on cpu " in line
    assert main([*arguments, "--provider", abacus, "--require"]) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert f"Unknown Provider Type: {UNKNOWN}" in err


@pytest.mark.filterwarnings("ignore:Specified provider")
def test_a_provider_that_does_not_start_is_told_and_an_error_where_it_is_required(
    oracle_bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Known to onnxruntime by name, and not built into it: it goes on without.
    if "OpenVINOExecutionProvider" in ort.get_available_providers():
        pytest.skip("this onnxruntime has OpenVINO")
    have(monkeypatch, "OpenVINOExecutionProvider")
    network = Network(oracle_bundle, threads=1, on=ProviderChoice("openvino"))
    assert network.fell_back == "provider openvino: onnxruntime could not start it"
    assert network.operators.keys() == {CPU_PROVIDER}
    with pytest.raises(ProviderError, match="fallback to CPU EP has been explicitly disabled"):
        Network(oracle_bundle, threads=1, on=ProviderChoice("openvino", required=True))


def test_an_onnxruntime_that_cannot_say_what_runs_where_is_named(
    abacus: str, oracle_bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    has_it = next(kind for kind in ort.InferenceSession.__mro__ if "get_provider_graph_assignment_info" in vars(kind))
    monkeypatch.delattr(has_it, "get_provider_graph_assignment_info")
    with pytest.raises(ProviderError, match=r"expected onnxruntime 1\.24 or later, .* got 1\..*; install a later one"):
        Network(oracle_bundle, threads=1, on=ProviderChoice(abacus))
    assert Network(oracle_bundle, threads=1).fell_back == ""


@pytest.mark.filterwarnings("ignore:Specified provider")
def test_a_bundle_that_no_provider_can_load_is_the_bundles_fault(
    abacus: str, oracle_bundle: Path, tmp_path: Path
) -> None:
    path = tmp_path / "cut.onnx"
    path.write_bytes(oracle_bundle.read_bytes()[:-200])
    with pytest.raises(BundleError, match=r"cut\.onnx"):
        Network(path, threads=1, on=ProviderChoice(abacus))
