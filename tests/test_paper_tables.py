"""The paper's constants against the sentences of its text, and our rows beside them."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks import paper, table_rows, table_steps
from benchmarks.paper_tables import main, write_tables
from benchmarks.report import Cache
from benchmarks.table_rows import HERE, PAPER, figures_from, markdown, plots_from

NOTHING: dict[str, Any] = {"validations": [], "robustness": None, "latencies": [], "ablations": None, "radii": None}


def test_the_papers_rows_agree_with_what_its_text_says_of_them() -> None:
    ious = [row for row in paper.TABLE_1.rows if row.iou]
    for method, mean in (("A-NCSH", 12.1), (paper.OURS, 7.5)):
        (row,) = [row for row in paper.TABLE_5.rows if row.method == method]
        assert np.mean(row.rotation_deg) == pytest.approx(mean, abs=0.06)
    lengths = {row.method: np.mean(row.translation_m) for row in paper.TABLE_5.rows}
    assert lengths["A-NCSH"] == pytest.approx(0.126, abs=6e-4)
    assert lengths[paper.OURS] == pytest.approx(0.044, abs=6e-4)
    glasses = {row.method: np.mean(row.iou) for row in ious if row.category == "eyeglasses"}
    assert glasses[paper.OURS] == pytest.approx(52.3, abs=0.06), "what its section VI-A gives as the average"
    assert glasses["A-NCSH"] == pytest.approx(44.1, abs=0.06)


def test_every_row_has_as_many_figures_as_its_category_has_parts() -> None:
    parts = {"laptop": 2, "eyeglasses": 3, "dishwasher": 2, "scissors": 2, "drawer": 4, "box": 2, "stapler": 2,
             "cutter": 2, "arm": 7}  # fmt: skip
    for table in paper.TABLES:
        for row in table.rows:
            expected = {1} if table.number == "VIII" else {parts[row.category]}
            if table.number == "III" and row.category == "drawer":
                expected = {2}
            assert {len(one) for one in (row.rotation_deg, row.translation_m, row.iou) if one} == expected, row


def test_the_frame_rates_are_the_times_turned_round() -> None:
    for method, rate in paper.FRAMES_PER_S.items():
        assert 1e3 / rate == pytest.approx(paper.TIME_MS[method][0], abs=0.5)


def test_without_any_result_the_tables_hold_the_papers_rows_and_say_what_is_not_there(tmp_path: Path) -> None:
    figures = figures_from(NOTHING)
    assert {one.source for one in figures} == {PAPER}
    assert {one.table for one in figures} == set(table_rows.TITLES)
    text = markdown(figures, NOTHING)
    assert text.count("No row of ours.") == len(table_rows.TITLES)
    assert "No ablations are there" in text
    write_tables(tmp_path, figures, text, plots_from(figures))
    with (tmp_path / "tables.csv").open() as file:
        assert len(list(csv.reader(file))) == 1 + len(figures)


def test_our_rows_stand_in_the_tables_of_their_category_with_their_intervals() -> None:
    interval = {"mean": 2.0, "ci95": {"mean": [1.0, 3.0]}}
    part = {"name": "lid", "rotation_deg": interval, "translation_m": interval, "iou": interval,
            "by_occlusion": [{"occlusion": [0.0, 0.4], "rotation_deg": interval, "translation_m": interval,
                              "iou": interval}]}  # fmt: skip
    document = {"parts": [part], "categories": [{"segmentation": {"accuracy_on_object": 0.9}}]}
    results = NOTHING | {"validations": [{"category": "laptop", "data": "here", "document": document}]}
    own = [one for one in figures_from(results) if one.source == HERE]
    assert {one.table for one in own} == {"I", "IV", "VIII"}
    assert {(one.value, one.low, one.high) for one in own if one.metric == "rotation, deg"} == {(2.0, 1.0, 3.0)}
    assert {one.row for one in own if one.table == "VIII"} == {"0 to 40 %"}
    assert [one.value for one in own if one.metric == "segmentation, %"] == [90.0]
    text = markdown(figures_from(results), results)
    assert "2 (1 to 3)" in text
    assert "eyeglasses" not in text, "categories that are not measured here are left to the CSV"


def test_a_step_that_is_kept_is_not_done_again(tmp_path: Path) -> None:
    done: list[int] = []

    def work() -> dict[str, Any]:
        done.append(1)
        return {"value": 1}

    for fingerprint, times in (("a", 1), ("a", 1), ("b", 2), ("b", 2)):
        assert table_steps._step(Cache(tmp_path, fingerprint), "a step", work) == {"value": 1}
        assert len(done) == times


def test_a_recording_that_cannot_be_understood_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--recording", "laptop"]) == 2
    assert "expected CATEGORY=PATH, got 'laptop'" in capsys.readouterr().err
    assert main(["--recording", "teapot=x"]) == 2
    assert "no bundle for teapot" in capsys.readouterr().err


def test_every_bundle_is_measured_on_the_test_split_and_no_two_results_are_kept_under_one_name(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(table_steps, "procedural_recording", lambda *given: tmp_path / "-".join(map(str, given)))
    monkeypatch.setattr(table_steps, "REAL", {"box": (tmp_path, "real"), "laptop": (tmp_path / "absent", "real")})
    measured = table_steps.chosen([], quick=False)
    names = [(one.category, one.kind) for one in measured]
    assert len(set(names)) == len(names)
    bundles = {path.stem for path in table_steps.BUNDLES.glob("*.onnx")}
    assert {one.category for one in measured if one.kind == "test" and one.timed} == bundles
    assert ("box", "zero-shot") in names
    assert ("laptop", "zero-shot") not in names
    assert len({one.recording for one in measured}) == len(measured)
    (own,) = (one for one in table_steps.chosen([f"laptop={tmp_path}"], quick=False) if one.category == "laptop")
    assert (own.recording, own.kind) == (tmp_path, "given")
