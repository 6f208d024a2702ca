"""OAK cameras: depth aligned to colour on the device, in a supervised child process. The only importer of depthai.

Everything that touches depthai runs in a child process (`child_process.py`): it aborts the process on any exception in
a host node, and its device search may do the same. Telemetry is off and the camera keeps its stored calibration, unless
the environment says otherwise (DEPTHAI_TELEMETRY, DEPTHAI_AUTOCALIBRATION).

The part that needs a device is `_device_pipeline`; it follows Luxonis' documentation of depthai 3 and was never run on
a camera. All else runs in the tests, on depthai pipelines without a device.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import partial
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any

import numpy as np

from page_runtime.camera import Camera
from page_runtime.capture.child_process import ChildEnd, ChildProcess, Task, pickled
from page_runtime.capture.events import SourceEvent
from page_runtime.capture.frame_service import DeviceUnavailable, LiveFrame
from page_runtime.capture.layouts import WINDOW_S
from page_runtime.capture.pairing import Pair, Pairing, Stream
from page_runtime.capture.supervision import SupervisedSource
from page_runtime.image_files import SourceError
from page_runtime.recorded import require_central

if TYPE_CHECKING:
    import depthai

NAME = "oak"
ENVIRONMENT = {"DEPTHAI_TELEMETRY": "0", "DEPTHAI_LEVEL": "error", "DEPTHAI_AUTOCALIBRATION": "OFF"}
METRES_PER_UNIT = 1e-3
QUEUE_SIZE = 4
SEARCH_TIMEOUT_S = 15.0
POLL = timedelta(milliseconds=100)
WHAT_TO_CHECK = (
    "is it plugged into a USB 3 port with a data cable and enough power (or, with Ethernet, in this network); is "
    "another program using it; on Linux, is there a udev rule for USB vendor 03e7; "
    "`page-runtime devices` searches again"
)


@dataclass(frozen=True, slots=True)
class OakDevice:
    """A camera that answered. device_id: what `oak:ID` names. name: its USB port or address."""

    device_id: str
    name: str
    platform: str
    protocol: str
    state: str


@dataclass(frozen=True, slots=True)
class OakSettings:
    """device: id, address or port; empty: any. width, height, fps: of colour and of the depth aligned to it. window_s:
    of the pairing."""

    device: str = ""
    width: int = 640
    height: int = 400
    fps: float = 30.0
    window_s: float = WINDOW_S


def is_oak(name: str) -> bool:
    """Whether `name` is "oak" or "oak:DEVICE"."""
    return name == NAME or name.startswith(f"{NAME}:")


def open_oak(
    name: str, *, window_s: float = WINDOW_S, on_event: Callable[[SourceEvent], None] = lambda _: None
) -> SupervisedSource:
    """The camera called "oak" or "oak:DEVICE" as a live source.

    Raises DeviceUnavailable when no camera answers, before anything is connected, and SourceError without depthai.
    """
    if not is_oak(name):
        raise ValueError(f"open_oak: expected 'oak' or 'oak:DEVICE', got {name!r}")
    settings = OakSettings(device=name.partition(":")[2], window_s=window_s)
    found = connected_devices()
    if not found:
        raise DeviceUnavailable(f"no OAK camera found; {WHAT_TO_CHECK}")
    if settings.device and not any(settings.device in (device.device_id, device.name) for device in found):
        known = ", ".join(f"oak:{device.device_id}" for device in found)
        raise DeviceUnavailable(f"no OAK camera {settings.device!r} found, but {known}; {WHAT_TO_CHECK}")
    factory = partial(oak_frames, settings=settings)
    return SupervisedSource(factory, name=name, format="OAK camera", environment=ENVIRONMENT, on_event=on_event)


def connected_devices() -> tuple[OakDevice, ...]:
    """The OAK cameras that answer a search of USB and the local network, which takes half a second."""
    found = _ask_child(_report_devices, timeout_s=SEARCH_TIMEOUT_S)
    return tuple(OakDevice(**device) for device in found)


def _ask_child(task: Task, *, timeout_s: float) -> Any:
    """What `task` sends first, from a child process."""
    if importlib.util.find_spec("depthai") is None:
        raise SourceError("OAK cameras need depthai, which is not installed; pip install 'page-edge[oak]'")
    child = ChildProcess(pickled(task), environment=ENVIRONMENT)
    try:
        if not wait([child.messages], timeout=timeout_s):
            raise DeviceUnavailable(f"the search for OAK cameras took more than {timeout_s:g} s; {WHAT_TO_CHECK}")
        return child.messages.recv()
    except EOFError:
        child.kill()
        raise DeviceUnavailable(f"the search for OAK cameras failed: {child.manner_of_death()}") from None
    finally:
        child.stop(patience_s=0.5)


def _report_devices(end: ChildEnd) -> None:
    import depthai

    end.send([
        {
            "device_id": info.getDeviceId(),
            "name": info.name,
            "platform": info.platform.name.removeprefix("X_LINK_"),
            "protocol": info.protocol.name.removeprefix("X_LINK_"),
            "state": info.state.name.removeprefix("X_LINK_"),
        }
        for info in depthai.Device.getAllAvailableDevices()
    ])  # fmt: skip


def oak_frames(stopping: threading.Event, *, settings: OakSettings) -> Iterator[LiveFrame]:
    """Frames of a camera; runs in the child."""
    import depthai

    available = depthai.Device.getAllAvailableDevices()
    wanted = [d for d in available if settings.device in ("", d.getDeviceId(), d.name)]
    if not wanted:
        raise DeviceUnavailable(f"no OAK camera found; {WHAT_TO_CHECK}")
    device = depthai.Device(wanted[0])
    with device, depthai.Pipeline(device) as pipeline:
        pipeline.setAutoCalibrationMode(depthai.Pipeline.AutoCalibrationMode.OFF)
        calibration = json.dumps(device.readCalibration().eepromToJson())
        color, depth = _device_pipeline(depthai, pipeline, settings)
        yield from paired_frames(
            pipeline, color, depth, stopping=stopping, window_s=settings.window_s, calibration=calibration
        )


def _device_pipeline(dai: Any, pipeline: depthai.Pipeline, settings: OakSettings) -> tuple[Any, Any]:
    """Outputs of undistorted colour, and of depth in millimetres aligned to it.

    RVC2 aligns while it computes depth; RVC4 has a node for it.
    """
    size = settings.width, settings.height
    camera = pipeline.create(dai.node.Camera).build(dai.CameraBoardSocket.CAM_A)
    color = camera.requestOutput(size, type=dai.ImgFrame.Type.RGB888i, fps=settings.fps, enableUndistortion=True)
    left, right = (
        pipeline.create(dai.node.Camera).build(socket).requestOutput((640, 400), fps=settings.fps)
        for socket in (dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C)
    )
    stereo = pipeline.create(dai.node.StereoDepth).build(left, right, dai.node.StereoDepth.PresetMode.ROBOTICS)
    stereo.initialConfig.algorithmControl.depthUnit = dai.StereoDepthConfig.AlgorithmControl.DepthUnit.MILLIMETER
    if pipeline.getDefaultDevice().getPlatform() == dai.Platform.RVC4:
        align = pipeline.create(dai.node.ImageAlign)
        stereo.depth.link(align.input)
        color.link(align.inputAlignTo)
        return color, align.outputAligned
    color.link(stereo.inputAlignTo)
    stereo.setOutputSize(*size)
    return color, stereo.depth


def paired_frames(
    pipeline: depthai.Pipeline,
    color: Any,
    depth: Any,
    *,
    stopping: threading.Event,
    window_s: float = WINDOW_S,
    calibration: str | None = None,
) -> Iterator[LiveFrame]:
    """Start `pipeline` and pair the ImgFrames of its outputs `color` and `depth` until it or the parent stops.

    Pairs by the device's clock and stamps frames by the host's, to which the device is synchronised and which goes on
    when the device starts anew.
    """
    pairing: Pairing[Any] = Pairing(window_s=window_s)
    queues: dict[Stream, Any] = {
        "color": color.createOutputQueue(QUEUE_SIZE, False),
        "depth": depth.createOutputQueue(QUEUE_SIZE, False),
    }
    numbers = _Numbers()
    pipeline.start()
    while not stopping.is_set():
        running = pipeline.isRunning()
        for stream, message in _received(queues):
            numbers.see(stream, message.getSequenceNum())
            for pair in pairing.push(stream, message.getTimestampDevice().total_seconds(), message):
                counts = replace(pairing.counts, missed=numbers.missed)
                yield replace(_live_frame(pair), counts=counts, calibration=calibration)
                calibration = None
        if not running:
            pairing.finish()
            return


class _Numbers:
    """Gaps in the messages' numbers, by stream."""

    def __init__(self) -> None:
        self._last: dict[Stream, int] = {}
        self._missed: Counter[str] = Counter()

    def see(self, stream: Stream, number: int) -> None:
        gap = number - self._last.get(stream, number - 1) - 1
        if gap > 0:
            self._missed[f"{stream} readings the camera did not deliver"] += gap
        self._last[stream] = number

    @property
    def missed(self) -> dict[str, int]:
        return dict(self._missed)


