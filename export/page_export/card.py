"""Model cards: what a bundle is, what it was trained on and how well it does, from the bundle and measured figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from page_runtime.bundle import BundleMetadata
from page_runtime.bundle_figures import PartFigures
from page_runtime.capture.documents import field, listed, read_object
from page_runtime.category import Joint, Part
from page_runtime.image_files import SourceError


@dataclass(frozen=True, eq=False, slots=True)
class Figures:
    """What `page-runtime validate --json` wrote. label: what of, in words."""

    label: str
    document: dict[str, Any]


def read_figures(label: str, path: Path, category: str) -> Figures:
    """SourceError where a file is not of `page-runtime validate`, or of another category."""
    document = read_object(path)
    for name in ("recording", "category", "instances", "parts", "joints"):
        field(document, name, where=str(path))
    for part in listed(document["parts"], where=f"{path}, parts"):
        for name in ("name", "rotation_deg", "translation_m", "translation_share", "acc_5deg5cm", "failure_rate"):
            field(part, name, where=f"{path}, parts")
        for name in ("rotation_deg", "translation_m", "translation_share"):
            for kind in ("mean", "median"):
                field(part[name], kind, where=f"{path}, {name}")
    for joint in listed(document["joints"], where=f"{path}, joints"):
        for name in ("name", "unit", "error"):
            field(joint, name, where=f"{path}, joints")
        for kind in ("mean", "median"):
            field(joint["error"], kind, where=f"{path}, joint {joint['name']}")
    if document["category"] != category:
        raise SourceError(f"{path}: expected figures of {category!r}, got {document['category']!r}")
    return Figures(label, document)


def part_figures(figures: Sequence[Figures]) -> tuple[PartFigures, ...]:
    """What of them is kept in a bundle."""

    def pair(values: dict[str, float | None]) -> tuple[float | None, float | None]:
        return _rounded(values["mean"]), _rounded(values["median"])

    return tuple(
        PartFigures(
            data=one.label,
            instances=int(one.document["instances"]),
            part=part["name"],
            rotation_deg=pair(part["rotation_deg"]),
            translation_m=pair(part["translation_m"]),
            translation_share=pair(part["translation_share"]),
            acc_5deg5cm=_rounded(part["acc_5deg5cm"]),
            failure_rate=_rounded(part["failure_rate"]),
        )
        for one in figures
        for part in one.document["parts"]
    )


def _rounded(value: float | None) -> float | None:
    """To the digits that a few hundred frames can know."""
    return None if value is None else float(f"{value:.4g}")


def card(name: str, metadata: BundleMetadata, size_bytes: int, figures: Sequence[Figures]) -> str:
    """The card as Markdown."""
    category, provenance = metadata.category, metadata.provenance
    sections = [
        f"# {name}",
        f"The 6D pose of every part of a {category.name}, {' and '.join(part.name for part in category.parts)}, from "
        f"one RGB-D frame and a box around it. {size_bytes / 1e6:.1f} MB, ONNX opset {metadata.opset}, "
        f"{metadata.num_points} points, {metadata.image_size} x {metadata.image_size} px.",
        "Written by `page-export card`; `page-runtime inspect` shows all that is in the bundle.",
        "## Parts and their frames",
        "\n".join(_part(part) for part in category.parts),
        *(
            ["## Joints", "\n".join(_joint(joint, category.parts) for joint in category.joints)]
            if category.joints
            else []
        ),
        "## Training",
        _training(provenance),
        "## Figures",
        "Mean / median over the visible parts that have a pose. Failure: no pose, or worse than 30 degrees or half the "
        "part's diagonal.",
        _measured(metadata, figures),
        "## Limits",
        _limits(metadata),
    ]
    return "\n\n".join(sections) + "\n"


def _part(part: Part) -> str:
    low, high = part.diagonal_range_m
    return f"- **{part.name}**, diagonal {low:g} to {high:g} m. {part.frame}."


def _joint(joint: Joint, parts: Sequence[Part]) -> str:
    low, high = joint.limits
    unit = "m" if joint.kind == "prismatic" else "rad"
    return (
        f"- **{joint.name}**: {parts[joint.child].name} against {parts[joint.parent].name}, {joint.kind}, "
        f"{low:.3g} to {high:.3g} {unit}."
    )


def _training(provenance: dict[str, Any]) -> str:
    known = {
        "data": provenance.get("trained_on"),
        "frames seen, repeats included": provenance.get("frames_seen"),
        "commit": provenance.get("commit"),
        "SHA-256 of the weights": provenance.get("weights_sha256"),
        "note": provenance.get("note"),
        "settings": provenance.get("training"),
        "parity with the checkpoint": provenance.get("parity"),
    }
    return "\n".join(
        f"- {name}: {value if isinstance(value, str) else '`' + json.dumps(value) + '`'}"
        for name, value in known.items()
        if value not in (None, "")
    )


def _measured(metadata: BundleMetadata, figures: Sequence[Figures]) -> str:
    """Of `figures`, or where none are given of those that the bundle keeps, which say nothing of joints."""
    kept = part_figures(figures) or metadata.figures
    if not kept:
        return "Not measured."
    rows = [
        "| data | part | rotation, deg | translation, mm | of diagonal, % | 5 deg 5 cm, % | failures, % |",
        "|---|---|---|---|---|---|---|",
    ]
    rows += [
        f"| {one.data}, {one.instances} objects | {one.part} | {_pair(one.rotation_deg, 1.0)} "
        f"| {_pair(one.translation_m, 1e3)} | {_pair(one.translation_share, 100.0)} | {_share(one.acc_5deg5cm)} "
        f"| {_share(one.failure_rate)} |"
        for one in kept
    ]
    for one in figures:
        for joint in one.document["joints"]:
            factor, unit = (1e3, "mm") if joint["unit"] == "m" else (1.0, joint["unit"])
            state = f"{_pair((joint['error']['mean'], joint['error']['median']), factor)} {unit}"
            rows.append(f"| {one.label} | state of the {joint['name']} | {state} | | | | |")
    return "\n".join(rows)


def _pair(values: tuple[float | None, float | None], factor: float) -> str:
    return " / ".join("-" if value is None else f"{factor * value:.1f}" for value in values)


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"


def _limits(metadata: BundleMetadata) -> str:
    lines = [
        "- One object a region: the region must be given, and hold the object with little around it.",
        f"- Only what is within {metadata.category.region_radius_m:g} m of the region's middle is looked at.",
    ]
    if metadata.category.focused:
        lines.append(
            "- Its objects are thin: the network runs twice before the first answer, the second time where it saw them."
        )
    if metadata.confidence is None:
        lines.append("- The confidence is not calibrated.")
    else:
        lines.append(
            "- The confidence is the probability of a pose within 5 degrees and 5 cm, calibrated on validation frames "
            "of the same kind; on other data it need not hold."
        )
    if any(part.template is None for part in metadata.category.parts):
        lines.append("- Without templates: poses are from radii alone.")
    return "\n".join(lines)
