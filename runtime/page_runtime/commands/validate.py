"""page-runtime validate: estimates against the truth of a recording."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from page_runtime.commands.inputs import estimates, open_inputs
from page_runtime.commands.outputs import overlay_output, require_file_place, require_folder_place, write_json
from page_runtime.commands.terminal import Progress, number, table
from page_runtime.commands.usage import UsageError
from page_runtime.evaluation import figures_of
from page_runtime.overlay import draw
from page_runtime.pose import ArticulatedPose
from page_runtime.providers import ProviderChoice
from page_runtime.recorded import PartTruth

HEADER = (
    "part", "visible", "missing", "rot mean", "median", "trans mean", "median", "of diag.", "IoU mean", "median",
    "5deg5cm", "10deg10cm", "failures",
)  # fmt: skip
UNITS = ("", "", "", "deg", "deg", "mm", "mm", "%", "", "", "%", "%", "%")


def validate(
    recording: str,
    *,
    bundle: Path,
    json: Path | None,
    overlay: Path | None,
    window_s: float,
    threads: int,
    on: ProviderChoice,
    looks: int,
    quiet: bool,
) -> None:
    """Estimate every object with truth; write the figures to `json` and a table to standard output."""
    inputs = open_inputs(recording, bundle, threads=threads, looks=looks, on=on, window_s=window_s, command="validate")
    if not inputs.source.has_truth:
        raise UsageError(f"{recording}: this {inputs.source.format} has no true poses to compare with")
    require_file_place(json, option="--json")
    require_folder_place(overlay, option="--overlay")
    compared: list[tuple[ArticulatedPose, tuple[PartTruth, ...]]] = []
    with (
        overlay_output(overlay) as pictures,
        Progress("validate", len(inputs.source), quiet=quiet) as progress,
    ):
        for recorded, found in estimates(inputs):
            for instance, pose in found:
                if instance.truths is not None:
                    compared.append((pose, instance.truths))
            if pictures is not None:
                pictures.add(recorded.frame.index, draw(recorded.frame, found, with_truth=True))
            progress.advance()
    document = {
        "recording": Path(recording).name,
        "bundle": bundle.name,
        "frames": len(inputs.source),
        **figures_of(inputs.network.metadata.category, compared),
    }
    if json is not None:
        write_json(json, document)
    sys.stdout.write(readable(document))


def readable(document: dict[str, Any]) -> str:
    """The figures as a table for people."""
    rows = [UNITS, *(_row(part) for part in document["parts"])]
    counts = f"{document['frames']} frames, {document['instances']} objects"
    title = f"{document['recording']}: {counts}, bundle {document['bundle']}"
    notes = (
        "rotation, translation: over visible parts that have a pose; the rest: over all visible parts\n"
        "failure: no pose, or worse than 30 deg or half the part's diagonal\n"
    )
    states = "".join(_joint_line(joint) for joint in document["joints"])
    return f"{title}\n{table(HEADER, rows)}{_occlusion(document)}{states}{notes}"


def _occlusion(document: dict[str, Any]) -> str:
    """A second table, of the parts by how much of them is hidden; nothing where the truth does not say."""
    rows = [
        (
            part["name"],
            f"{100 * level['occlusion'][0]:.0f} to {100 * level['occlusion'][1]:.0f}",
            *_row(part | level)[1:],
        )
        for part in document["parts"]
        for level in part["by_occlusion"]
    ]
    header = (HEADER[0], "hidden", *HEADER[1:])
    return "\n" + table(header, [(UNITS[0], "%", *UNITS[1:]), *rows]) if rows else ""


def _joint_line(joint: dict[str, Any]) -> str:
    times, unit = (1.0, "deg") if joint["unit"] == "deg" else (1e3, "mm")
    mean, median = (number(_times(joint["error"][name], times), 2) for name in ("mean", "median"))
    counts = f"{joint['visible']} visible, {joint['missing']} without a state"
    return f"joint {joint['name']}: state wrong by {mean} {unit} in the mean, {median} in the median ({counts})\n"


def _row(part: dict[str, Any]) -> tuple[str, ...]:
    rotation, translation, iou = part["rotation_deg"], part["translation_m"], part["iou"]
    return (
        part["name"],
        str(part["visible"]),
        str(part["missing"]),
        number(rotation["mean"], 2),
        number(rotation["median"], 2),
        number(_times(translation["mean"], 1e3), 1),
        number(_times(translation["median"], 1e3), 1),
        number(_times(part["translation_share"]["mean"], 100), 1),
        number(iou["mean"], 3),
        number(iou["median"], 3),
        number(_times(part["acc_5deg5cm"], 100), 1),
        number(_times(part["acc_10deg10cm"], 100), 1),
        number(_times(part["failure_rate"], 100), 1),
    )


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor
