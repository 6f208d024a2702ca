"""The document of the scorer's benchmark as tables to read."""

from typing import Any

from benchmarks.report import PAPER_NOTE

from page_runtime.bench import PAPER_MS
from page_runtime.commands.terminal import number, table


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
