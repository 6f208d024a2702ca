"""What it costs to get a frame: from each container, through the child process of a live source, and to record one.

    python benchmarks/capture.py [--frames N] [--cycles N] [--json FILE]

Frames are 640x480: a smooth noisy picture and depth in millimetres. Decoding is timed frame by frame, in order, on one
thread; registering is of raw depth and raw colour of two cameras, colour's lens taken out. The live path is timed from
the moment the child has a frame to the moment it is there for the application.
Needs the extra ros; --cycles starts and stops a live source so often and says what it has left behind (needs psutil).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from page_runtime.camera import Camera
from page_runtime.capture.conversion import frame_writer
from page_runtime.capture.frame_service import LiveFrame
from page_runtime.capture.layouts import LAYOUTS
from page_runtime.capture.playback import open_source
from page_runtime.capture.supervision import SupervisedSource
from page_runtime.capture.undistortion import undistorted
from page_runtime.commands.outputs import require_file_place, write_json
from page_runtime.commands.terminal import number, table
from page_runtime.commands.usage import UsageError
from page_runtime.depth_registration import registered_frame, registration_between
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import transform_from
from page_runtime.lens import Distortion, RawCamera
from page_runtime.machine import cpu_name, versions
from page_runtime.recorded import RecordedFrame

EXIT_BAD_INPUT = 2
WIDTH, HEIGHT, FPS = 640, 480, 30.0
CAMERA = Camera(np.array([[600.0, 0, 319.5], [0, 600.0, 239.5], [0, 0, 1]]), WIDTH, HEIGHT)
# A depth camera 3 cm beside colour.
DEPTH_CAMERA = Camera(np.array([[440.0, 0, 321.0], [0, 440.0, 238.0], [0, 0, 1]]), WIDTH, HEIGHT)
PLACED = Camera(CAMERA.K, WIDTH, HEIGHT, transform_from(np.eye(3), np.array([-0.03, 0.0, 0.004])))
LENS = Distortion("brown-conrady", np.array([0.26, -0.95, -0.005, 0.003, 1.16]))
PACKAGES = ("page-edge", "numpy", "opencv-python-headless", "mcap", "rosbags", "lz4")


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(prog="capture.py", description="What it costs to get a frame.")
    parser.add_argument("--frames", type=int, default=60, metavar="N", help="to time in each container (default: 60)")
    parser.add_argument("--cycles", type=int, default=0, metavar="N", help="of starting and stopping a live source")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    try:
        require_file_place(options.json, option="--json")
        _run(options)
    except (UsageError, ValueError, OSError) as error:
        print(f"capture: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    return 0


def _run(options: argparse.Namespace) -> None:
    cv2.setNumThreads(1)
    frames = [_frame(index) for index in range(options.frames)]
    document: dict[str, Any] = {"frames": options.frames, "size_px": [WIDTH, HEIGHT], "decode": {}, "record": {}}
    with tempfile.TemporaryDirectory() as folder:
        for layout in LAYOUTS:
            print(f"capture: {layout}", file=sys.stderr)
            path = Path(folder) / (f"{layout}.mcap" if layout == "mcap" else layout)
            with frame_writer(path, layout) as writer:
                document["record"][layout] = _percentiles([_milliseconds(partial(writer.write, f)) for f in frames])
            source = open_source(path)
            document["decode"][layout] = _percentiles([_milliseconds(entry.read) for entry in source.entries])
    first = frames[0].frame
    straighten = partial(undistorted, first.color, first.depth_m, first.camera, LENS)
    straighten()
    document["undistort"] = _percentiles([_milliseconds(straighten) for _ in frames])
    registration = registration_between(RawCamera(DEPTH_CAMERA), RawCamera(PLACED, LENS))
    register = partial(registered_frame, registration, first.color, first.depth_m)
    register()
    document["register"] = _percentiles([_milliseconds(register) for _ in frames])
    print("capture: live", file=sys.stderr)
    document["live"] = _percentiles(_live_delays(options.frames))
    if options.cycles:
        document["cycles"] = _cycles(options.cycles)
    document |= {"cpu": cpu_name(), "versions": versions(PACKAGES)}
    if options.json is not None:
        write_json(options.json, document)
    sys.stdout.write(_readable(document))


def _frame(index: int) -> RecordedFrame:
    rng = np.random.default_rng(index)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    smooth = 127 + 80 * np.sin(columns / 37 + index / 5) * np.cos(rows / 53)
    color = np.clip(smooth[..., None] + rng.normal(0, 3, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8)
    depth_mm = np.rint(900 + rows * 0.7 + 60 * np.sin(columns / 90) + rng.normal(0, 1.5, rows.shape))
    depth_mm[rng.random(depth_mm.shape) < 0.02] = 0
    return RecordedFrame(RgbdFrame(color, (depth_mm * 1e-3).astype(np.float32), CAMERA, index / FPS, index))


def _milliseconds(call: Callable[[], object]) -> tuple[float, float]:
    """Wall time, and the processor's time for this thread: what it would take if nothing else ran."""
    begin, begin_cpu = time.perf_counter(), time.thread_time()
    call()
    return (time.perf_counter() - begin) * 1e3, (time.thread_time() - begin_cpu) * 1e3


