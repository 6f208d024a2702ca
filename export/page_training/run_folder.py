"""The folder of a training run: everything needed to repeat it, to go on with it and to see how it went.

config.json, environment.jsonl (a line for each start), checkpoint.pt (to go on), best.pt (the averaged network of the
best validation, as `page-train keep` keeps it), history.jsonl (one report a line), validation.png (the latest).
"""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from page_runtime.machine import versions
from page_training.config import TrainingConfig
from page_training.records import scenes_version

_PACKAGES = ("page-edge", "torch", "numpy", "opencv-python-headless")
_FREE = {"samples", "threads", "validate_every", "save_every", "patience"}


def begin(run: Path, config: TrainingConfig, step: int) -> None:
    """Write what the run is made of, and with what it goes on from this step."""
    run.mkdir(parents=True, exist_ok=True)
    (run / "config.json").write_text(json.dumps(asdict(config), indent=2) + "\n")
    with (run / "environment.jsonl").open("a") as starts:
        starts.write(json.dumps({"step": step, **_environment(config.category)}) + "\n")


def require_same_run(run: Path, begun: dict[str, Any], config: TrainingConfig) -> None:
    """ValueError where a run that goes on would not be the one that was begun."""
    now = json.loads(json.dumps(asdict(config)))
    # A run begun before a setting was there was begun with what it is without it.
    begun = json.loads(json.dumps(asdict(TrainingConfig(config.category)))) | begun
    different = sorted(name for name in now if name not in _FREE and now[name] != begun[name])
    if different:
        raise ValueError(
            f"{run}: this run was begun with other {', '.join(different)}; give those again or another --run"
        )


def add_report(run: Path, report: dict[str, Any], picture: NDArray[np.uint8] | None) -> None:
    """Append a report to the history; a validation's picture takes the place of the one before."""
    with (run / "history.jsonl").open("a") as history:
        history.write(json.dumps(report) + "\n")
    if picture is not None and not cv2.imwrite(str(run / "validation.png"), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)):
        raise OSError(f"cannot write {run / 'validation.png'}")


def validation_totals(run: Path, step: int) -> list[float]:
    """The total of every validation up to a step, in order, each step once."""
    file = run / "history.jsonl"
    found: dict[int, float] = {}
    for line in file.read_text().splitlines() if file.is_file() else ():
        report = json.loads(line)
        if report["validation"] is not None and report["step"] <= step:
            found[report["step"]] = report["validation"]["total"]
    return [found[at] for at in sorted(found)]


def _environment(category: str) -> dict[str, Any]:
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty"],
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
            cwd=Path(__file__).parent,
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        described = "no git work tree, see versions"
    return {
        "command": sys.argv[1:],
        "commit": described,
        "scenes_version": scenes_version(category),
        "versions": versions(_PACKAGES),
        "machine": platform.machine(),
    }
