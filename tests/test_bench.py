"""Laws of the benchmark's figures, its sweeps and its verdicts; nothing here depends on how fast this machine is."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import toy
from page_runtime import open_source
from page_runtime.bench import PAPER_MS, Timing, Window, deadline, energy, jitter, report, stability
from page_runtime.bench_comparison import NotComparable, compare
from page_runtime.cli import main
from page_runtime.estimator import estimate
from page_runtime.machine import EnergyCounter, energy_counters, governors
from page_runtime.network import Network
from page_runtime.pose import PartPose
from page_runtime.report.bench_page import bench_page
from page_runtime.report.charts import Axis, Series, line_chart
from page_runtime.sweep import resized, run_sweep, sweep_from

times_ms = st.lists(st.floats(1.0, 500.0), min_size=2, max_size=30)


def window(totals_ms: list[float], energy_j: float | None = None) -> Window:
    return Window(tuple(Timing({"network": one / 2, "scoring": one / 4}, one) for one in totals_ms), 0, energy_j)


def document(totals_ms: list[float], **more: Any) -> dict[str, Any]:
    facts = {"cpu": "C", "recording_sha256": "R", "looks": 1, **more}
    return report([window(totals_ms)] * 3, threads=2, budgets_ms=(50.0,)) | facts


@given(st.lists(times_ms, min_size=2, max_size=4))
def test_windows_are_stable_when_their_medians_are_within_a_tenth(each: list[list[float]]) -> None:
    medians = [float(np.median(one)) for one in each]
    found = stability([window(one) for one in each])
    assert found["stable"] == (max(medians) / min(medians) - 1.0 <= 0.10)
    assert stability([window(each[0])] * 3)["stable"]
    assert not stability([window(each[0])])["stable"], "one window cannot agree with itself"


@given(times_ms, st.floats(1.0, 500.0))
def test_a_deadline_is_missed_by_what_takes_longer(totals_ms: list[float], budget_ms: float) -> None:
    found = deadline(totals_ms, budget_ms)
    assert found["missed"] == sum(one > budget_ms for one in totals_ms)
    assert report([window(totals_ms)], threads=1, budgets_ms=(160.0, 20.0))["deadlines"] == [
        deadline(totals_ms, 160.0),
        deadline(totals_ms, 20.0),
    ]


def test_jitter_is_of_successive_estimates_in_a_window_and_not_between_windows() -> None:
    found = jitter([window([10.0, 10.0]), window([90.0, 90.0])])
    assert found["successive_ms"] == 0.0
    assert found["std_ms"] == pytest.approx(40.0)
    assert jitter([window([10.0, 30.0, 10.0])])["successive_ms"] == pytest.approx(20.0)


def test_energy_is_counted_over_a_counters_start_and_only_of_whole_packages(tmp_path: Path) -> None:
    def domain(name: str, energy_uj: int) -> None:
        (tmp_path / name).mkdir()
        (tmp_path / name / "energy_uj").write_text(f"{energy_uj}\n")
        (tmp_path / name / "max_energy_range_uj").write_text("999999\n")

    domain("intel-rapl:0", 900_000)
    domain("intel-rapl:0:0", 5)
    (tmp_path / "intel-rapl:1").mkdir()
    (counter,) = energy_counters(tmp_path)
    before = counter.read_uj()
    (tmp_path / "intel-rapl:0" / "energy_uj").write_text("100000\n")
    assert counter.used_j(before, counter.read_uj()) == pytest.approx(0.2)
    assert energy([window([1.0, 2.0], 0.2), window([1.0, 2.0], 0.4)]) == {"total_j": 0.6, "per_estimate_j": 0.15}
    assert energy([window([1.0, 2.0])]) is None
    assert energy_counters(tmp_path / "nowhere") == []
    assert EnergyCounter(Path(), 9).used_j(8, 2) == pytest.approx(4e-6)


def test_governors_are_read_where_the_system_shows_them(tmp_path: Path) -> None:
    for cpu, name in enumerate(("powersave", "performance", "powersave")):
        (tmp_path / f"cpu{cpu}" / "cpufreq").mkdir(parents=True)
        (tmp_path / f"cpu{cpu}" / "cpufreq" / "scaling_governor").write_text(f"{name}\n")
    assert governors(tmp_path) == ["performance", "powersave"]
    assert governors(tmp_path / "nowhere") == []


@settings(deadline=None)
@given(times_ms, st.floats(0.5, 2.0))
def test_a_run_is_a_regression_when_it_is_more_than_a_tenth_slower(totals_ms: list[float], factor: float) -> None:
    one, other = document(totals_ms), document([one * factor for one in totals_ms])
    verdict = compare(one, other).verdict
    if factor > 1.11:
        assert verdict == "regression"
    elif factor < 1.09:
        assert verdict == "no regression"
    assert compare(one, one).verdict == "no regression"


def test_a_stage_alone_can_be_the_regression_and_an_unstable_run_proves_nothing() -> None:
    one = document([40.0, 41.0, 42.0])
    other = deepcopy(one)
    other["stages"]["scoring"]["p50_ms"] *= 1.5
    assert [change.name for change in compare(one, other).changes if change.slower] == ["scoring p50"]
    other["stages"]["scoring"]["p50_ms"] = one["stages"]["scoring"]["p50_ms"] + 0.4
    one["stages"]["scoring"]["p50_ms"] = 0.001
    other["stages"]["scoring"]["p50_ms"] = 0.4
    assert compare(one, other).verdict == "no regression", "less than half a millisecond"
    other["stability"] = {**other["stability"], "stable": False}
    assert compare(one, other).verdict == "unstable"


def test_compare_ends_with_1_for_a_slower_run_and_2_for_what_cannot_be_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def write(name: str, content: object) -> str:
        (tmp_path / name).write_text(json.dumps(content))
        return str(tmp_path / name)

    fast, slow = write("a.json", document([40.0, 41.0])), write("b.json", document([60.0, 61.0]))
    assert main(["bench", "--compare", fast, fast]) == 0
    assert "no regression" in capsys.readouterr().out
    assert main(["bench", "--compare", slow, fast]) == 0
    assert main(["bench", "--compare", fast, slow]) == 1
    assert "\nregression\n" in capsys.readouterr().out
    for other, sentence in (
        (document([40.0, 41.0], cpu="D"), "they differ in cpu (C and D)"),
        (document([40.0, 41.0], region=[0, 0, 9, 9]), "they differ in region (None and [0, 0, 9, 9])"),
        ({"total": {}}, "expected figures of page-runtime bench, got none of cpu"),
        ([], "got a list or a value"),
    ):
        assert main(["bench", "--compare", fast, write("c.json", other)]) == 2
        assert sentence in capsys.readouterr().err
    (tmp_path / "d.json").write_text("{")
    assert main(["bench", "--compare", fast, str(tmp_path / "d.json")]) == 2
    assert main(["bench", "R", "--compare", fast, slow]) == 2
    assert main(["bench"]) == 2
    with pytest.raises(NotComparable, match="threads"):
        compare(document([1.0, 2.0]), document([1.0, 2.0]) | {"threads": 1})


@pytest.mark.parametrize(
    "text", ["", "rho", "rho=", "rho=0", "rho=-1", "rho=a", "rho=nan", "rho=inf", "keypoints=3", "threads=1.5"]
)
def test_a_sweep_that_cannot_be_understood_is_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="expected threads, rho, looks, voters, size and values above 0"):
        sweep_from(text)
    assert main(["bench", "R", "--bundle", "B", "--sweep", text]) == 2
    assert "--sweep: expected threads" in capsys.readouterr().err


def test_a_sweep_changes_what_it_says_and_leaves_the_network_as_it_was(
    toy_recording: Path, oracle_bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("page_runtime.sweep.MEASUREMENTS", 2)
    network, source = Network(oracle_bundle, threads=1), open_source(toy_recording)
    voxel_m = network.metadata.voxel_m
    for varies, values in (("rho", (5.0, 20.0)), ("voters", (16.0, 512.0))):
        text = f"{varies}={','.join(str(int(value)) for value in values)}"
        steps = run_sweep(sweep_from(text), network, source, load=lambda _: network, max_looks=1)
        assert [step["value"] for step in steps] == list(values)
        assert all(step["errors"]["rotation_deg"] < 1.0 for step in steps)
    assert network.metadata.voxel_m == voxel_m


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_poses_are_the_same_in_pictures_of_another_size(
    toy_recording: Path, oracle_bundle: Path, factor: float
) -> None:
    source, network = open_source(toy_recording), Network(oracle_bundle, threads=1)
    (other, *_) = resized(source, factor)
    assert other.frame.camera.width == round(source.entries[0].camera.width * factor)
    region = other.instances[0].region
    assert region is not None
    pose = estimate(network, other.frame, region)
    for part, T_true in zip(pose.parts, toy.part_poses(), strict=True):
        assert isinstance(part, PartPose)
        np.testing.assert_allclose(part.T_camera_part, T_true, atol=0.02)


def test_the_page_of_a_benchmark_holds_every_stage_and_is_well_formed() -> None:
    from test_validation import Page

    windows = [window([40.0, 41.0, 300.0])] * 3
    cold = {"interpreter_ms": 1.0, "import_ms": 2.0, "total_ms": 3.0, "repeats": 3}
    step = {"value": 5.0, "stages": {"scoring": {"p50_ms": 1.0}, "network": {"p50_ms": 2.0}},
            "total": {"p50_ms": 3.0, "p95_ms": 4.0}, "stability": {"stable": True}, "errors": None}  # fmt: skip
    given_document = document([40.0, 41.0, 300.0]) | {
        "recording": "<i>toy", "bundle": "b", "bundle_sha256": "", "frames": 1, "cold_start": cold, "governor": [],
        "load": [0.1, 0.2], "commit": None, "sweeps": [{"varies": "rho", "what": "rho, mm", "steps": [step, step]}],
    }  # fmt: skip
    read = Page(bench_page(given_document, windows))
    assert (read.open, read.fetched) == ([], [])
    words = "".join(read.words)
    for expected in ("network", "scoring", "stable", "Benchmark: <i>toy", f"{PAPER_MS['total']:.0f}"):
        assert expected in words


@given(st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), min_size=1, max_size=20))
def test_a_chart_stays_in_its_frame_and_says_no_nan(points: list[tuple[float, float]]) -> None:
    drawn = line_chart(
        [Series("a & b", [x for x, _ in points], [y for _, y in points], marked=True)], Axis("x"), Axis("y")
    )
    assert "nan" not in drawn
    assert "inf" not in drawn
    assert "a &amp; b" in drawn
