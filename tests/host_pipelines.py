"""depthai pipelines without a device: own source nodes, the nodes of the library, and `oak.paired_frames`."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any

import depthai as dai
import numpy as np

from page_runtime.capture.frame_service import LiveFrame
from page_runtime.capture.oak import paired_frames
from page_runtime.frame import RgbdFrame

WIDTH, HEIGHT, FPS = 64, 48, 30.0
K = [[60.0, 0.0, 31.5], [0.0, 60.0, 23.5], [0.0, 0.0, 1.0]]
CALIBRATION = '{"boardName": "a pipeline without a device"}'


def transformation(width: int, height: int, K: list[list[float]]) -> dai.ImgTransformation:
    extrinsics = dai.Extrinsics()
    extrinsics.rotationMatrix = np.eye(3).tolist()
    extrinsics.translation = dai.Point3f(0, 0, 0)
    extrinsics.toCameraSocket = dai.CameraBoardSocket.CAM_A
    extrinsics.lengthUnit = dai.LengthUnit.CENTIMETER
    return dai.ImgTransformation(width, height, K, dai.CameraModel.Perspective, [0.0] * 14, extrinsics)


def color_pixels(number: int, *, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """(H,W,3) uint8 RGB that no two numbers and no two channels share."""
    pixels = np.zeros((height, width, 3), np.uint8)
    pixels[...] = number % 251, (number + 50) % 251, (number + 100) % 251
    pixels[0, :, 0] = np.arange(width) % 256
    return pixels


def image(
    pixels: np.ndarray, kind: dai.ImgFrame.Type, number: int, time_s: float, *, K: list[list[float]] = K
) -> dai.ImgFrame:
    message = dai.ImgFrame()
    if kind == dai.ImgFrame.Type.RGB888i:
        message.setType(kind)
        message.setWidth(pixels.shape[1])
        message.setHeight(pixels.shape[0])
        message.setData(pixels.tobytes())
    else:
        message.setCvFrame(pixels, kind)
    message.setSequenceNum(number)
    stamp = timedelta(seconds=time_s)
    message.setTimestamp(stamp)
    message.setTimestampDevice(stamp)
    message.setTransformation(transformation(pixels.shape[1], pixels.shape[0], K))
    return message


class TwoStreams(dai.node.ThreadedHostNode):
    """Colour and depth by a script: for each number, whether to send colour, depth (with a skew), or something else."""

    def __init__(self) -> None:
        super().__init__()
        self.color, self.depth = self.createOutput(), self.createOutput()
        self.script: dict[str, Any] = {}

    def run(self) -> None:
        script = self.script
        begin_s, number = time.monotonic(), 0
        while self.isRunning() and number < script.get("frames", 10**9):
            time_s = begin_s + number / FPS
            if number == script.get("raise_at"):
                raise RuntimeError("an exception in a host node")
            if number == script.get("signal_at"):
                os.kill(os.getpid(), script["signal"])
            if number % script.get("color_every", 1) == 0:
                kind = dai.ImgFrame.Type.BGR888i if script.get("bgr") else dai.ImgFrame.Type.RGB888i
                pixels = color_pixels(number)
                self.color.send(image(pixels[..., ::-1] if script.get("bgr") else pixels, kind, number, time_s))
            if number % script.get("depth_every", 1) == 0:
                shape = script.get("depth_shape", (HEIGHT, WIDTH))
                units = np.full(shape, 1000 + number, np.uint16)
                skew_s = script.get("skew_s", 0.0)
                self.depth.send(image(units, dai.ImgFrame.Type.RAW16, number, time_s + skew_s))
            number += 1
            if number == script.get("silent_at"):
                return
            time.sleep(script.get("sleep_s", 1 / FPS))
        if script.get("stops"):
            time.sleep(0.1)
            self.stopPipeline()


def host_frames(stopping: threading.Event, *, script: dict[str, Any], folder: str | None = None) -> Iterator[LiveFrame]:
    """What `oak_frames` does, with TwoStreams for a camera. With a folder, only the first start misbehaves."""
    if folder is not None:
        starts = len(list(Path(folder).iterdir()))
        (Path(folder) / str(starts)).touch()
        signals = script.get("signals", (None,))
        if starts < len(signals):
            script = {**script, "signal": signals[starts]}
        else:
            script = {key: value for key, value in script.items() if key not in ("signal_at", "raise_at", "silent_at")}
    with dai.Pipeline(createImplicitDevice=False) as pipeline:
        source = pipeline.create(TwoStreams)
        source.script = script
        yield from paired_frames(
            pipeline, source.color, source.depth, stopping=stopping, calibration=CALIBRATION,
            window_s=script.get("window_s", 0.02),
        )  # fmt: skip


def synced_numbers(script: dict[str, Any], *, threshold_s: float, groups: int) -> list[tuple[int, int]]:
    """(colour, depth) numbers of the first groups that depthai's own Sync node makes of the same streams."""
    with dai.Pipeline(createImplicitDevice=False) as pipeline:
        source = pipeline.create(TwoStreams)
        source.script = script
        sync = pipeline.create(dai.node.Sync)
        sync.setRunOnHost(True)
        sync.setSyncThreshold(timedelta(seconds=threshold_s))
        source.color.link(sync.inputs["color"])
        source.depth.link(sync.inputs["depth"])
        queue = sync.out.createOutputQueue(100, True)
        pipeline.start()
        found = []
        for _ in range(groups):
            group: Any = queue.get()
            found.append((group["color"].getSequenceNum(), group["depth"].getSequenceNum()))
        return found


SIGNALS = (int(signal.SIGSEGV), int(signal.SIGABRT), int(signal.SIGKILL))


class Player(dai.node.ThreadedHostNode):
    """Given frames, as a camera's node would send them."""

    def __init__(self) -> None:
        super().__init__()
        self.color, self.depth = self.createOutput(), self.createOutput()
        self.frames: list[RgbdFrame] = []
        self._sent = threading.Event()

    def run(self) -> None:
        for frame in self.frames:
            for output, pixels, kind, time_s in (
                (self.color, frame.color, dai.ImgFrame.Type.RGB888i, frame.timestamp_s),
                (self.depth, np.rint(frame.depth_m * 1e3).astype(np.uint16), dai.ImgFrame.Type.RAW16,
                 frame.timestamp_s + frame.skew_s),
            ):  # fmt: skip
                output.send(image(pixels, kind, frame.index, time_s, K=frame.camera.K.tolist()))
            time.sleep(0.002)
        self._sent.set()

    def wait_until_sent(self) -> None:
        assert self._sent.wait(20)
