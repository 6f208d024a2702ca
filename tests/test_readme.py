"""The README's figures are those of the committed results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from benchmarks import kept_accuracy, readme_figures
from benchmarks.paper_tables import keep_for_readme
from benchmarks.readme_figures import README, RESULTS, SECTIONS, with_figures

LARGEST = 20_000


def test_the_readme_holds_what_would_be_written_from_the_committed_results() -> None:
    text = README.read_text(encoding="utf-8")
    assert with_figures(text) == text, "run python benchmarks/readme_figures.py"


def test_what_is_kept_for_the_readme_is_small() -> None:
    kept = [*(RESULTS / "accuracy").glob("*.json"), *RESULTS.glob("latency-*.json")]
    assert kept
    assert max(path.stat().st_size for path in kept) < LARGEST


def test_a_changed_figure_and_a_lost_marker_are_found() -> None:
    text = README.read_text(encoding="utf-8")
    begin = "<!-- figures: accuracy -->\n"
    assert with_figures(text.replace(begin, f"{begin}| made up |\n")) == text
    for name in SECTIONS:
        with pytest.raises(ValueError, match="put them back"):
            with_figures(text.replace(f"<!-- end of figures: {name} -->", ""))


def validation(rotation_deg: float | None) -> dict[str, Any]:
    """What page-runtime validate writes, as far as it is kept, and more."""
    error = {"mean": rotation_deg, "median": 1.23456789, "p90": 9.0}
    part = {"name": "lid", "visible": 9, "missing": 1, "acc_5deg5cm": 0.5, "failure_rate": 1 / 3, "by_occlusion": []}
    part |= {"rotation_deg": error, "translation_m": error, "translation_share": error}
    joint = {"name": "hinge", "unit": "deg", "visible": 9, "missing": 1, "error": error}
    return {"recording": "r", "bundle": "box.onnx", "category": "box", "frames": 10, "instances": 10,
            "parts": [part], "joints": [joint], "settings": {}}  # fmt: skip


@pytest.mark.parametrize("rotation_deg", [12.0, None])
def test_a_validation_is_kept_and_told(
    rotation_deg: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = {"category": "box", "kind": "test", "data": "procedural, 10 unseen instances"}
    results = {"validations": [one | {"document": validation(rotation_deg)}], "latencies": []}
    keep_for_readme(results, tmp_path)
    kept = json.loads((tmp_path / "accuracy" / "box-test.json").read_text())
    assert kept["parts"][0]["rotation_deg"] == {"mean": rotation_deg, "median": 1.23457}
    monkeypatch.setattr(readme_figures, "RESULTS", tmp_path)
    row = readme_figures.accuracy().splitlines()[2]
    told = "-" if rotation_deg is None else "12.0"
    assert row.startswith(f"| box, procedural, 10 unseen instances | lid | {told} / 1.2 | ")
    assert row.endswith("| 50 | 33.3 |")
    assert f"{told} / 1.2 deg" in readme_figures.joints()


def test_what_is_no_validation_is_not_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "other.json"
    for text in ("{}", "[]", "no JSON"):
        file.write_text(text)
        assert kept_accuracy.main(["no-such", str(file), "--data", "none"]) == 2
        assert "expected JSON of page-runtime validate" in capsys.readouterr().err
    assert not (RESULTS / "accuracy" / "no-such.json").exists()
