"""Following an object against finding it anew in every frame, on procedural sequences.

    python benchmarks/tracking.py [CATEGORY ...] [--bundles DIR] [--cache DIR] [--json FILE]

Sequences (`sequences.py`: 300 frames, object and joints moving, standing still for a while, hidden for ten frames) are
rendered once into the cache, frame by frame. Both ways get each frame in turn, so that both have the machine as it is.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from page_runtime.commands.inputs import load_network
from page_runtime.commands.outputs import require_file_place, write_json
from page_runtime.commands.terminal import Progress, number, table
from page_runtime.commands.usage import UsageError
from page_runtime.live.deadline import Deadline
from page_runtime.live.each import EachByItself
from page_runtime.live.following import Tracking
from page_runtime.live.locate import OwnRegions
from page_runtime.live.loop import Followed, Follower
from page_runtime.live.motion import step_between
from page_runtime.machine import cpu_name, versions
from page_runtime.network import Network
from page_runtime.pose import PartPose
from page_runtime.recorded import RecordedFrame

ROOT = Path(__file__).resolve().parents[1]
EXIT_BAD_INPUT = 2
# Each with the seed of its sequence: the first whose object the bundle recognises (a track begins at a mean confidence
# of 0.5). The drawers of seeds 0 and 1 are chests over two metres away: in no frame of the one, and not in the first of
# the other, is it that sure.
CATEGORIES = {"box": 0, "laptop": 0, "drawer": 2}
WAYS = ("search", "track")
# Right enough to say that the object was found again: degrees and metres.
FOUND_DEG, FOUND_M = 15.0, 0.05


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(prog="tracking.py", description="Following against finding anew.")
    parser.add_argument("categories", nargs="*", default=list(CATEGORIES), metavar="CATEGORY")
    parser.add_argument("--bundles", type=Path, default=ROOT / "runtime" / "bundles", metavar="DIR")
    parser.add_argument("--cache", type=Path, default=ROOT / "benchmarks" / "cache", metavar="DIR")
    parser.add_argument("--frames", type=int, default=0, metavar="N", help="of each sequence (default: all)")
    parser.add_argument("--seed", type=int, metavar="S", help="of the sequences (default: the category's own)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    try:
        _run(options)
    except (UsageError, ValueError, OSError) as error:
        print(f"tracking: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    return 0


def _run(options: argparse.Namespace) -> None:
    from benchmarks.sequences import FRAMES, sequence

    require_file_place(options.json, option="--json")
    frames = options.frames or FRAMES
    document: dict[str, Any] = {"frames": frames, "cpu": cpu_name(), "versions": versions()}
    document["categories"] = {}
    for category in options.categories:
        network, threads = load_network(options.bundles / f"{category}.onnx", threads=0, looks=1)
        document["threads"] = threads
        seed = CATEGORIES.get(category, 0) if options.seed is None else options.seed
        with Progress(category, frames, quiet=False) as progress:
            recorded = sequence(category, options.cache, seed=seed, frames=frames)
            document["categories"][category] = {"seed": seed, **_measured(network, recorded, progress)}
        if options.json is not None:
            write_json(options.json, document)
    sys.stdout.write(readable(document))


def _measured(network: Network, recorded: Any, progress: Progress) -> dict[str, Any]:
    followers: dict[str, Follower] = {
        "search": EachByItself(network, OwnRegions(), max_looks=1),
        "track": Tracking(network, OwnRegions(1)),
    }
    times: dict[str, list[float]] = {way: [] for way in WAYS}
    errors: dict[str, list[NDArray[np.floating]]] = {way: [] for way in WAYS}
    by_depth: list[bool] = []
    for one in recorded:
        for way in WAYS:
            began = perf_counter()
            followed = followers[way].follow(one, Deadline())
            times[way].append(1e3 * (perf_counter() - began))
            errors[way].append(_errors(followed, one, len(network.metadata.category.parts)))
            if way == "track":
                by_depth.append(bool(followed.objects) and not followed.stage_ms.get("network"))
        progress.advance()
    names = [part.name for part in network.metadata.category.parts]
    found = {way: _figures(np.array(times[way]), np.array(errors[way]), names) for way in WAYS}
    p50 = {way: found[way]["frame_ms"]["p50"] for way in WAYS}
    after = {way: _after_hidden(np.array(errors[way])) for way in WAYS}
    return {
        **found,
        "p50_ratio": round(p50["track"] / p50["search"], 3),
        "frames_by_depth_alone": sum(by_depth),
        "after_hidden": after["track"] | {"search_right_share_of_next_60": after["search"]["right_share_of_next_60"]},
    }


def _errors(followed: Followed, recorded: RecordedFrame, count: int) -> NDArray[np.floating]:
    """(parts, 6) the step [rad, m] from the true pose to the estimate; NaN without one."""
    steps = np.full((count, 6), np.nan)
    truths = recorded.instances[0].truths
    if not followed.objects or truths is None:
        return steps
    for k, (part, truth) in enumerate(zip(followed.objects[0].pose.parts, truths, strict=True)):
        if isinstance(part, PartPose):
            steps[k] = step_between(truth.T_camera_part, part.T_camera_part)
    return steps


def _figures(times_ms: NDArray[np.floating], errors: NDArray[np.floating], names: list[str]) -> dict[str, Any]:
    """times_ms (F,) and errors (F, parts, 6); frames in which nothing was found are left out of the times. ValueError
    where that is all of them."""
    timed = times_ms[np.isfinite(errors[:, :, 0]).any(axis=1)]
    if not len(timed):
        raise ValueError("the object was found in no frame: nothing can be measured; take another --seed")
    p50, p95 = np.percentile(timed, [50, 95]).tolist()
    return {
        "frame_ms": {"p50": round(p50, 2), "p95": round(p95, 2), "mean": round(float(timed.mean()), 2)},
        "frames_per_s": round(1e3 / float(timed.mean()), 1),
        "parts": [{"name": name, **_part_figures(errors[:, k])} for k, name in enumerate(names)],
    }


def _part_figures(errors: NDArray[np.floating]) -> dict[str, Any]:
    """Of one part, (F, 6). jitter: how much the error changes from frame to frame, median and root mean square."""
    rotation, translation = np.degrees(_lengths(errors[:, :3])), 1e3 * _lengths(errors[:, 3:])
    change = np.diff(errors, axis=0)
    jitter = np.degrees(_lengths(change[:, :3])), 1e3 * _lengths(change[:, 3:])
    return {
        "missing": int(np.isnan(rotation).sum()),
        "rotation_deg": _middle(rotation),
        "translation_mm": _middle(translation),
        "jitter_deg": _middle(jitter[0]) | {"rms": _rms(jitter[0])},
        "jitter_mm": _middle(jitter[1]) | {"rms": _rms(jitter[1])},
    }


def _lengths(rows: NDArray[np.floating]) -> NDArray[np.floating]:
    return np.linalg.norm(rows, axis=1)


def _middle(values: NDArray[np.floating]) -> dict[str, float]:
    p50, p95 = np.nanpercentile(values, [50, 95]).tolist()
    return {"p50": round(p50, 3), "p95": round(p95, 3)}


def _rms(values: NDArray[np.floating]) -> float:
    return round(float(np.sqrt(np.nanmean(values**2))), 3)


def _after_hidden(errors: NDArray[np.floating]) -> dict[str, Any]:
    """Of (F, parts, 6): poses claimed while the object was hidden, the frame in which it was found again, and how often
    it was right from then on."""
    from benchmarks.sequences import HIDDEN

    right = np.array(
        [
            np.isfinite(frame).all()
            and np.degrees(_lengths(frame[:, :3])).max() < FOUND_DEG
            and _lengths(frame[:, 3:]).max() < FOUND_M
            for frame in errors
        ]
    )
    after = right[HIDDEN.stop : HIDDEN.stop + 60]
    return {
        "claimed_while_hidden": int(np.isfinite(errors[HIDDEN.start : HIDDEN.stop, :, 0]).any(axis=1).sum()),
        "frames_until_right": int(after.argmax()) if after.any() else None,
        "right_share_of_next_60": round(float(after.mean()), 3) if len(after) else None,
    }


def readable(document: dict[str, Any]) -> str:
    """A table for people."""
    header = ("", "p50 ms", "p95 ms", "fps", "part", "rot deg", "mm", "jitter deg", "rms", "jitter mm", "rms")
    rows: list[tuple[str, ...]] = []
    notes = ""
    for category, figures in document["categories"].items():
        for way in WAYS:
            own = figures[way]
            for index, part in enumerate(own["parts"]):
                times = (own["frame_ms"]["p50"], own["frame_ms"]["p95"], own["frames_per_s"])
                rows.append(
                    (
                        f"{category} {way}" if index == 0 else "",
                        *(number(value, 1) if index == 0 else "" for value in times),
                        part["name"],
                        number(part["rotation_deg"]["p50"], 2),
                        number(part["translation_mm"]["p50"], 1),
                        number(part["jitter_deg"]["p50"], 2),
                        number(part["jitter_deg"]["rms"], 2),
                        number(part["jitter_mm"]["p50"], 2),
                        number(part["jitter_mm"]["rms"], 2),
                    )
                )
        after = figures["after_hidden"]
        right = 100 * (after["right_share_of_next_60"] or 0)
        by_search = 100 * (after["search_right_share_of_next_60"] or 0)
        notes += (
            f"{category}: a frame takes {100 * figures['p50_ratio']:.0f} % of the search's time in the median; hidden "
            f"for ten frames: {after['claimed_while_hidden']} poses claimed meanwhile, right again after "
            f"{after['frames_until_right']} frames, then in {right:.0f} % of 60 (the search: {by_search:.0f} %)\n"
        )
    return f"{table(header, rows)}{notes}{document['threads']} threads, {document['cpu']}\n"


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.tracking` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
