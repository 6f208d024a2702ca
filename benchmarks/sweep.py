"""The steps of the scorer's benchmark, the results kept between runs, and the document and table made of them."""

import hashlib
import json
import os
import subprocess
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from benchmarks.measurements import (
    RULES,
    Setting,
    measure_complete,
    measure_equality,
    measure_frames,
    measure_memory,
    measure_mis_scaled,
    measure_parts,
    measure_peers,
    measure_planar,
)
from benchmarks.synthetic import KEYPOINT_DISTANCE_M, Noise

from page_runtime.bench import PAPER_MS, cpu_name, versions
from page_runtime.commands.outputs import write_json
from page_runtime.commands.terminal import number, table

ROOT = Path(__file__).resolve().parents[1]
# A result is of these sources; when they change it is measured again.
SOURCES = (
    "runtime/page_runtime/*.py",
    *(f"benchmarks/{name}.py" for name in ("accumulators", "compiled", "measurements", "synthetic")),
    *(f"tests/{name}.py" for name in ("dense_accumulator", "synthetic_parts")),
)
PARTS_OF_FRAME = (2, 4, 7)
CORRELATED_M = 0.008
BASE = Setting()
CORRELATED = Noise(correlated_m=CORRELATED_M)
PAPER_NOTE = "on an RTX 4090, with a voxel size and a number of parts that the paper does not state"
TARGET_RATIOS = {"gemm": 3000, "algorithm_1": 4000}


@dataclass(frozen=True, slots=True)
class Step:
    """varies, value: what a step of the sweep changes of the base setting, for plots."""

    name: str
    work: Callable[[], dict[str, Any]]
    varies: str = ""
    value: float | str = ""


def quick_steps(
    *, cases: int = 20, parts: int = 12, frames: int = 5, repeats: int = 2, slab_evaluations: float = 1e7
) -> list[Step]:
    """The standard settings. The defaults take some ten seconds of CPU time; a test asks for less."""
    return [
        *_equality_steps(1, cases=cases),
        *_part_steps(parts=parts, repeats=repeats, other_repeats=1),
        *(_frame_step("mid", 0.005, k, frames=frames, repeats=repeats) for k in PARTS_OF_FRAME),
        *_single_steps(planar=parts, parts=parts),
        _peer_step("mid", 0.010, parts=4, slab_evaluations=slab_evaluations),
    ]


def full_steps() -> list[Step]:
    base = replace(BASE, parts=40)
    changes: list[tuple[str, float | str, Setting]] = [
        *(("points", n, replace(base, num_points=n)) for n in (64, 128, 256, 512, 1024, 2048)),
        *(("sigma_mm", 1e3 * s, replace(base, noise=Noise(sigma_m=s))) for s in (0.0, 0.002, 0.005, 0.010, 0.020)),
        *(("outliers", o, replace(base, noise=Noise(outliers=o))) for o in (0.0, 0.15, 0.40, 0.60)),
        *(
            (f"voxel_mm {name}", 1e3 * voxel_m, replace(base, distance=name, voxel_m=voxel_m))
            for name in KEYPOINT_DISTANCE_M
            for voxel_m in (0.002, 0.005, 0.010)
        ),
        *((f"shape {s}", s, replace(base, shapes=(s,), parts=16)) for s in base.shapes),
    ]
    return [
        *_equality_steps(10, cases=100),
        *_part_steps(parts=40, repeats=3, other_repeats=3),
        *(
            Step(f"{varies} {value:g}" if isinstance(value, float | int) else varies, _parts(setting), varies, value)
            for varies, value, setting in changes
        ),
        *(
            _frame_step(name, voxel_m, k, frames=12, repeats=3)
            for name in KEYPOINT_DISTANCE_M
            for voxel_m in (0.005, 0.010)
            for k in PARTS_OF_FRAME
        ),
        *_single_steps(planar=60, parts=40),
        *(
            _peer_step(name, voxel_m, parts=12, slab_evaluations=2e7)
            for name in KEYPOINT_DISTANCE_M
            for voxel_m in (0.002, 0.005, 0.010)
        ),
        Step("complete", lambda: measure_complete(replace(BASE, distance="near", voxel_m=0.010))),
    ]


def _parts(setting: Setting) -> Callable[[], dict[str, Any]]:
    return lambda: measure_parts(setting)


