"""The ablations as a table for people."""

from __future__ import annotations

from typing import Any

HEADER = (
    "| variant | paper's table | part | rotation mean / median, deg | translation mean, % of diagonal | 5deg5cm, % "
    "| failures, % | paper, rotation mean, deg |\n|---|---|---|---|---|---|---|---|\n"
)


def as_markdown(document: dict[str, Any]) -> str:
    """A row for each part of each variant, in the order they were trained."""
    category, samples = document["category"], document["samples"]
    frames = next(iter(document["results"].values()))["frames"]
    rows = "".join(
        _row(variant, part, index)
        for variant in document["variants"]
        for index, part in enumerate(document["results"][variant["name"]]["parts"])
    )
    return (
        f"Each network saw {samples:,} frames of {category} from the same random weights, a few hundredths of what the "
        f"shipped one has seen; {frames} frames of the test split, one look each. Beside ours the paper's figures, on "
        "other data, of other categories (named), trained to the end.\n\n"
        "Anchors, normalised coordinates and pair voting are written here in the manner of those methods, on the same "
        "layers below the heads, trained with the same budget by the same code; they are not their authors' systems. "
        "The paper's figures beside them are of its Table I, but for 6-PACK's, of Table II.\n\n"
        f"{HEADER}{rows}"
    )


def _row(variant: dict[str, Any], part: dict[str, Any], index: int) -> str:
    rotation, paper = part["rotation_deg"], variant["paper"]
    theirs = "" if paper is None or index >= len(paper) else f"{paper[index]} ({variant['paper_category']})"
    cells = (
        variant["name"] if index == 0 else "",
        variant["table"] if index == 0 else "",
        part["name"],
        f"{_number(rotation['mean'])} / {_number(rotation['median'])}",
        _number(part["translation_share"]["mean"], 100),
        _number(part["acc_5deg5cm"], 100),
        _number(part["failure_rate"], 100),
        theirs,
    )
    return f"| {' | '.join(cells)} |\n"


def _number(value: float | None, times: float = 1.0) -> str:
    return "" if value is None else f"{value * times:.1f}"
