"""The measurements of the latency sweeps, each kept under what it depends on."""

from __future__ import annotations

import hashlib
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
from benchmarks.known_answers import KnownAnswers
from benchmarks.report import Cache
from benchmarks.table_steps import BUNDLES, procedural_recording

from page_export.onnx_export import graph_of, write_bundle
from page_runtime.bench import PAPER_MS, report, time_windows
from page_runtime.capture.playback import open_source
from page_runtime.category import Category
from page_runtime.content_hash import own_code_sha256, sha256_of
from page_runtime.machine import cpu_name, load_average, versions
from page_runtime.network import Network
from page_runtime.recorded import Source
from page_runtime.sweep import pooled_errors
from page_training.categories import category_named
from page_training.network import PageNetwork, keypoints_of, network_for
from page_training.records import IMAGE_SIZE
from page_training.templates import with_templates
from page_training.trained import load_trained

WEIGHTS = BUNDLES.parents[1] / "export" / "weights"
# Categories of 2, 2, 3, 4 and 7 parts; what has no bundle is measured with known answers.
PART_COUNTS = ("box", "laptop", "eyeglasses", "drawer", "arm")
CHECKED = "drawer"
SWEPT = "laptop"
POINTS = (512, 1024, 2048, 3072, 4096)
SIZES = (160, 192, 224, 256, 320)
FRAMES, QUICK = 40, 2
SHIPPED, KNOWN = "shipped bundle", "untrained weights, known answers"


def measured(folder: Path, *, threads: int, quick: bool) -> dict[str, Any]:
    """Everything the tables need. folder: of what is kept; interrupted, the same call goes on."""
    frames = QUICK if quick else FRAMES
    cv2.setNumThreads(threads)
    by_parts = [_of_parts(folder, name, frames, threads, known=False) for name in PART_COUNTS]
    by_parts.append(_of_parts(folder, CHECKED, frames, threads, known=True))
    given = {"points": POINTS[:2] if quick else POINTS, "size": SIZES[:1] if quick else SIZES}
    swept = {
        "points": [
            _of_shape(folder, frames, threads, num_points=value, image_size=IMAGE_SIZE) for value in given["points"]
        ],
        "size": [_of_shape(folder, frames, threads, num_points=2048, image_size=value) for value in given["size"]],
    }
    return {
        "cpu": cpu_name(),
        "threads": threads,
        "versions": versions(),
        "paper_ms": PAPER_MS,
        "frames": frames,
        "parts": by_parts,
        "swept": SWEPT,
        **swept,
    }


def _of_parts(folder: Path, name: str, frames: int, threads: int, *, known: bool) -> dict[str, Any]:
    """Of a category: its bundle, or where there is none, or `known`, an untrained network."""
    path, source = BUNDLES / f"{name}.onnx", _recording(name, frames)
    shipped = path.is_file() and not known
    kept = _cache(folder, threads, source, path if shipped else None)

    def work() -> dict[str, Any]:
        if shipped:
            return _timed(Network(path, threads=threads), source, threads)
        category = with_templates(category_named(name))
        with tempfile.TemporaryDirectory() as place:
            untrained = Path(place) / f"{name}.onnx"
            _write(network_for(category).eval(), category, untrained)
            return _timed(KnownAnswers(untrained, source, threads=threads), source, threads)

    label = SHIPPED if shipped else KNOWN
    about = {"category": name, "parts": len(category_named(name).parts), "network": label}
    return about | _step(kept, f"latency {name}, {label}", work)


def _of_shape(folder: Path, frames: int, threads: int, *, num_points: int, image_size: int) -> dict[str, Any]:
    """Of a bundle of the kept weights for so many points and pictures of that size."""
    weights, source = WEIGHTS / f"{SWEPT}.pt", _recording(SWEPT, frames)

    def work() -> dict[str, Any]:
        trained = load_trained(weights)
        fusion = trained.config["fusion"]
        network = PageNetwork(keypoints_of(trained.category), trained.category.num_voted, fusion, image_size)
        network.load_state_dict(trained.network.state_dict())
        with tempfile.TemporaryDirectory() as place:
            path = Path(place) / f"{SWEPT}.onnx"
            _write(network.eval(), with_templates(trained.category), path, num_points)
            loaded = Network(path, threads=threads)
            found = _timed(loaded, source, threads)
            return found | {"errors": pooled_errors(loaded, source, {"max_looks": 1})}

    name = f"latency N {num_points} S {image_size}"
    about = {"num_points": num_points, "image_size": image_size}
    return about | _step(_cache(folder, threads, source, weights), name, work)


def _write(network: PageNetwork, category: Category, path: Path, num_points: int = 2048) -> None:
    write_bundle(
        graph_of(network, num_points),
        category,
        path,
        mirrored=False,
        provenance={"note": "for a measurement of latency"},
        num_points=num_points,
        image_size=network.image_size,
    )


def _timed(network: Network, source: Source, threads: int) -> dict[str, Any]:
    before = load_average()
    times = report(
        time_windows(network, source, max_looks=1, counters=(), min_measurements=2 * len(source)), threads=threads
    )
    kept = ("stages", "total", "deadlines", "stability", "measurements")
    return {name: times[name] for name in kept} | {"load": [before, load_average()]}


def _recording(category: str, frames: int) -> Source:
    return open_source(procedural_recording(category, "validation", frames))


def _cache(folder: Path, threads: int, source: Source, file: Path | None) -> Cache:
    digest = hashlib.sha256(f"{own_code_sha256()} {threads} {sha256_of(source.path)}".encode())
    digest.update(b"" if file is None else sha256_of(file).encode())
    return Cache(folder / "steps", digest.hexdigest()[:16])


def _step(cache: Cache, name: str, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    kept = cache.load(name)
    print(f"latency_sweeps: {name}{': kept' if kept is not None else ''}", file=sys.stderr, flush=True)
    if kept is None:
        kept = work()
        cache.keep(name, kept)
    return kept
