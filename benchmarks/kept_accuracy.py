"""What the README tells of accuracy, kept small: of a validation its means and medians by part and joint.

    python benchmarks/kept_accuracy.py NAME validate.json --data "procedural, 200 unseen instances"

keeps what `page-runtime validate --json` wrote as benchmarks/results/accuracy/NAME.json, and writes the README anew.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ACCURACY = ROOT / "benchmarks" / "results" / "accuracy"
SIGNIFICANT = 6
EXIT_BAD_INPUT = 2


def reduced(document: dict[str, Any], data: str) -> dict[str, Any]:
    """Of a document of `page-runtime validate` what a row of the README needs. data: what of, in words."""
    errors = ("rotation_deg", "translation_m", "translation_share")
    shares = ("visible", "missing", "acc_5deg5cm", "failure_rate")
    return {
        "category": document["category"],
        "data": data,
        **{name: document[name] for name in ("recording", "bundle", "frames", "instances")},
        "parts": [
            {"name": part["name"]}
            | {name: _rounded(part[name]) for name in shares}
            | {name: {kind: _rounded(part[name][kind]) for kind in ("mean", "median")} for name in errors}
            for part in document["parts"]
        ],
        "joints": [
            {"name": joint["name"], "unit": joint["unit"], "visible": joint["visible"], "missing": joint["missing"]}
            | {"error": {kind: _rounded(joint["error"][kind]) for kind in ("mean", "median")}}
            for joint in document["joints"]
        ],
    }


def keep(name: str, document: dict[str, Any], data: str, folder: Path = ACCURACY) -> Path:
    """Writes it to `folder`; returns the file. KeyError where the document is none of `page-runtime validate`."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    path.write_text(json.dumps(reduced(document, data), indent=1) + "\n", encoding="utf-8")
    return path


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.{SIGNIFICANT}g}")


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 done, 2 bad input."""
    from benchmarks.readme_figures import write_readme

    parser = argparse.ArgumentParser(prog="kept_accuracy.py", description="Keep a validation for the README.")
    parser.add_argument("name", help="of the kept file, as laptop-test")
    parser.add_argument("validation", type=Path, help="what page-runtime validate --json wrote")
    parser.add_argument("--data", required=True, help="what it is of, in words")
    options = parser.parse_args(arguments)
    try:
        keep(options.name, json.loads(options.validation.read_text(encoding="utf-8")), options.data)
        write_readme()
    except (OSError, ValueError, KeyError, TypeError) as error:
        print(f"kept_accuracy: {options.validation}: expected JSON of page-runtime validate ({error})", file=sys.stderr)
        return EXIT_BAD_INPUT
    return 0


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.kept_accuracy` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
