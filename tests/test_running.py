"""Running a network: within a time, on the provider asked for, the same every time."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from page_runtime import cli
from page_runtime.estimator import estimate
from page_runtime.live.detector import Detector
from page_runtime.machine import most_threads
from page_runtime.neighbours import find_neighbours
from page_runtime.network import Network
from page_runtime.providers import CPU_PROVIDER, PROVIDERS, ProviderChoice, ProviderError, resolved
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import RegionSample
from page_runtime.sessions import DeadlineExceeded
from page_runtime.sweep import sweep_from

SHIPPED = Path(__file__).resolve().parents[1] / "runtime" / "bundles" / "laptop.onnx"
Toy = tuple[Network, RegionSample, RecordedFrame]


def test_a_pass_that_takes_too_long_ends_with_an_error_that_says_so(toy_sample: Toy) -> None:
    _, sample, _ = toy_sample
    network = Network(SHIPPED, threads=1)
    neighbours = find_neighbours(sample.points_camera - sample.center_camera)
    whole = network.run_raw(sample, neighbours)
    with pytest.raises(DeadlineExceeded, match=r"not done within 0\.0 ms; allow more time"):
        network.run_raw(sample, neighbours, seconds=1e-5)
    # One pass given up leaves nothing behind for the next.
    for ours, theirs in zip(network.run_raw(sample, neighbours, seconds=60.0), whole, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("seconds", [-1.0, 0.0, float("nan")])
def test_a_time_that_is_over_before_it_begins_is_refused(seconds: float, toy_sample: Toy) -> None:
    network, sample, _ = toy_sample
    with pytest.raises(ValueError, match=f"seconds: expected a time above 0, or None for any, got {seconds}"):
        network.run_raw(sample, network.neighbours_of(sample), seconds=seconds)


@pytest.mark.parametrize("seconds", [threading.TIMEOUT_MAX, 1e12, float("inf")])
@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_time_longer_than_any_timer_waits_is_all_the_time_there_is(seconds: float, toy_sample: Toy) -> None:
    network, sample, _ = toy_sample
    neighbours = network.neighbours_of(sample)
    whole = network.run_raw(sample, neighbours)
    for ours, theirs in zip(network.run_raw(sample, neighbours, seconds=seconds), whole, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_an_estimate_passes_the_time_on(toy_sample: Toy) -> None:
    network, _, recorded = toy_sample
    region = recorded.instances[0].region
    assert region is not None
    with pytest.raises(DeadlineExceeded):
        estimate(Network(SHIPPED, threads=1), recorded.frame, region, network_seconds=1e-5)
    one, other = (estimate(network, recorded.frame, region, network_seconds=s) for s in (None, 60.0))
    for ours, theirs in zip(one.parts, other.parts, strict=True):
        assert type(ours) is type(theirs)


def test_warming_up_changes_no_answer(toy_sample: Toy) -> None:
    _, sample, _ = toy_sample
    neighbours = find_neighbours(sample.points_camera - sample.center_camera)
    cold, warm = Network(SHIPPED, threads=1), Network(SHIPPED, threads=1)
    warm.warm_up()
    for ours, theirs in zip(warm.run_raw(sample, neighbours), cold.run_raw(sample, neighbours), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_provider_that_is_not_here_is_an_error_and_never_replaced() -> None:
    for name in set(PROVIDERS) - {"auto", "cpu"}:
        with pytest.raises(ProviderError, match=f"provider {name}: this onnxruntime does not have it .* install"):
            resolved(ProviderChoice(name), [CPU_PROVIDER])
    with pytest.raises(ProviderError, match="expected one of auto, cpu"):
        resolved(ProviderChoice("abacus"), [CPU_PROVIDER])


def test_auto_takes_the_cpu_only_where_nothing_better_is() -> None:
    assert resolved(ProviderChoice("auto"), [CPU_PROVIDER])[0] == CPU_PROVIDER
    assert resolved(ProviderChoice("auto"), [CPU_PROVIDER, "CUDAExecutionProvider"])[0] == "CUDAExecutionProvider"


def test_options_given_win_over_the_defaults() -> None:
    name, options = resolved(ProviderChoice("openvino", (("device_type", "GPU"),)), ["OpenVINOExecutionProvider"])
    assert name == "OpenVINOExecutionProvider"
    assert options == {"device_type": "GPU"}


def test_options_that_nothing_would_read_are_refused() -> None:
    options = (("device_type", "GPU"), ("nonsense", "1"))
    for name in ("cpu", "auto"):
        with pytest.raises(ProviderError, match="no options, got device_type, nonsense; leave them out"):
            resolved(ProviderChoice(name, options), [CPU_PROVIDER])
    assert resolved(ProviderChoice("auto", options), [CPU_PROVIDER, "QNNExecutionProvider"])[1]["nonsense"] == "1"


@pytest.mark.parametrize("threads", [-1, 100_000])
def test_a_number_of_threads_that_no_machine_needs_is_refused(threads: int, oracle_bundle: Path) -> None:
    with pytest.raises(ValueError, match=rf"threads: expected 1 to {most_threads()} .*, got {threads}"):
        Network(oracle_bundle, threads=threads)
    with pytest.raises(ValueError, match="threads: expected 1 to"):
        Detector(oracle_bundle, threads=threads)
    if threads > 0:
        with pytest.raises(ValueError, match="threads: expected 1 to"):
            sweep_from(f"threads=1,{threads}")


def test_a_network_says_what_it_runs_on(oracle_bundle: Path) -> None:
    network = Network(oracle_bundle, threads=1, on=ProviderChoice("cpu", required=True))
    assert set(network.operators) == {CPU_PROVIDER}
    assert network.operators[CPU_PROVIDER] > 10


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--provider", "coreml", "--require"], "provider coreml: this onnxruntime does not have it"),
        (["--provider", "cpu", "--provider-option", "threads"], "--provider-option: expected KEY=VALUE"),
        (["--provider", "abacus"], "--provider"),
        (["--provider", "cpu", "--provider-option", "nonsense=1"], "provider cpu: it has no options, got nonsense"),
        (["--provider", "auto", "--provider-option", "nonsense=1"], "provider auto: the CPU is the best there is here"),
        (["--threads", "100000"], "--threads: expected 1 to "),
    ],
)
def test_a_wrong_provider_is_refused_in_a_sentence(
    options: list[str],
    sentence: str,
    toy_recording: Path,
    oracle_bundle: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["run", str(toy_recording), "--bundle", str(oracle_bundle), *options]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert "Traceback" not in error