def _equality_steps(count: int, *, cases: int) -> list[Step]:
    return [Step(f"equality {i}", lambda seed=i: measure_equality(cases, seed=seed)) for i in range(count)]


def _part_steps(*, parts: int, repeats: int, other_repeats: int) -> list[Step]:
    """The standard setting is timed with `repeats`; a quick run reports no times of the others."""
    steps = []
    for name in KEYPOINT_DISTANCE_M:
        for kind, noise in (("independent", Noise()), ("correlated", CORRELATED)):
            times = repeats if (name, kind) == ("mid", "independent") else other_repeats
            setting = replace(BASE, distance=name, noise=noise, parts=parts, repeats=times)
            steps.append(Step(f"parts {name} {kind}", _parts(setting)))
    return steps


def _frame_step(distance: str, voxel_m: float, num_parts: int, *, frames: int, repeats: int) -> Step:
    return Step(
        f"frame {distance} {1e3 * voxel_m:g} mm K={num_parts}",
        lambda: measure_frames(distance, voxel_m, num_parts, frames=frames, repeats=repeats),
    )


def _single_steps(*, planar: int, parts: int) -> list[Step]:
    return [
        Step("planar independent", lambda: measure_planar(parts=planar)),
        Step("planar correlated", lambda: measure_planar(parts=planar, correlated_m=CORRELATED_M)),
        Step("mis-scaled", lambda: measure_mis_scaled(replace(BASE, parts=parts))),
        Step("memory", measure_memory),
    ]


