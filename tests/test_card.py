"""A model card says what the bundle and the figures say, and takes nothing else for figures."""

import json
from pathlib import Path

import pytest

from page_export.cli import main
from page_runtime.cli import main as runtime


@pytest.fixture(scope="module")
def figures(oracle_bundle: Path, toy_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("figures") / "box.json"
    assert (
        runtime(["validate", str(toy_recording), "--bundle", str(oracle_bundle), "--json", str(file), "--quiet"]) == 0
    )
    return file


def test_a_card_holds_parts_joints_provenance_and_the_measured_figures(
    oracle_bundle: Path, figures: Path, tmp_path: Path
) -> None:
    written = tmp_path / "card.md"
    assert main(["card", str(oracle_bundle), "-o", str(written), "--figures", "toy recording", str(figures)]) == 0
    text = written.read_text()
    document = json.loads(figures.read_text())
    assert text.startswith(f"# {oracle_bundle.name}\n")
    for part in document["parts"]:
        row = next(
            line for line in text.splitlines() if line.startswith(f"| toy recording, 3 objects | {part['name']} |")
        )
        assert row.endswith(f"| {100 * part['acc_5deg5cm']:.1f} | {100 * part['failure_rate']:.1f} |")
        assert f"{part['rotation_deg']['mean']:.1f} / {part['rotation_deg']['median']:.1f}" in row
    assert "**hinge**: lid against base, revolute" in text
    assert "not calibrated" in text


def test_without_figures_the_card_says_so(oracle_bundle: Path, tmp_path: Path) -> None:
    written = tmp_path / "card.md"
    assert main(["card", str(oracle_bundle), "-o", str(written)]) == 0
    assert "Not measured." in written.read_text()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "expected a JSON object"),
        ('{"recording": ""}', "expected a field 'category'"),
        (
            '{"recording": "", "category": "box", "instances": 1, "parts": [{}], "joints": []}',
            "expected a field 'name'",
        ),
        (
            '{"recording": "", "category": "laptop", "instances": 1, "parts": [], "joints": []}',
            "expected figures of 'box', got 'laptop'",
        ),
    ],
)
def test_what_is_no_figures_is_refused(
    text: str, message: str, oracle_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, written = tmp_path / "figures.json", tmp_path / "card.md"
    file.write_text(text)
    assert main(["card", str(oracle_bundle), "-o", str(written), "--figures", "x", str(file)]) == 2
    assert message in capsys.readouterr().err
    assert not written.exists()
