"""Plots of the full sweep. The only module that imports matplotlib."""

from pathlib import Path
from typing import Any

import matplotlib  # pyright: ignore[reportMissingImports]

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # pyright: ignore[reportMissingImports]

AXES = {
    "points": "points of the part",
    "sigma_mm": "noise of radii, sigma, mm",
    "outliers": "share of outliers",
    "voxel_mm near": "rho, mm; keypoints near",
    "voxel_mm mid": "rho, mm; keypoints mid",
    "voxel_mm far": "rho, mm; keypoints far",
}
ERRORS = {
    "voxel": "first arg-max voxel, Eq. 16",
    "voxel_one_sided": "first arg-max voxel, Algorithm 1",
    "refined": "refined peak",
    "registered": "registered, 7 degrees of freedom",
}


def draw(document: dict[str, Any], folder: Path) -> list[Path]:
    """Write the plots into the folder; returns their paths."""
    figures = {
        "time.png": _against("ms", document),
        "error.png": _against("error", document),
        "peers.png": _peers(document["peers"]),
        "frames.png": _frames(document),
    }
    paths = []
    for name, figure in figures.items():
        figure.tight_layout()
        figure.savefig(folder / name, dpi=120)
        plt.close(figure)
        paths.append(folder / name)
    return paths


def _against(what: str, document: dict[str, Any]) -> Any:
    figure, places = plt.subplots(2, 3, figsize=(12, 7))
    for place, (varies, label) in zip(places.flat, AXES.items(), strict=True):
        steps = sorted((step for step in document["sweep"] if step["varies"] == varies), key=lambda step: step["value"])
        values = [step["value"] for step in steps]
        if what == "ms":
            for percentile, style in (("p50", "o-"), ("p95", "o:")):
                place.plot(values, [step["ms_per_keypoint"][percentile] for step in steps], style, label=percentile)
            place.set_ylabel("wall ms per keypoint")
        else:
            for name, meaning in ERRORS.items():
                if all(name in step["keypoint_mm"] for step in steps):
                    place.plot(values, [step["keypoint_mm"][name] for step in steps], "o-", label=meaning)
            place.set_ylabel("median keypoint error, mm")
        if varies == "points":
            place.set_xscale("log", base=2)
        place.set_xlabel(label)
        place.set_ylim(bottom=0)
        place.grid(alpha=0.3)
    places.flat[0].legend(fontsize=8)
    figure.suptitle(
        "mid keypoints, rho 5 mm, sigma 5 mm, 15 % outliers, 512 points where not said otherwise", fontsize=10
    )
    return figure


def _peers(peers: dict[str, Any]) -> Any:
    names = [name for name in peers if name.startswith("peers")]
    figure, place = plt.subplots(figsize=(10, 5))
    kinds = list(dict.fromkeys(kind for name in names for kind in peers[name]["peers"]))
    series = {
        "page_runtime.scoring, measured": [peers[name]["scorer"]["two-sided"]["cpu_ms_per_keypoint"] for name in names]
    }
    series |= {
        f"{kind}, extrapolated": [peers[name]["peers"][kind]["cpu_ms_per_keypoint"] for name in names] for kind in kinds
    }
    width = 0.8 / len(series)
    for i, (label, values) in enumerate(series.items()):
        place.bar([x + i * width for x in range(len(names))], values, width, label=label)
    place.set_yscale("log")
    place.set_ylabel("CPU ms per keypoint, one thread")
    place.set_xticks(
        [x + 0.4 - 0.5 * width for x in range(len(names))],
        [name.removeprefix("peers ").replace(" mm", " mm\n") for name in names],
    )
    place.legend(fontsize=8)
    place.grid(axis="y", alpha=0.3)
    return figure


def _frames(document: dict[str, Any]) -> Any:
    figure, place = plt.subplots(figsize=(7, 5))
    kinds = dict.fromkeys((frame["distance"], frame["voxel_m"]) for frame in document["frames"])
    for distance, voxel_m in kinds:
        frames = [f for f in document["frames"] if (f["distance"], f["voxel_m"]) == (distance, voxel_m)]
        label = f"{distance}, rho {1e3 * voxel_m:g} mm"
        place.plot([frame["parts"] for frame in frames], [frame["ms"]["p50"] for frame in frames], "o-", label=label)
    paper = document["paper"]
    label = f"paper: {paper['scoring_ms']:.0f} ms, RTX 4090, rho and K unknown"
    place.axhline(paper["scoring_ms"], color="black", linestyle="--", label=label)
    place.set_xlabel("K parts, 3 keypoints each, 2048 points in all")
    place.set_ylabel("scoring of a frame, wall ms p50")
    place.set_ylim(bottom=0)
    place.legend(fontsize=8)
    place.grid(alpha=0.3)
    return figure


def draw_reliability(document: dict[str, Any], path: Path) -> None:
    """The share of right poses over their mean confidence, with its standard error and the number of parts."""
    figure, axes = plt.subplots(figsize=(5.0, 4.4), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1, linestyle="--", label="as it should be")
    mean = [one["confidence"] for one in document["bins"]]
    right = [one["right"] for one in document["bins"]]
    errors = [(max(r * (1 - r), 0.02) / one["count"]) ** 0.5 for r, one in zip(right, document["bins"], strict=True)]
    axes.errorbar(mean, right, yerr=errors, marker="o", capsize=3, label=document["bundle"])
    for x, y, one in zip(mean, right, document["bins"], strict=True):
        axes.annotate(str(one["count"]), (x, y), textcoords="offset points", xytext=(6, -11), fontsize=8)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.05), xlabel="confidence", ylabel="share within 5 deg and 5 cm")
    axes.legend(loc="upper left")
    figure.savefig(path, dpi=110)
    plt.close(figure)
