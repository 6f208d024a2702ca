"""Running a network: within a time, on the provider asked for, the same every time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from page_runtime import cli
from page_runtime.estimator import estimate
from page_runtime.neighbours import find_neighbours
from page_runtime.network import DeadlineExceeded, Network
from page_runtime.providers import CPU_PROVIDER, PROVIDERS, ProviderChoice, ProviderError, resolved
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import RegionSample

SHIPPED = Path(__file__).resolve().parents[1] / "runtime" / "bundles" / "laptop.onnx"
Toy = tuple[Network, RegionSample, RecordedFrame]


def test_a_pass_that_takes_too_long_ends_with_an_error_that_says_so(toy_sample: Toy) -> None:
    _, sample, _ = toy_sample
    network = Network(SHIPPED, threads=1)
    neighbours = find_neighbours(sample.points_camera - sample.center_camera)
    whole = network.run_raw(sample, neighbours)
    for seconds in (-1.0, 0.0, 1e-5):
        with pytest.raises(DeadlineExceeded, match=r"not done within .* ms; allow more time"):
            network.run_raw(sample, neighbours, seconds=seconds)
    # One pass given up leaves nothing behind for the next.
    for ours, theirs in zip(network.run_raw(sample, neighbours, seconds=60.0), whole, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_an_estimate_passes_the_time_on(toy_sample: Toy) -> None:
    network, _, recorded = toy_sample
    region = recorded.instances[0].region
    assert region is not None
    with pytest.raises(DeadlineExceeded):
        estimate(network, recorded.frame, region, network_seconds=0.0)
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
