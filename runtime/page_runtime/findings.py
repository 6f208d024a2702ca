"""What is looked at before a computer is trusted with a loop: software, processor, memory, calibration of a recording.

Each check gives findings and changes nothing. Paths below `root` are Linux's; where there are none, a finding says so.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path
from typing import Literal

import numpy as np

from page_runtime.bundle import BundleMetadata
from page_runtime.camera import Camera
from page_runtime.machine import cpu_name, versions
from page_runtime.recorded import RecordedFrame, Source
from page_runtime.sessions import available_providers

# ok: nothing to do. advice: it works, and would work better. problem: it does not work, or its answers are wrong.
Level = Literal["ok", "advice", "problem"]

EXTRAS = {"oak": "depthai", "ros": "mcap", "view": "rerun", "open3d": "open3d"}
CPU_PROVIDER = "CPUExecutionProvider"
STEADY_GOVERNORS = {"performance", "schedutil"}
BUSY_SHARE = 0.3
# A run on 640 x 480 peaked at 144 MB; frames that wait for slow sinks come to that.
MIN_AVAILABLE_BYTES, GOOD_AVAILABLE_BYTES = 300e6, 700e6
FIELD_OF_VIEW_DEG = (20.0, 130.0)
MAX_ASPECT_ERROR = 0.05
DEPTH_M = (0.1, 15.0)
MIN_VALID_SHARE, GOOD_VALID_SHARE = 0.05, 0.4
FRAMES_READ = 8
# A region is about as large as the object; open lids and drawers make it larger than any of its parts.
SIZE_FACTORS = (0.4, 3.0)


@dataclass(frozen=True, slots=True)
class Finding:
    """topic: what was looked at. what: what was found, a sentence. advice: what to change, empty for nothing."""

    topic: str
    level: Level
    what: str
    advice: str = ""


def check_software() -> Iterator[Finding]:
    """Versions, extras, packages that are in each other's way, onnxruntime's providers."""
    yield Finding("versions", "ok", ", ".join(f"{name} {value}" for name, value in versions().items()))
    yield from check_opencv(distribution.name for distribution in distributions())
    there = [extra for extra, package in EXTRAS.items() if importlib.util.find_spec(package) is not None]
    missing = [extra for extra in EXTRAS if extra not in there]
    advice = f"for cameras, bags or viewers: pip install 'page-edge[{','.join(missing)}]'" if missing else ""
    yield Finding("extras", "ok", f"installed: {', '.join(there) or 'none'}", advice)
    yield check_providers(available_providers())


def check_opencv(installed: Iterable[str | None]) -> Iterator[Finding]:
    """OpenCV's wheels overwrite each other's files."""
    wheels = sorted({name.lower() for name in installed if name and name.lower().startswith("opencv-")})
    if len(wheels) > 1:
        others = " ".join(wheel for wheel in wheels if wheel != "opencv-python-headless")
        advice = f"pip uninstall {' '.join(wheels)}; pip install opencv-python-headless"
        yield Finding("opencv", "problem", f"opencv-python-headless shares its files with {others}", advice)


def check_providers(providers: Sequence[str]) -> Finding:
    """Bundles run on the CPU whatever else there is."""
    if CPU_PROVIDER not in providers:
        advice = "pip install --force-reinstall onnxruntime"
        return Finding("onnxruntime", "problem", f"no {CPU_PROVIDER}, but {', '.join(providers)}", advice)
    others = [name for name in providers if name != CPU_PROVIDER]
    unused = f"; {', '.join(others)} not used" if others else ""
    return Finding("onnxruntime", "ok", f"{CPU_PROVIDER}{unused}")


def check_processor(root: Path = Path("/")) -> Iterator[Finding]:
    """Name, cores, quota, governor and what others take of it."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield Finding("processor", "ok", f"{cpu_name()}, {usable} of {os.cpu_count()} cores for this process")
    yield from _quota(root, usable)
    yield _governor(root)
    if hasattr(os, "getloadavg"):
        yield check_load(os.getloadavg()[0], usable)


