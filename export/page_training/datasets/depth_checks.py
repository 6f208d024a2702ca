"""Do the marked pixels and their depth lie where the annotated parts are? If not, what would have to be otherwise?

A unit or intrinsics that are wrong by a factor are the ones under which they do not, and the right ones are those under
which they do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from page_runtime.camera import Camera
from page_training.datasets.evidence import (
    LEAST_PIXELS,
    SeenPart,
    outline_px,
    overlap,
    reach_in_outline,
    share_in_box,
    share_in_outline,
    share_outside_region,
    with_focal_times,
    with_K_times,
)
from page_training.datasets.findings import Finding, in_places

# Of the pixels of a part in its box's outline: all of them in 286 parts of real and of made pictures with true poses.
OUTLINE_SHARE = 0.95
# Tight boxes are reached by 0.976 (90th percentile) in real pictures with masks drawn by hand, where parts hide parts.
LEAST_REACH = 0.88
# Half: the median depth of the part. Noise and bleeding edges take the rest out of thin parts.
BOX_SHARE = 0.5
# More parts than that are no slips of single annotations.
MANY = 0.2
# Regions are those of a detector, which cut parts off: most of a part they do not.
OUTSIDE_SHARE = 0.5
# Most of an object without depth: networks were trained with gaps, not with holes.
MOST_MISSING = 0.5
UNITS = (1.0, 1e-3, 2.5e-4, 1e-4, 1.0 / 5000.0, 1e-5)
FACTORS = (0.5, 2 / 3, 0.75, 0.8, 1.25, 4 / 3, 1.5, 2.0)
# What an explanation has to be better by than the annotation as it is.
BETTER = 1.15
# Reading their pictures takes seconds.
MAX_FRAMES = 40
MOST_EXPLAINED = 60


def sampled(count: int, most: int) -> list[int]:
    """At most `most` of `count` frames, evenly: their pictures are read."""
    return sorted({int(i) for i in np.linspace(0, count - 1, min(count, most))}) if count else []


def check_seen(parts: Sequence[SeenPart], unit_in_words: Callable[[float], str]) -> Iterator[Finding]:
    """Findings of marked parts: masks, outlines, depth. unit_in_words: how the format says metres a unit."""
    yield from _masks(parts)
    marked = [part for part in parts if len(part.pixels) >= LEAST_PIXELS]
    if not marked:
        yield Finding("error", "depth", "no depth inside any mask: nothing of it can be checked")
        return
    outlines, depths = _outlines(marked), _depths(marked)
    if any(one.severity == "error" for one in (*outlines, *depths)):
        yield from _with_explanation([*outlines, *depths], marked, unit_in_words)
    else:
        yield from (*outlines, *depths)


def _masks(parts: Sequence[SeenPart]) -> Iterator[Finding]:
    empty = [part.place for part in parts if not len(part.pixels) and (part.visible_share or 0.0) > 0.02]
    if empty:
        yield Finding(
            "error",
            "masks",
            f"{len(empty)} of {len(parts)} masks are empty though their parts are said to be seen; write them again",
            in_places(empty),
        )
    marked = [part for part in parts if len(part.pixels) >= LEAST_PIXELS]
    astray = [part.place for part in marked if share_outside_region(part) > OUTSIDE_SHARE]
    if astray:
        yield Finding(
            "error",
            "masks",
            f"{len(astray)} of {len(parts)} masks lie mostly outside the region of their object; one of the two "
            "is wrong",
            in_places(astray),
        )


def _outlines(parts: Sequence[SeenPart]) -> list[Finding]:
    outlines = [outline_px(part, part.camera) for part in parts]
    shares = np.array([
        0.0 if outline is None else share_in_outline(part, outline)
        for part, outline in zip(parts, outlines, strict=True)
    ])  # fmt: skip
    beyond = [part.place for part, share in zip(parts, shares, strict=True) if share < OUTLINE_SHARE]
    if beyond:
        return [
            Finding(
                "error",
                "outlines",
                f"{len(beyond)} of {len(parts)} parts are marked outside the outline of their box, "
                f"{100 * (1 - shares[shares < OUTLINE_SHARE].mean()):.0f} % of their pixels: {_whose(beyond, parts)}",
                in_places(beyond),
            )
        ]
    reaches = [
        reach_in_outline(part, outline)
        for part, outline in zip(parts, outlines, strict=True)
        if part.whole and outline is not None
    ]
    # What hides a part takes from its reach: only that of those which are seen best says something.
    reach = float(np.quantile(reaches, 0.9)) if reaches else 1.0
    if reach < LEAST_REACH:
        return [
            Finding(
                "error",
                "outlines",
                f"marked parts reach over {100 * reach:.0f} % of their box's outline (90th percentile), expected "
                f"{100 * LEAST_REACH:.0f} and more: K, the boxes' sizes or distances are wrong by a factor",
                parts[0].place,
            )
        ]
    return [Finding("fine", "outlines", f"{len(parts)} marked parts lie in the outlines of their boxes")]


def _whose(bad: Sequence[str], parts: Sequence[SeenPart]) -> str:
    if len(bad) > MANY * len(parts):
        return "poses, K or masks of all of them are of another convention"
    return "poses or masks of these are wrong; correct them or leave them out"


def _depths(parts: Sequence[SeenPart]) -> list[Finding]:
    findings = []
    missing = np.array([float((part.units == 0).mean()) for part in parts])
    blind = [part.place for part, share in zip(parts, missing, strict=True) if share == 1.0]
    if len(blind) == len(parts):
        return [Finding("error", "depth", "no depth inside any mask: record or register depth again", in_places(blind))]
    if blind:
        what = f"{len(blind)} of {len(parts)} marked parts have no depth at all; leave them out"
        findings.append(Finding("warning", "depth", what, in_places(blind)))
    if float(np.median(missing)) > MOST_MISSING:
        what = f"{100 * np.median(missing):.0f} % of the depth inside the masks is missing (median); check the sensor"
        findings.append(Finding("warning", "depth", what))
    shares = np.array([share_in_box(part) for part in parts])
    seen = np.isfinite(shares)
    beyond = [part.place for part, share in zip(parts, shares, strict=True) if share < BOX_SHARE]
    what = f"{100 * shares[seen].mean():.1f} % of the depth inside the masks lies in the parts' boxes"
    if len(beyond) > MANY * seen.sum():
        findings.append(Finding("error", "depth", what, in_places(beyond)))
        return findings
    findings.append(Finding("fine", "depth", f"{what}; {100 * missing.mean():.1f} % of it is missing"))
    if beyond:
        what = f"of {len(beyond)} of {len(parts)} parts most depth lies outside their box; look at them"
        findings.append(Finding("warning", "depth", what, in_places(beyond)))
    return findings


def _with_explanation(
    findings: Sequence[Finding], parts: Sequence[SeenPart], unit_in_words: Callable[[float], str]
) -> Iterator[Finding]:
    """The findings, what explains them said with the first error."""
    told = explained(parts, unit_in_words)
    for one in findings:
        if one.severity == "error" and told:
            yield Finding(one.severity, one.check, f"{one.what}; but all agree {told}", one.where)
            told = ""
        else:
            yield one


def explained(parts: Sequence[SeenPart], unit_in_words: Callable[[float], str]) -> str:
    """What would have to be changed for the parts to agree with what is seen of them, in words; "" for nothing."""
    every = max(1, len(parts) // MOST_EXPLAINED)
    chosen = parts[::every]
    own = chosen[0].metres_per_unit
    candidates: dict[str, Callable[[SeenPart], float]] = {"": _agreement}
    for unit_m in UNITS:
        if abs(unit_m / own - 1.0) > 0.01:
            candidates[f"with {unit_in_words(unit_m)}"] = partial(_agreement, metres_per_unit=unit_m)
    for factor in FACTORS:
        candidates[f"with K times {factor:.3g}"] = partial(_agreement, changed=partial(with_K_times, factor=factor))
        focal = partial(with_focal_times, factor=factor)
        candidates[f"with fx and fy times {factor:.3g}"] = partial(_agreement, changed=focal)
    for name in sorted({name for part in chosen for name in part.others}):
        candidates[name] = partial(_agreement, other=name)
    scores = {name: float(np.mean([score(part) for part in chosen])) for name, score in candidates.items()}
    best = max(scores, key=lambda name: scores[name])
    return best if scores[best] > max(BETTER * scores[""], BOX_SHARE) else ""


def _agreement(
    part: SeenPart,
    *,
    metres_per_unit: float | None = None,
    changed: Callable[[Camera], Camera] | None = None,
    other: str | None = None,
) -> float:
    """0 to 1: overlap of mask and outline times the share of the depth in the box."""
    camera = part.camera if changed is None else changed(part.camera)
    box = None if other is None else part.others.get(other)
    share = share_in_box(part, camera=camera, metres_per_unit=metres_per_unit, box=box)
    return overlap(part, camera, box) * (share if np.isfinite(share) else 0.0)