def _percentiles(values_ms: list[tuple[float, float]]) -> dict[str, float]:
    wall, cpu = zip(*values_ms, strict=True)
    return {
        **{f"p{p}_ms": round(float(np.percentile(wall, p)), 3) for p in (50, 95, 99)},
        **{f"cpu_p{p}_ms": round(float(np.percentile(cpu, p)), 3) for p in (50, 95)},
    }


def camera_like(stopping: threading.Event) -> Iterator[LiveFrame]:
    """Frames at 30 a second whose time is when the child had them; runs in the child."""
    frame = _frame(0).frame
    units = np.rint(frame.depth_m * 1e3).astype(np.uint16)
    while not stopping.is_set():
        yield LiveFrame(frame.color, units, 1e-3, CAMERA, time.monotonic())
        time.sleep(1 / FPS)


def _source() -> SupervisedSource:
    # By the module's own name: a child process cannot import the program that was started.
    import capture

    return SupervisedSource(capture.camera_like, name="benchmark")


def _live_delays(frames: int) -> list[tuple[float, float]]:
    """From the child's having a frame until it is here, and the processor's time of this process a frame."""
    delays_ms: list[tuple[float, float]] = []
    with _source() as source:
        begin_cpu = time.process_time()
        for recorded in source:
            delay_ms = (time.monotonic() - recorded.frame.timestamp_s) * 1e3
            cpu = time.process_time()
            delays_ms.append((delay_ms, (cpu - begin_cpu) * 1e3))
            begin_cpu = cpu
            if len(delays_ms) == frames:
                return delays_ms
    return delays_ms


def _cycles(count: int) -> dict[str, Any]:
    import psutil

    process = psutil.Process()
    states = []
    for cycle in range(count + 2):
        with _source() as source:
            next(iter(source))
        states.append((process.memory_info().rss, process.num_fds(), threading.active_count()))
        if cycle % 25 == 0:
            print(f"capture: cycle {cycle} of {count}", file=sys.stderr)
    # The first two load what is loaded once.
    first, last = states[1], states[-1]
    names = [entry.name for entry in Path("/dev/shm").iterdir()] if Path("/dev/shm").is_dir() else []
    return {
        "count": count,
        "rss_growth_mb": round((last[0] - first[0]) / 1e6, 2),
        "descriptors": [first[1], last[1]],
        "threads": [first[2], last[2]],
        "children": len(process.children()),
        "shared_memory_files": len(names),
    }


def _readable(document: dict[str, Any]) -> str:
    named = {f"decode {name}": values for name, values in document["decode"].items()}
    named |= {f"record {name}": values for name, values in document["record"].items()}
    named |= {name: document[name] for name in ("undistort", "register", "live")}
    columns = ("p50_ms", "p95_ms", "cpu_p50_ms", "cpu_p95_ms")
    rows = [(name, *(number(values[column], 2) for column in columns)) for name, values in named.items()]
    text = table(("ms", "wall p50", "p95", "processor p50", "p95"), rows)
    if "cycles" in document:
        text += f"cycles: {document['cycles']}\n"
    return text + f"{document['cpu']}\n"


if __name__ == "__main__":
    sys.exit(main())