def _quota(root: Path, usable: int) -> Iterator[Finding]:
    words = _text(root / "sys/fs/cgroup/cpu.max").split()
    if len(words) == 2 and words[0].isdigit() and words[1].isdigit():
        cores = int(words[0]) / int(words[1])
        if cores < usable:
            advice = f"--threads {max(1, int(cores))}, or give the container more"
            yield Finding("quota", "advice", f"the container may use {cores:.1f} of {usable} cores", advice)


def _governor(root: Path) -> Finding:
    files = sorted((root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"))
    governors = sorted({_text(file).strip() for file in files})
    if not governors:
        return Finding("governor", "ok", "not told by this system, as in most virtual machines")
    if set(governors) <= STEADY_GOVERNORS:
        return Finding("governor", "ok", ", ".join(governors))
    advice = "sudo cpupower frequency-set -g performance: a loop works in bursts, in which others are slow to clock up"
    return Finding("governor", "advice", ", ".join(governors), advice)


def check_load(load: float, cores: int) -> Finding:
    """load: processes that wanted to run, the mean of the last minute."""
    what = f"{load:.1f} processes wanted to run on {cores} cores in the last minute"
    if load <= BUSY_SHARE * cores:
        return Finding("load", "ok", what)
    return Finding("load", "advice", what, "end them (`top` shows which), or expect a latency that wanders")


def check_memory(root: Path = Path("/")) -> Finding:
    """What is left for frames, network and sinks."""
    fields = dict(line.split(":", 1) for line in _text(root / "proc/meminfo").splitlines() if ":" in line)
    if "MemAvailable" not in fields:
        return Finding("memory", "ok", "not told by this system")
    available, total = (int(fields[name].split()[0]) * 1024 for name in ("MemAvailable", "MemTotal"))
    limit = _text(root / "sys/fs/cgroup/memory.max").strip()
    if limit.isdigit():
        used = _text(root / "sys/fs/cgroup/memory.current").strip()
        available = min(available, int(limit) - (int(used) if used.isdigit() else 0))
        total = min(total, int(limit))
    what = f"{available / 1e6:.0f} of {total / 1e6:.0f} MB are free"
    if available < MIN_AVAILABLE_BYTES:
        return Finding("memory", "problem", what, f"free {MIN_AVAILABLE_BYTES / 1e6:.0f} MB: the loop may be killed")
    if available < GOOD_AVAILABLE_BYTES:
        return Finding("memory", "advice", what, "record without --view and --web, whose frames wait in memory")
    return Finding("memory", "ok", what)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def some_frames(source: Source) -> list[RecordedFrame]:
    """At most FRAMES_READ frames, evenly over the source."""
    chosen = np.unique(np.linspace(0, len(source) - 1, min(len(source), FRAMES_READ)).round().astype(int))
    return [source.entries[i].read() for i in chosen]


def check_recording(source: Source, frames: Sequence[RecordedFrame], metadata: BundleMetadata | None) -> list[Finding]:
    """Whether calibration, depth unit and times can be what they are said to be.

    metadata: of the bundle that is to find the objects, where there is one.
    """
    found = [
        *check_camera(frames[0].frame.camera),
        check_depth(np.concatenate([recorded.frame.depth_m.reshape(-1) for recorded in frames])),
        *check_times([entry.timestamp_s for entry in source.entries], [entry.skew_s for entry in source.entries]),
    ]
    if metadata is not None:
        found += check_sizes(frames, metadata)
    return found


def check_camera(camera: Camera) -> Iterator[Finding]:
    """Focal lengths that no camera of this kind has."""
    fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
    angle_deg = float(np.degrees(2.0 * np.arctan(camera.width / (2.0 * fx))))
    what = f"{camera.width}x{camera.height}, fx {fx:.1f}, fy {fy:.1f} px, {angle_deg:.0f} degrees wide"
    low, high = FIELD_OF_VIEW_DEG
    if not low <= angle_deg <= high:
        advice = "K may be of another resolution: page-calibrate convert makes one of the delivered pictures"
        yield Finding("calibration", "problem", what, advice)
    elif abs(fx / fy - 1.0) > MAX_ASPECT_ERROR:
        yield Finding("calibration", "problem", what, "pixels are square: fx and fy may be of different resolutions")
    else:
        advice = "page-calibrate check RECORDING looks at edges, whether it fits the pictures"
        yield Finding("calibration", "ok", what, advice)


def check_depth(depth_m: np.ndarray) -> Finding:
    """Readings there are, and whether they are metres. depth_m: (n,) m, 0 for none."""
    readings = depth_m[depth_m > 0]
    share = len(readings) / max(1, len(depth_m))
    median_m = float(np.median(readings)) if len(readings) else 0.0
    what = f"{100 * share:.0f} % of the pixels have a reading, {median_m:.2f} m in the median"
    low, high = DEPTH_M
    if share < MIN_VALID_SHARE:
        return Finding("depth", "problem", what, "is the projector on, the lens clean, the scene within range?")
    if not low <= median_m <= high:
        return Finding("depth", "problem", what, "the depth unit may be wrong by a thousand: see depth_scale")
    if share < GOOD_VALID_SHARE:
        return Finding("depth", "advice", what, "more light or texture, or a mode with a longer baseline")
    return Finding("depth", "ok", what)


def check_times(times_s: Sequence[float], skews_s: Sequence[float]) -> Iterator[Finding]:
    """Whether the clock goes forward, at what pace, and how far depth is from colour."""
    steps_s = np.diff(np.asarray(times_s, float))
    if not len(steps_s):
        return
    period_s = float(np.median(steps_s))
    if (steps_s <= 0).any():
        what = f"{int((steps_s <= 0).sum())} of {len(steps_s)} times do not go forward"
        yield Finding("times", "advice", what, "tracking and videos need them: page-runtime convert --fps N")
        return
    late = int((steps_s > 1.5 * period_s).sum())
    yield Finding("times", "ok", f"{1 / period_s:.1f} frames/s in the median, {late} gaps of a frame or more")
    skew_s = float(np.max(np.abs(skews_s)))
    if skew_s > period_s / 2:
        what = f"depth is up to {skew_s * 1e3:.1f} ms from colour"
        yield Finding("skew", "advice", what, "what moves is seen in two places: synchronise the sensors")


def check_sizes(frames: Sequence[RecordedFrame], metadata: BundleMetadata) -> Iterator[Finding]:
    """Whether regions are as large, by K and depth, as the category's objects are."""
    parts = metadata.category.parts
    low_m = SIZE_FACTORS[0] * min(part.diagonal_range_m[0] for part in parts)
    high_m = SIZE_FACTORS[1] * max(part.diagonal_range_m[1] for part in parts)
    sizes_m = []
    for recorded in frames:
        for x, y, w, h in (i.region for i in recorded.instances if i.region is not None):
            depth_m = recorded.frame.depth_m[max(0, y) : y + h, max(0, x) : x + w]
            if (depth_m > 0).any():
                focal_px = float(recorded.frame.camera.K[0, 0])
                sizes_m.append(float(np.hypot(w, h)) * float(np.median(depth_m[depth_m > 0])) / focal_px)
    if not sizes_m:
        return
    size_m = float(np.median(sizes_m))
    what = f"regions are {size_m:.2f} m across in the median; {metadata.category.name} is {low_m:.2f} to {high_m:.2f} m"
    if low_m <= size_m <= high_m:
        yield Finding("size", "ok", what)
    else:
        yield Finding("size", "problem", what, "K or the depth unit is wrong, or the bundle is for other objects")
