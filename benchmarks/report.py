"""Results kept between runs, and the document made of them."""

import hashlib
import json
import os
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.steps import (
    PARTS_OF_FRAME,
    Step,
)
from benchmarks.synthetic import KEYPOINT_DISTANCE_M
from benchmarks.trials import RULES

from page_runtime.bench import PAPER_MS
from page_runtime.commands.outputs import write_json
from page_runtime.machine import PACKAGES, cpu_name, versions

ROOT = Path(__file__).resolve().parents[1]
# A result is of these sources; when they change it is measured again.
SOURCES = (
    "runtime/page_runtime/*.py",
    *(
        f"benchmarks/{name}.py"
        for name in (
            "accumulators",
            "compiled",
            "figures",
            "measurements",
            "peers",
            "planar",
            "steps",
            "synthetic",
            "trials",
        )
    ),
    *(f"tests/{name}.py" for name in ("dense_accumulator", "synthetic_parts")),
)

PAPER_NOTE = "on an RTX 4090, with a voxel size and a number of parts that the paper does not state"
TARGET_RATIOS = {"gemm": 3000, "algorithm_1": 4000}


@dataclass(frozen=True, slots=True)
class Cache:
    """Results of steps as files, so that a sweep goes on where it was interrupted."""

    folder: Path
    fingerprint: str

    def load(self, name: str) -> dict[str, Any] | None:
        with suppress(OSError, ValueError):
            kept = json.loads(self._path(name).read_text(encoding="utf-8"))
            if kept["fingerprint"] == self.fingerprint:
                return kept["result"]
        return None

    def keep(self, name: str, result: dict[str, Any]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        write_json(self._path(name), {"fingerprint": self.fingerprint, "result": result})

    def _path(self, name: str) -> Path:
        return self.folder / f"{name.replace(' ', '-').replace('=', '')}.json"


def fingerprint() -> str:
    """Of the sources and of the packages that count; results of others are not mixed."""
    digest = hashlib.sha256()
    for pattern in SOURCES:
        for source in sorted(ROOT.glob(pattern)):
            digest.update(source.read_bytes())
    digest.update(json.dumps(_versions(), sort_keys=True).encode())
    return digest.hexdigest()[:16]


def _versions() -> dict[str, str]:
    return versions((*PACKAGES, "numba", "matplotlib"))


def machine() -> dict[str, Any]:
    """Where and of what figures are that are measured from now on; load is the machine's of the last minute."""
    return {
        "cpu": cpu_name(),
        "cores": os.cpu_count(),
        "threads": 1,
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "versions": _versions(),
        "commit": _git("rev-parse", "HEAD"),
        "uncommitted": [line[3:] for line in _git("status", "--porcelain", "--", *SOURCES).splitlines()],
        "fingerprint": fingerprint(),
    }


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.rstrip("\n")


def document_from(
    steps: list[Step], results: dict[str, dict[str, Any]], measured_on: dict[str, Any], *, quick: bool
) -> dict[str, Any]:
    """Everything measured; the standard setting's figures, which a gate reads, at the top. measured_on: `machine`."""
    standard = results["parts mid independent"]
    equality = _together([results[step.name] for step in steps if step.name.startswith("equality")])
    frames = {f"k{k}": results[f"frame mid 5 mm K={k}"] for k in PARTS_OF_FRAME}
    by_noise = {
        f"{name} {kind}": {
            key: results[f"parts {name} {kind}"][key] for key in ("keypoint_mm", "wrong_peak_share", "pose")
        }
        for name in KEYPOINT_DISTANCE_M
        for kind in ("independent", "correlated")
    }
    return {
        "what": (
            "Synthetic one-sided parts, depth noise 1 mm. Standard setting: keypoints mid (0.20-0.45 m off the part), "
            "rho 5 mm, sigma 5 mm, 15 % outliers, 512 points a part; frames: 2048 points, 3 keypoints a part. Wall "
            "times, the least of a few repeats, one thread, on a machine that may be busy (load)."
        ),
        "mode": "quick" if quick else "full",
        "equal_fraction": equality["equal_fraction"],
        "equality": equality,
        "ms_per_keypoint": standard["ms_per_keypoint"],
        "cpu_ms_per_keypoint": standard["cpu_ms_per_keypoint"],
        "frame_ms": {k: frame["ms"]["p50"] for k, frame in frames.items()},
        "frame_cpu_ms": {k: frame["cpu_ms"]["p50"] for k, frame in frames.items()},
        "frame_evaluations": {k: frame["evaluations"]["p50"] for k, frame in frames.items()},
        "scoring_plus_registration_ms": {k: f["scoring_plus_registration_ms"]["p50"] for k, f in frames.items()},
        "keypoint_mm": standard["keypoint_mm"],
        "pose": {
            "what": (
                "medians over parts, a missing pose counts as an infinite error. argmax_kabsch: first arg-max voxel by "
                "Eq. 16 (two-sided), then rigid Kabsch on three metric keypoints; argmax_kabsch_one_sided: the same by "
                "Algorithm 1's rule; refined: page_runtime's registration with scale on the "
                "radii of eight keypoints, without sides; refined_three_keypoints: on those of the voted three"
            ),
            **standard["pose"],
        },
        "by_distance_and_noise": by_noise,
        "planar": results["planar independent"],
        "planar_correlated": results["planar correlated"],
        "mis_scaled": results["mis-scaled"],
        "peak_memory_beyond_inputs": results["memory"],
        "peers": {step.name: results[step.name] for step in steps if step.name.startswith(("peers", "complete"))},
        "target_ratios_at_10_mm": TARGET_RATIOS,
        "paper": {"scoring_ms": PAPER_MS["scoring"], "note": PAPER_NOTE},
        "rules": list(RULES),
        "sweep": [
            {"name": step.name, "varies": step.varies, "value": step.value, **results[step.name]}
            for step in steps
            if step.varies
        ],
        "frames": [results[step.name] for step in steps if step.name.startswith("frame")],
        "machine": measured_on,
    }


def _together(equalities: list[dict[str, Any]]) -> dict[str, Any]:
    """The results of several `measure_equality` as one."""
    cases = sum(one["cases"] for one in equalities)
    mismatches = {rule: sum(one["mismatches"][rule] for one in equalities) for rule in RULES}
    return {
        **equalities[0],
        "equal_fraction": 1.0 - sum(mismatches.values()) / (cases * len(RULES)),
        "cases": cases,
        "mismatches": mismatches,
        "largest_grid_voxels": max(one["largest_grid_voxels"] for one in equalities),
    }
