"""The figures of `page-runtime validate` as tables for people."""

from __future__ import annotations

from typing import Any

from page_runtime.commands.terminal import number, table

HEADER = (
    "part", "visible", "missing", "rot mean", "median", "trans mean", "median", "of diag.", "IoU mean", "median",
    "5deg5cm", "10deg10cm", "failures",
)  # fmt: skip
UNITS = ("", "", "", "deg", "deg", "mm", "mm", "%", "", "", "%", "%", "%")


def readable(document: dict[str, Any], *, paper: bool = False) -> str:
    """The figures of `validate`, or of `page-train evaluate`, as tables for people; paper: with those that count as the
    paper does."""
    document = document | {"parts": [part | {"name": _called(part, document)} for part in document["parts"]]}
    rows = [UNITS, *(_row(part) for part in document["parts"])]
    counts = f"{document['frames']} frames, {document['instances']} objects"
    title = f"{document['recording']}: {counts}, bundle {document['bundle']}"
    notes = (
        "rotation, translation: over visible parts that have a pose; the rest: over all visible parts\n"
        "failure: no pose, or worse than 30 deg or half the part's diagonal\n"
    )
    states = "".join(_joint_line(joint) for joint in document["joints"])
    more = "".join(_category_line(category) for category in document.get("categories", ()))
    compatible = _paper(document) if paper else ""
    return f"{title}\n{table(HEADER, rows)}{_occlusion(document)}{states}{more}{notes}{compatible}"


def _called(part: dict[str, Any], document: dict[str, Any]) -> str:
    """A part's name, with its category's where there are several."""
    return part["name"] if len(document.get("categories", ())) < 2 else f"{part['category']} {part['name']}"


def _category_line(category: dict[str, Any]) -> str:
    """What is known of a category's parts together: how sure the shares are, points, radii, keypoints, confidence."""
    failures, interval = category["failure_rate"], category["share_ci95"]["failure_rate"]
    bounds = "" if interval is None else f" (95 % interval {100 * interval[0]:.1f} to {100 * interval[1]:.1f})"
    segmented, trust = category["segmentation"], category["confidence"]
    radius, keypoint = category["radius_m"]["median"], category["keypoint_m"]["median"]
    return (
        f"{category['name']}: {number(_times(failures, 100), 1)} % failures{bounds}; points of the right part "
        f"{number(_times(segmented['accuracy_on_object'], 100), 1)} %; radii {number(_times(radius, 1e3), 1)} mm, "
        f"keypoints {number(_times(keypoint, 1e3), 1)} mm off in the median; confidence off by "
        f"{number(trust['calibration_error'], 3)}\n"
    )


def _paper(document: dict[str, Any]) -> str:
    compatible = document["paper_compatible"]
    rows = [
        (_called(part, document), number(part["rotation_deg"], 2), number(_times(part["translation_m"], 1e3), 1))
        for part in compatible["parts"]
    ]
    header = ("paper-compatible", "rot mean, deg", "trans mean, mm")
    return f"\n{table(header, rows)}{compatible['what']}\n"


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
    axis = number(joint["axis_deg"]["median"], 2)
    return (
        f"joint {joint['name']}: state wrong by {mean} {unit} in the mean, {median} in the median ({counts}); axis "
        f"{axis} deg in the median\n"
    )


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