def _received(queues: dict[Stream, Any]) -> list[tuple[Stream, Any]]:
    """What has come in all queues, after a wait for the first; empty when nothing has, or the pipeline is closing."""
    import depthai

    depthai.MessageQueue.waitAny(list(queues.values()), POLL)
    found: list[tuple[Stream, Any]] = []
    for stream, queue in queues.items():
        # Queues close when a pipeline stops, with what they still hold.
        with contextlib.suppress(depthai.MessageQueue.QueueException):
            for message in queue.tryGetAll():
                found.append((stream, message))
    if not found:
        time.sleep(1e-3)
    return found


def _live_frame(pair: Pair[Any]) -> LiveFrame:
    """The frame of two ImgFrames; SourceError when their pictures do not belong together."""
    import depthai

    color, depth = pair.color, pair.depth
    is_rgb = color.getType() == depthai.ImgFrame.Type.RGB888i
    pixels = color.getFrame() if is_rgb else color.getCvFrame()[..., ::-1]
    units = depth.getFrame()
    height, width = pixels.shape[:2]
    if units.dtype != np.uint16 or units.shape != (height, width):
        raise SourceError(
            f"OAK camera: expected 16-bit depth aligned to colour, {width}x{height}, got {units.dtype} of "
            f"{units.shape[1]}x{units.shape[0]}; align it on the device"
        )
    camera = _camera(color.getTransformation(), width, height)
    timestamp_s = color.getTimestamp().total_seconds()
    return LiveFrame(pixels, units, METRES_PER_UNIT, camera, timestamp_s, pair.skew_s)


def _camera(transformation: depthai.ImgTransformation, width: int, height: int) -> Camera:
    """The camera of a delivered picture. Its own transformation says K at this size, crop and undistortion included;
    CalibrationHandler.getCameraIntrinsics is 35 px wrong for some sizes (depthai 3.12)."""
    try:
        camera = Camera(np.array(transformation.getIntrinsicMatrix()), width, height)
    except ValueError as error:
        raise SourceError(f"OAK camera: its pictures carry no intrinsics ({error}); calibrate it first") from error
    require_central(camera, where="OAK camera")
    return camera
