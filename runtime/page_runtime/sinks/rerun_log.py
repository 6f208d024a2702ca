"""Results in Rerun: an .rrd file, or its viewer as they come. The only importer of rerun (extra `view`).

Everything 3-D is in the camera frame: the root is the camera, OpenCV axes, metres. Entities:

    picture                 the colour, and the camera it was seen by
    points                  the depth readings, coloured, thinned to MAX_POINTS
    objects/N/PART          the part's frame with its axes; /box its box, /keypoints its keypoints
    plots/...               latency_ms, stage_ms/STAGE, confidence/N/PART, joints/N/JOINT (degrees or millimetres),
                            votes/N/PART (share of the voters at the highest peak of each keypoint)
    log                     reasons, and changes of the loop's state
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from page_runtime.image_files import SourceError
from page_runtime.live.result import LiveObject, LiveResult
from page_runtime.overlay import PART_COLORS
from page_runtime.pose import ArticulatedPose, NotSeen

if TYPE_CHECKING:
    import rerun as rr

APPLICATION = "page-edge"
# Of itself the viewer would listen to the whole network.
LOOPBACK = "127.0.0.1"
MAX_POINTS = 20_000
JPEG_QUALITY = 85
PIPE_BYTES = 1 << 16
FLUSH_S = 0.5
START_S = 10.0
DEGREES, MILLIMETRES = 180.0 / np.pi, 1e3


def require_rerun() -> None:
    """SourceError where Rerun is not installed; takes no time, unlike importing it."""
    if importlib.util.find_spec("rerun") is None:
        raise SourceError("Rerun is not installed; pip install 'page-edge[view]'")


class _RerunSink:
    """What file and viewer have in common: the entities of a result."""

    def __init__(self, name: str) -> None:
        require_rerun()
        # Rerun warns of the missing footer at each start; it is meant.
        os.environ.setdefault("RUST_LOG", "warn,re_log_encoding=error")
        import rerun

        self._rr = rerun
        self._name = name
        self._recording: rr.RecordingStream = rerun.RecordingStream(APPLICATION)
        self._shown: set[str] = set()
        self._said = ""

    @property
    def name(self) -> str:
        return self._name

    def _begin(self) -> None:
        """What holds for all results; once the recording has somewhere to go."""
        rr = self._rr
        self._recording.send_blueprint(_blueprint())
        self._recording.log("/", rr.ViewCoordinates.RDF, static=True)

    def _log(self, result: LiveResult) -> None:
        recording = self._recording
        recording.set_time("frame", sequence=result.frame.index)
        recording.set_time("camera_time", duration=result.frame.timestamp_s)
        self._log_frame(result)
        shown: set[str] = set()
        for found in result.objects:
            shown |= self._log_object(found)
        for path in self._shown - shown:
            recording.log(path, self._rr.Clear(recursive=True))
        self._shown = shown
        self._log_values(result)

    def _log_frame(self, result: LiveResult) -> None:
        rr, frame = self._rr, result.frame
        camera = frame.camera
        pinhole = rr.Pinhole(image_from_camera=camera.K, resolution=[camera.width, camera.height])
        self._recording.log("picture", pinhole, rr.Image(frame.color).compress(jpeg_quality=JPEG_QUALITY))
        step = max(1, round(np.sqrt(frame.depth_m.size / MAX_POINTS)))
        depth_m = frame.depth_m[::step, ::step]
        rows, columns = np.nonzero(depth_m)
        pixels = np.stack([columns, rows], axis=-1) * float(step)
        points_camera = camera.backproject(pixels, depth_m[rows, columns])
        colors = frame.color[::step, ::step][rows, columns]
        self._recording.log("points", rr.Points3D(points_camera, colors=colors))

    def _log_object(self, found: LiveObject) -> set[str]:
        """The parts that have a pose; returns their paths."""
        rr, shown = self._rr, set()
        for k, part in enumerate(found.pose.parts):
            if isinstance(part, NotSeen):
                continue
            path, color = f"objects/{found.number}/{_entity(part.name)}", PART_COLORS[k % len(PART_COLORS)]
            T_camera_part = np.asarray(part.T_camera_part)
            self._recording.log(
                path,
                rr.Transform3D(translation=T_camera_part[:3, 3], mat3x3=T_camera_part[:3, :3]),
                rr.TransformAxes3D(float(np.linalg.norm(part.extents_m)) / 4),
            )
            label = f"{part.name} {part.confidence:.2f}"
            box = rr.Boxes3D(half_sizes=[np.asarray(part.extents_m) / 2], colors=[color], labels=[label])
            self._recording.log(f"{path}/box", box)
            keypoints_part = (np.asarray(part.keypoints_camera) - T_camera_part[:3, 3]) @ T_camera_part[:3, :3]
            radius_m = float(np.linalg.norm(part.extents_m)) / 60
            self._recording.log(f"{path}/keypoints", rr.Points3D(keypoints_part, colors=[color], radii=[radius_m]))
            shown.add(path)
        return shown

    def _log_values(self, result: LiveResult) -> None:
        self._plot("latency_ms", result.latency_ms)
        for stage, value_ms in result.stage_ms.items():
            self._plot(f"stage_ms/{_entity(stage)}", value_ms)
        for found in result.objects:
            self._plot_object(found.number, found.pose)
        reasons = [result.reason] + [
            f"object {found.number}, {part.name}: {part.reason}"
            for found in result.objects
            for part in found.pose.parts
            if isinstance(part, NotSeen)
        ]
        said = "; ".join([result.state, *filter(None, reasons)])
        if said != self._said:
            self._recording.log("log", self._rr.TextLog(said, level="WARN" if any(reasons) else "INFO"))
            self._said = said

    def _plot_object(self, number: int, pose: ArticulatedPose) -> None:
        for part in pose.parts:
            path = f"{number}/{_entity(part.name)}"
            self._plot(f"confidence/{path}", 0.0 if isinstance(part, NotSeen) else part.confidence)
            if not isinstance(part, NotSeen):
                self._plot(f"votes/{path}", np.asarray(part.scores))
        for joint in pose.joints:
            if joint.value is not None:
                scale = MILLIMETRES if joint.unit == "m" else DEGREES
                self._plot(f"joints/{number}/{_entity(joint.name)}", joint.value * scale)

    def _plot(self, path: str, values: Any) -> None:
        self._recording.log(f"plots/{path}", self._rr.Scalars(values))


def _entity(name: str) -> str:
    return name.replace(" ", "_")


def _blueprint() -> Any:
    """Space and picture above, curves below."""
    import rerun.blueprint as rrb

    curves = {"latency_ms": "latency, ms", "confidence": "confidence", "joints": "joints, deg or mm", "votes": "votes"}
    plots = [rrb.TimeSeriesView(origin=f"plots/{path}", name=name) for path, name in curves.items()]
    space = rrb.Spatial3DView(origin="/", contents=["+ /objects/**", "+ /points"], name="camera frame")
    picture = rrb.Spatial2DView(origin="picture", contents=["+ /picture", "+ /objects/**"], name="picture")
    stages = rrb.TimeSeriesView(origin="plots/stage_ms", name="stages, ms")
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(space, picture), rrb.Horizontal(*plots, stages), row_shares=[2, 1]),
        collapse_panels=True,
    )


class RrdSink(_RerunSink):
    """Into the new file `path`.

    Rerun writes into a pipe and this class from there into the file: where the disk takes no more, Rerun's own writer
    waits for ever, and says nothing.
    """

    def __init__(self, path: Path) -> None:
        """FileExistsError when the file is there already, SourceError without the extra `view`."""
        super().__init__(f"rrd {path}")
        self._file = path.open("xb", buffering=0)
        reading, writing = os.pipe()
        self._failure: OSError | None = None
        self._copier = threading.Thread(target=self._copy, args=(reading,), name=f"copy {self._name}", daemon=True)
        self._copier.start()
        # A footer lists every chunk, and the list waits in memory: 70 kB a result.
        self._recording.save(f"/dev/fd/{writing}", write_footer=False)
        os.close(writing)
        self._begin()

    def _copy(self, reading: int) -> None:
        while data := os.read(reading, PIPE_BYTES):
            try:
                while data and self._failure is None:
                    data = data[self._file.write(data) :]
            except OSError as error:
                # The pipe is read on, or Rerun would wait; what comes after a gap would not be understood.
                self._failure = error
        os.close(reading)

    def write(self, result: LiveResult) -> None:
        """Log one result; OSError when the file takes no more, then and from then on."""
        self._require_whole()
        self._log(result)
        self._recording.flush(timeout_sec=FLUSH_S)
        self._require_whole()

    def _require_whole(self) -> None:
        if self._failure is not None:
            raise OSError(self._failure.errno, f"{self._failure.strerror}; the file ends there", self._file.name)

    def close(self) -> None:
        """Write what is still to be written and close the file; OSError when that did not go well."""
        is_new_failure = self._failure is None
        self._recording.disconnect()
        self._copier.join(FLUSH_S)
        if self._copier.is_alive():
            raise OSError(f"{self._file.name}: not written to its end within {FLUSH_S:g} s")
        self._file.close()
        if is_new_failure:
            self._require_whole()


class RerunViewer(_RerunSink):
    """Into a viewer of its own, which is started here and stays open afterwards."""

    def __init__(self, *, executable: Path | None = None, arguments: tuple[str, ...] = ()) -> None:
        """SourceError without the extra `view`, and when the viewer does not start, as where there is no display.

        executable: rerun's, by default the one beside Python or in PATH. arguments: more of its own.
        """
        super().__init__("rerun viewer")
        beside = Path(sys.executable).parent / "rerun"
        found = executable or (beside if beside.exists() else shutil.which("rerun"))
        if found is None:
            raise SourceError("the Rerun viewer: no program `rerun` beside Python or in PATH; reinstall rerun-sdk")
        port = _free_port()
        # A session of its own: Ctrl-C ends the loop, and the viewer stays to be looked at.
        self._viewer = subprocess.Popen(
            [str(found), "--bind", LOOPBACK, "--port", str(port), *arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._wait_for(port)
        self._recording.connect_grpc(f"rerun+http://{LOOPBACK}:{port}/proxy")
        self._begin()

    @property
    def process(self) -> int:
        """The viewer's process."""
        return self._viewer.pid

    def _wait_for(self, port: int) -> None:
        deadline_s = time.monotonic() + START_S
        while self._viewer.poll() is None and time.monotonic() < deadline_s:
            with contextlib.suppress(OSError), socket.create_connection((LOOPBACK, port), timeout=1.0):
                return
            time.sleep(0.05)
        self._viewer.kill()
        raise SourceError(
            f"the Rerun viewer did not start (exit code {self._viewer.wait()}); it needs a display: --rrd FILE writes "
            "what can be looked at elsewhere, --web PORT a page for any browser"
        )

    def write(self, result: LiveResult) -> None:
        """Log one result; OSError when the viewer was closed."""
        if self._viewer.poll() is not None:
            raise OSError("the viewer was closed")
        self._log(result)

    def close(self) -> None:
        """Hand over what is still to be shown."""
        self._recording.flush(timeout_sec=FLUSH_S)
        self._recording.disconnect()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