def _peer_step(distance: str, voxel_m: float, *, parts: int, slab_evaluations: float) -> Step:
    setting = replace(BASE, distance=distance, voxel_m=voxel_m, parts=parts)
    name = f"peers {distance} {1e3 * voxel_m:g} mm"
    return Step(name, lambda: measure_peers(setting, slab_evaluations=slab_evaluations))


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
    found = versions()
    for package in ("numba", "matplotlib"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


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


def readable(document: dict[str, Any]) -> str:
    """The figures as tables for people."""
    sections = [
        document["what"],
        _equality(document["equality"]),
        _frames(document["frames"]),
        _errors(document["by_distance_and_noise"]),
        _planar(document),
        _mis_scaled(document["mis_scaled"]),
        *(_peers(name, peers) for name, peers in document["peers"].items()),
    ]
    if document["sweep"]:
        sections.append(_sweep(document["sweep"]))
    memory = ", ".join(f"{value:g} MB ({name})" for name, value in document["peak_memory_beyond_inputs"].items())
    known = document["machine"]
    installed = ", ".join(f"{name} {number}" for name, number in known["versions"].items())
    sections.append(f"peak memory beyond inputs: {memory}")
    sections.append(f"{known['cpu']}, 1 thread, load {known['load']}; commit {known['commit'][:12]}; {installed}")
    return "\n\n".join(section.rstrip("\n") for section in sections) + "\n"


def _equality(equality: dict[str, Any]) -> str:
    wrong = ", ".join(f"{count} mismatches ({rule})" for rule, count in equality["mismatches"].items())
    return f"equal to the dense float64 accumulator in {equality['cases']} random cases: {wrong}"


def _frames(frames: list[dict[str, Any]]) -> str:
    rows = [
        (
            f"{frame['distance']}, rho {1e3 * frame['voxel_m']:g} mm, K = {frame['parts']}",
            number(frame["ms"]["p50"], 1),
            number(frame["ms"]["p95"], 1),
            number(frame["cpu_ms"]["p50"], 1),
            number(frame["scoring_plus_registration_ms"]["p50"], 1),
            number(1e-6 * frame["evaluations"]["p50"], 1),
            _share(frame["certified_share"]),
        )
        for frame in frames
    ]
    header = (
        "one frame, 3 K keypoints",
        "scoring ms p50",
        "p95",
        "CPU ms",
        "+ registration ms",
        "10^6 evaluations",
        "certified",
    )
    return table(header, rows) + f"the paper's scoring: {PAPER_MS['scoring']:.0f} ms {PAPER_NOTE}"


def _errors(by_noise: dict[str, dict[str, Any]]) -> str:
    rows = []
    for name, figures in by_noise.items():
        keypoint, pose = figures["keypoint_mm"], figures["pose"]
        row = [name, *(number(keypoint[kind], 1) for kind in ("voxel", "voxel_one_sided", "refined", "registered"))]
        row.append(f"{100 * figures['wrong_peak_share']:.0f} %")
        for kind in ("argmax_kabsch", "refined_three_keypoints", "refined"):
            row.append(f"{number(pose[kind]['rotation_deg'], 2)} / {number(pose[kind]['translation_mm'], 1)}")
        rows.append(row)
    header = (
        "median errors",
        "voxel mm",
        "one-sided",
        "refined",
        "registered",
        "wrong peak",
        "Kabsch deg / mm",
        "3 kp",
        "8 kp",
    )
    note = (
        "keypoints over those not at a wrong peak by Eq. 16 (> 60 mm); one-sided: voxel by Algorithm 1; Kabsch: first "
        "arg-max voxel by Eq. 16, rigid; 3 kp, 8 kp: page_runtime's registration on the radii of so many keypoints"
    )
    return table(header, rows) + note


def _planar(document: dict[str, Any]) -> str:
    rows = []
    for name in ("planar", "planar_correlated"):
        planar = document[name]
        rows += [
            (f"{name}, poses right", *(_share(value) for value in planar["right_with"].values())),
            (f"{name}, ambiguous", *(_share(value) for value in planar["ambiguous_with"].values())),
        ]
    header = ("plates", *(name.replace("_", " ") for name in document["planar"]["right_with"]))
    listed = ", ".join(f"{_share(document[name]['truth_listed'])} ({name})" for name in ("planar", "planar_correlated"))
    decided = ", ".join(f"{name} {_share(value)}" for name, value in document["planar"]["decided_by"].items())
    return table(header, rows) + f"truth among the listed modes: {listed}; decided by: {decided}"


def _share(value: float) -> str:
    return f"{100 * value:.0f} %"


def _mis_scaled(figures: dict[str, Any]) -> str:
    kinds = ("argmax_kabsch", "refined")
    cost = ", ".join(
        f"{figures[kind]['extra_mm']:+.1f} mm ({kind}, from {figures[kind]['add_mm']:.1f})" for kind in kinds
    )
    return f"keypoints 3 % too large cost, ADD: {cost}"


def _peers(name: str, measured: dict[str, Any]) -> str:
    rows = [
        (f"page_runtime.scoring, {rule}", number(ours["cpu_ms_per_keypoint"], 2), "measured", "1", "-", "-")
        for rule, ours in measured["scorer"].items()
    ]
    for peer, figures in measured["peers"].items():
        rows.append(
            (
                f"{peer}, {figures['rule']}",
                number(figures["cpu_ms_per_keypoint"], 0),
                "extrapolated" if figures["extrapolated"] else "measured",
                number(figures["ratio"], 0),
                number(figures.get("lowest_ratio"), 0),
                number(figures.get("ns_per_evaluation"), 2),
            )
        )
    header = (name, "CPU ms per keypoint", "", "ratio, median", "lowest", "ns per evaluation")
    note = (
        "two-sided is Eq. 16, one-sided Algorithm 1; the ratio is to the scorer under the same rule, whose time has "
        f"its seeds and refinement in it; {_share(measured['scorer']['two-sided']['certified_share'])} of its maxima "
        "by Eq. 16 are certified"
    )
    return table(header, rows) + "\n".join(line for line in (note, measured["missing"]) if line)


def _sweep(sweep: list[dict[str, Any]]) -> str:
    rows = []
    for step in sweep:
        keypoint, pose = step["keypoint_mm"], step["pose"]["refined"]
        rows.append(
            (
                step["name"],
                number(step["ms_per_keypoint"]["p50"], 2),
                number(step["ms_per_keypoint"]["p95"], 2),
                number(1e-6 * step["evaluations_per_keypoint"]["p50"], 2),
                _share(step["certified_share"]),
                *(number(keypoint[kind], 1) for kind in ("voxel", "refined", "registered")),
                _share(step["wrong_peak_share"]),
                f"{number(pose['rotation_deg'], 2)} / {number(pose['translation_mm'], 1)}",
            )
        )
    header = ("standard but", "ms/keypoint p50", "p95", "10^6 evals", "certified", "voxel mm", "refined", "registered")
    return table((*header, "wrong peak", "pose deg / mm"), rows)
