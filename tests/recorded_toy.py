"""Thirty frames that differ in every way a container could lose, and every container they can be put into."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import toy
from page_runtime.camera import Camera
from page_runtime.capture.conversion import frame_writer
from page_runtime.capture.mcap_file import McapFile
from page_runtime.frame import RgbdFrame
from page_runtime.recorded import RecordedFrame

# Of processes that record: they import these helpers.
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]),
    "OMP_NUM_THREADS": "1",
}
FRAMES = 30
BEGIN_S = 1_700_000_000.123456
SKEW_S = 0.004
# Exact in the float32 in which depthai keeps K, so that its recordings can give the same poses to the last bit too.
OFF_CENTRE = np.array([[0, 0, 0.25], [0, 0, -0.75], [0, 0, 0]])


def frames(count: int = FRAMES, *, unit_mm: float = 1.0) -> list[RecordedFrame]:
    """The toy, its colour and depth disturbed differently in every frame; depth is whole units of unit_mm."""
    recorded, _ = toy.toy_frame(Camera(toy.toy_camera(160, 120).K + OFF_CENTRE, 160, 120))
    rng = np.random.default_rng(0)
    found = []
    for index in range(count):
        color = (recorded.frame.color + rng.integers(0, 30, recorded.frame.color.shape)).astype(np.uint8)
        units = np.rint(recorded.frame.depth_m / (unit_mm * 1e-3)) + rng.integers(0, 3, recorded.frame.depth_m.shape)
        units[rng.random(units.shape) < 0.1] = 0
        depth_m = (units * (unit_mm * 1e-3)).astype(np.float32)
        timestamp_s = BEGIN_S + index / 30 + rng.uniform(0, 1e-3)
        frame = RgbdFrame(color, depth_m, recorded.frame.camera, timestamp_s, index)
        found.append(RecordedFrame(frame, recorded.instances))
    return found


def endless() -> Iterator[RecordedFrame]:
    """The same pixels over and over, while time and number go on."""
    one_round = frames()
    for index in itertools.count():
        recorded = one_round[index % FRAMES]
        timestamp_s = recorded.frame.timestamp_s + index // FRAMES * FRAMES / 30
        yield replace(recorded, frame=replace(recorded.frame, timestamp_s=timestamp_s, index=index))


def skewed(recorded: list[RecordedFrame]) -> list[RecordedFrame]:
    """The same with depth SKEW_S later than colour."""
    return [replace(item, frame=replace(item.frame, skew_s=SKEW_S)) for item in recorded]


def writer_of(layout: str, name: str) -> Callable[[Path, list[RecordedFrame]], Path]:
    """A function that writes frames in a layout of `conversion` and returns where."""

    def write(folder: Path, recorded: list[RecordedFrame]) -> Path:
        parts = tuple(truth.name for truth in recorded[0].instances[0].truths or ())
        with frame_writer(folder / name, layout, category="box", part_names=parts) as writer:
            for item in recorded:
                writer.write(item)
        return folder / name

    return write


def write_bop(folder: Path, recorded: list[RecordedFrame]) -> Path:
    """A recording without what makes it one; the times go where a BOP scene may have them."""
    path = writer_of("recording", "scene")(folder, recorded)
    (path / "recording.json").unlink()
    cameras = json.loads((path / "scene_camera.json").read_text())
    for item in recorded:
        cameras[str(item.frame.index)]["timestamp_s"] = item.frame.timestamp_s
    (path / "scene_camera.json").write_text(json.dumps(cameras))
    return path


def write_depthai(folder: Path, recorded: list[RecordedFrame]) -> Path:
    """Both streams by depthai's own RecordMetadataOnly nodes, in a pipeline without a device.

    Its nodes write when they get to it, and what they have not written when the pipeline stops is lost.
    """
    path = folder / "depthai"
    for patience_s in (0.3, 3.0, 15.0):
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir()
        _record_by_depthai(path, recorded, patience_s)
        if all(len(McapFile(file).messages) == len(recorded) for file in path.iterdir()):
            return path
    raise AssertionError("depthai did not write what it was sent")


def _record_by_depthai(path: Path, recorded: list[RecordedFrame], patience_s: float) -> None:
    import depthai as dai

    import host_pipelines

    with dai.Pipeline(createImplicitDevice=False) as pipeline:
        source = pipeline.create(host_pipelines.Player)
        source.frames = [item.frame for item in recorded]
        for name, output in (("color", source.color), ("depth", source.depth)):
            node = pipeline.create(dai.node.RecordMetadataOnly)
            node.setRecordFile(path / f"{name}.mcap")
            output.link(node.input)
        pipeline.start()
        source.wait_until_sent()
        time.sleep(patience_s)


LOSSLESS: dict[str, Callable[[Path, list[RecordedFrame]], Path]] = {
    "page-edge recording": writer_of("recording", "recording"),
    "BOP scene folder": write_bop,
    "TUM RGB-D sequence": writer_of("tum", "tum"),
    "folder of colour and depth pictures": writer_of("pictures", "pictures"),
    "colour video and depth pictures": writer_of("video", "video"),
    "MCAP": writer_of("mcap", "file.mcap"),
    "ROS 2 bag of MCAP": writer_of("ros2-mcap", "bag-mcap"),
    "ROS 2 bag of sqlite3": writer_of("ros2-sqlite3", "bag-sqlite3"),
    "depthai recording": write_depthai,
}
