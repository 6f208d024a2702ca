"""Forms of a bundle are bundles, quicker ones are recommended only where their poses hold, and nothing dead is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper

from page_export.bundle_writer import bundle_bytes
from page_export.mixed import GroupCost, grouped, search
from page_export.optimisation import Latency, Measured, recommended
from page_export.optimise_command import search_table
from page_export.parity import samples_of
from page_export.profile import profiled
from page_export.variants import Forms, chosen_for_calibration, without_dead_ends
from page_runtime.bundle_file import read_bundle
from page_runtime.capture.playback import open_source
from page_runtime.neighbours import find_neighbours
from page_runtime.network import Network
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import RegionSample

ROOT = Path(__file__).resolve().parents[1]
SHIPPED = ROOT / "runtime" / "bundles" / "laptop.onnx"
RECORDING = ROOT / "tests" / "data" / "laptop"


@pytest.mark.parametrize(("form", "most_bytes"), [("fp16", 2.2e6), ("int8-dynamic", 1.5e6), ("int8-static", 1.5e6)])
def test_a_form_is_a_bundle_that_says_nearly_the_same(form: str, most_bytes: float, tmp_path: Path) -> None:
    metadata = read_bundle(SHIPPED).metadata
    samples = list(samples_of(metadata, open_source(RECORDING)))
    path = tmp_path / "form.onnx"
    forms = Forms(SHIPPED, metadata, samples[1:3], tmp_path)
    model = {"fp16": forms.half, "int8-dynamic": forms.dynamic, "int8-static": forms.static}[form]()
    path.write_bytes(bundle_bytes(model, metadata))
    assert path.stat().st_size < most_bytes
    one, other = (Network(bundle, threads=1).run(*samples[0]) for bundle in (SHIPPED, path))
    near = one.radii_m.std()
    assert float(np.median(np.abs(one.radii_m - other.radii_m))) < 0.25 * near
    assert not np.array_equal(one.radii_m, other.radii_m)


class FewLayers(Forms):
    """Of the image's first maps only: each group costs a second."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.layers = self.layers[:2]


def test_a_search_measures_every_group_and_takes_none_over_the_limit(tmp_path: Path) -> None:
    metadata = read_bundle(SHIPPED).metadata
    source = open_source(RECORDING)
    truths = [one.truths for recorded in source for one in recorded.instances if one.region is not None]
    samples = list(samples_of(metadata, source))
    true_samples = [(given, truth) for given, truth in zip(samples, truths, strict=True) if truth is not None][:2]
    forms = FewLayers(SHIPPED, metadata, samples[2:4], tmp_path)
    groups = grouped(forms.layers)
    assert sum(len(layers) for layers in groups.values()) == len(forms.layers)
    found = search(SHIPPED, metadata, forms, true_samples, tmp_path, bound=0.0)
    assert {one.name for one in found.groups} == set(groups)
    assert [one.error for one in found.groups] == sorted(one.error for one in found.groups)
    assert all(one.saved_bytes > 0 or one.multiplications < 1e7 for one in found.groups)
    assert found.chosen == ()
    assert "no int8-mixed" in search_table(found, 0.0)


def test_a_group_is_worth_8_bits_where_it_is_quicker_and_poses_hold() -> None:
    good = GroupCost("maps", 2, 1e7, 1000, 0.9, 1.05, 0.0)
    assert (good.pays, good.harmless(1.1), good.harmless(1.0)) == (True, True, False)
    assert not replace(good, time=0.99).pays
    assert not replace(good, more_failures=0.02).harmless(1.1)
    assert not replace(good, error=float("nan")).harmless(1.1)


def test_what_no_output_needs_is_left_out_and_the_answer_stays(
    toy_sample: tuple[Network, RegionSample, RecordedFrame], oracle_bundle: Path, tmp_path: Path
) -> None:
    metadata = read_bundle(oracle_bundle).metadata
    model = onnx.load(oracle_bundle)
    before = len(model.graph.node), len(model.graph.initializer)
    model.graph.initializer.append(numpy_helper.from_array(np.ones(3, np.float32), "unused"))
    model.graph.node.append(helper.make_node("Mul", ["points", "unused"], ["dead"]))
    model.graph.node.append(helper.make_node("Relu", ["dead"], ["deader"]))
    pruned = without_dead_ends(model)
    assert (len(pruned.graph.node), len(pruned.graph.initializer)) <= before
    assert "dead" not in {name for node in pruned.graph.node for name in node.output}
    path = tmp_path / "pruned.onnx"
    path.write_bytes(bundle_bytes(pruned, metadata))
    _, sample, _ = toy_sample
    neighbours = find_neighbours(sample.points_camera - sample.center_camera)
    for ours, theirs in zip(
        Network(path, threads=1).run_raw(sample, neighbours),
        Network(oracle_bundle, threads=1).run_raw(sample, neighbours),
        strict=True,
    ):
        np.testing.assert_array_equal(ours, theirs)


def test_the_frames_that_calibrate_differ_from_each_other() -> None:
    """Of a sample many times and one other, the other is taken second."""
    samples = list(samples_of(read_bundle(SHIPPED).metadata, open_source(RECORDING)))
    chosen = chosen_for_calibration([samples[0]] * 5 + [samples[1]], 2)
    assert {id(one) for one in chosen} == {id(samples[0]), id(samples[1])}
    assert len(chosen_for_calibration(samples, 99)) == len(samples)


def measured(name: str, ms: float, error: float, failures: float = 0.02) -> Measured:
    latency = {threads: Latency(ms, ms) for threads in (1, 2)}
    return Measured(name, 1, 1.0, latency, 1.0, 1.0, failures, error)


def test_the_quickest_form_whose_poses_hold_is_recommended() -> None:
    original = measured("fp32", 10.0, 1.0)
    good, poor = measured("good", 8.0, 1.05), measured("poor", 5.0, 1.3)
    assert recommended([original, good, poor]).name == "good"
    assert recommended([original, good, poor], 1.5).name == "poor"
    assert recommended([original, poor]).name == "fp32"
    assert recommended([original, replace(good, failures=0.05)]).name == "fp32"
    small = replace(measured("small", 8.1, 1.0), size_bytes=0)
    assert recommended([original, good, small]).name == "small"
    assert recommended([original, measured("no poses", 5.0, float("nan"))]).name == "fp32"


def test_a_profile_counts_every_operator_that_runs() -> None:
    samples = list(samples_of(read_bundle(SHIPPED).metadata, open_source(RECORDING), 2))
    profile = profiled(SHIPPED, samples, threads=1, passes=4)
    assert sum(kind.count for kind in profile.kinds) == len(profile.operators)
    assert profile.kinds == tuple(sorted(profile.kinds, key=lambda one: -one.ms))
    assert {"Conv", "Gemm"} <= {kind.name for kind in profile.kinds}
    np.testing.assert_allclose(sum(k.ms for k in profile.kinds), sum(o.ms for o in profile.operators))
