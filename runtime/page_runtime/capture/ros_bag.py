"""ROS 2 bags, sqlite3 and MCAP, with or without metadata.yaml, whole or damaged.

Played are one colour topic (Image or CompressedImage), one of depth registered to it, and the colour's CameraInfo. A
bag is read once from end to end when it is opened: readings are paired by their header's stamps, and what cannot be
read is counted. Pixels are read when a frame is asked for. sqlite3 is read by rosbags; it has no checksums, nor has
MCAP that rosbags wrote, so there a changed byte inside a picture cannot be noticed.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from page_runtime.camera import Camera
from page_runtime.capture import ros_messages as ros
from page_runtime.capture.mcap_file import Channel, MessageRef
from page_runtime.capture.mcap_recording import CALIBRATION_FILE
from page_runtime.capture.pairing import Pair, Stream, pair_recorded
from page_runtime.capture.undistortion import lens_of, undistorted
from page_runtime.image_files import SourceError
from page_runtime.lens import NO_DISTORTION, Distortion
from page_runtime.recorded import FrameEntry, Instance, Pixels, Source, require_central, require_playable

FORMAT = "ROS 2 bag"
SUFFIXES = (".mcap", ".db3")
NO_CAMERA = "frames of a changing camera without its camera_info"
AFTER_DAMAGE = "messages after a damaged page of the database"
# Among several depth topics, the one that says it is registered to colour.
REGISTERED_WORDS = ("aligned_depth", "depth_registered", "depth_to_color", "registered")


class MessageStore(Protocol):
    """A file of messages."""

    @property
    def channels(self) -> tuple[Channel, ...]: ...
    @property
    def messages(self) -> list[MessageRef]: ...
    @property
    def missed(self) -> dict[str, int]: ...
    @property
    def attachments(self) -> dict[str, bytes]: ...
    def read(self, ref: MessageRef) -> bytes: ...


class SqliteFile:
    """The messages of one sqlite3 file of a bag, through rosbags."""

    def __init__(self, path: Path) -> None:
        try:
            from rosbags.rosbag2 import Reader
        except ImportError as error:
            raise SourceError(ros.MISSING) from error
        self.path = path
        self.attachments: dict[str, bytes] = {}
        self.missed: dict[str, int] = {}
        self.messages: list[MessageRef] = []
        self._cached: tuple[MessageRef, bytes] | None = None
        seen: Counter[tuple[str, int]] = Counter()
        expected = 0
        try:
            self._reader = Reader(path)
            self._reader.open()
            self._connections = {connection.topic: connection for connection in self._reader.connections}
            self.channels = tuple(Channel(c.topic, c.msgtype, "cdr") for c in self._reader.connections)
            expected = self._reader.message_count
            for connection, time_ns, data in self._reader.messages(list(self._connections.values())):
                number = seen[connection.topic, time_ns]
                seen[connection.topic, time_ns] += 1
                head = bytes(data[:16])
                self.messages.append(MessageRef(connection.topic, time_ns, 0, number, head))
        except Exception as error:
            # rosbags' errors, apsw's, and what damaged bytes lead to in either.
            if not self.messages:
                raise SourceError(f"{path}: not a bag that can be read ({type(error).__name__}: {error})") from error
            self.missed = {AFTER_DAMAGE: max(1, expected - len(self.messages))}

    def read(self, ref: MessageRef) -> bytes:
        """The body of one message."""
        connection = self._connections[ref.topic]
        try:
            found = self._reader.messages([connection], ref.log_time_ns, ref.log_time_ns + 1)
            return next(data for number, (_, _, data) in enumerate(found) if number == ref.number)
        except Exception as error:
            raise SourceError(f"{self.path}: a message of {ref.topic} is damaged ({error})") from error


def bag_files(path: Path) -> list[Path]:
    """The storage files of a bag, which is one file or a folder of them; empty when it is none."""
    if path.is_file():
        return [path] if path.suffix.lower() in SUFFIXES else []
    return sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())


def read_stores(path: Path, stores: list[MessageStore], *, window_s: float) -> Source:
    """The messages of a bag's files as a source; SourceError says which topics it has when they are not the ones that
    are needed."""
    by_topic: dict[str, list[tuple[MessageStore, MessageRef]]] = defaultdict(list)
    for store in stores:
        for ref in store.messages:
            by_topic[ref.topic].append((store, ref))
    kinds = {channel.topic: channel.kind for store in stores for channel in store.channels}
    color, depth = _topics(path, kinds, by_topic)
    cameras = _cameras(path, color, kinds, by_topic)
    topic_streams: tuple[tuple[str, Stream], ...] = ((color, "color"), (depth, "depth"))
    in_order: list[tuple[MessageStore, MessageRef, Stream]] = sorted(
        ((store, ref, stream) for topic, stream in topic_streams for store, ref in by_topic[topic]),
        key=lambda item: item[1].log_time_ns,
    )
    readings: list[tuple[float, Stream, tuple[MessageStore, MessageRef]]] = []
    for store, ref, stream in in_order:
        readings.append((ros.stamp_ns(ref.head) * 1e-9, stream, (store, ref)))
    pairs, counts = pair_recorded(readings, window_s=window_s)
    missed: Counter[str] = Counter()
    for store in stores:
        missed.update(store.missed)
    facts = _facts(by_topic.get(ros.FACTS_TOPIC, []))
    entries: list[FrameEntry] = []
    for pair in pairs:
        stamp_ns = ros.stamp_ns(pair.color[1].head)
        found = cameras.at(stamp_ns)
        if found is None:
            missed[NO_CAMERA] += 1
            continue
        entries.append(_entry(path, pair, len(entries), *found, kinds, facts.get(stamp_ns)))
    calibration = _calibration(stores, by_topic.get(ros.CALIBRATION_TOPIC, []))
    known = next(iter(facts.values()), {})
    category, parts = known.get("category"), known.get("parts")
    return require_playable(
        Source(
            path,
            FORMAT,
            tuple(entries),
            category,
            tuple(parts) if category is not None and parts else None,
            replace(counts, missed=dict(missed)),
            calibration,
        )
    )


def _calibration(stores: list[MessageStore], messages: list[tuple[MessageStore, MessageRef]]) -> str | None:
    """What the camera says of itself: an attachment in MCAP, a message in bags."""
    for store in stores:
        if CALIBRATION_FILE in store.attachments:
            return store.attachments[CALIBRATION_FILE].decode("utf-8", "replace")
    return _first(messages, ros.STRING).data if messages else None


def _topics(path: Path, kinds: dict[str, str], by_topic: dict[str, Any]) -> tuple[str, str]:
    """The colour and the depth topic."""
    color, depth = [], []
    for topic in sorted(by_topic):
        if kinds[topic] in (ros.IMAGE, ros.COMPRESSED):
            message = _first(by_topic[topic], kinds[topic])
            if message is not None:
                (depth if ros.is_depth(message) else color).append(topic)
    if len(depth) > 1:
        depth = [t for word in REGISTERED_WORDS for t in depth if word in t][:1] or depth
    if len(color) > 1:
        color = [t for t in color if "color" in t or "rgb" in t] or color
        color = [t for t in color if kinds[t] == ros.IMAGE] or color
    if len(color) != 1 or len(depth) != 1:
        listed = ", ".join(f"{topic} ({kinds[topic]})" for topic in sorted(kinds)) or "no topics"
        raise SourceError(
            f"{path}: expected one colour and one depth topic (16UC1 or 32FC1, registered to colour), found "
            f"{len(color)} and {len(depth)}; the bag has {listed}"
        )
    return color[0], depth[0]


def _first(messages: list[tuple[MessageStore, MessageRef]], kind: str) -> Any:
    """The first message of a topic that can be decoded."""
    for store, ref in messages[:10]:
        try:
            return ros.decode(store.read(ref), kind, where=ref.topic)
        except SourceError:
            continue
    return None


@dataclass(frozen=True, eq=False, slots=True)
class _Cameras:
    """What CameraInfo said, by its stamp; several: whether it did not always say the same."""

    by_stamp_ns: dict[int, tuple[Camera, Distortion]]
    several: bool

    def at(self, stamp_ns: int) -> tuple[Camera, Distortion] | None:
        """The camera of a colour picture: of a camera that changes only what was said with that very picture."""
        if self.several:
            return self.by_stamp_ns.get(stamp_ns)
        return next(iter(self.by_stamp_ns.values()))


def _cameras(
    path: Path, color: str, kinds: dict[str, str], by_topic: dict[str, list[tuple[MessageStore, MessageRef]]]
) -> _Cameras:
    """The colour camera by the CameraInfo beside the colour topic; damaged messages of it are left out."""
    namespace = color.removesuffix("/compressed").rsplit("/", 1)[0]
    wanted = f"{namespace}/camera_info"
    infos = [topic for topic, kind in kinds.items() if kind == ros.INFO and by_topic.get(topic)]
    if wanted not in infos and len(infos) != 1:
        found = ", ".join(infos) or "none"
        raise SourceError(f"{path}: expected {wanted} for {color}, found {found}; record the colour's camera_info too")
    topic = wanted if wanted in infos else infos[0]
    is_rectified = "rect" in color.rsplit("/", 1)[-1]
    by_stamp_ns, said = {}, {}
    for store, ref in by_topic[topic]:
        try:
            info = ros.decode(store.read(ref), ros.INFO, where=topic)
        except SourceError:
            continue
        what = (info.width, info.height, info.distortion_model, *map(float, (*info.k, *info.d, *info.p)))
        if what not in said:
            said[what] = _camera(info, is_rectified=is_rectified, where=f"{path}: {topic}")
        by_stamp_ns[ros.stamp_ns(ref.head)] = said[what]
    if not by_stamp_ns:
        raise SourceError(f"{path}: every message of {topic} is damaged")
    return _Cameras(by_stamp_ns, len(said) > 1)


def _camera(info: Any, *, is_rectified: bool, where: str) -> tuple[Camera, Distortion]:
    K = np.reshape(info.p, (3, 4))[:, :3] if is_rectified else np.reshape(info.k, (3, 3))
    try:
        camera = Camera(K.astype(float), int(info.width), int(info.height))
    except ValueError as error:
        raise SourceError(f"{where}: {error}") from error
    require_central(camera, where=where)
    if is_rectified or not len(info.d):
        return camera, NO_DISTORTION
    return camera, lens_of(info.distortion_model, info.d, where=where)


def _facts(messages: list[tuple[MessageStore, MessageRef]]) -> dict[int, dict[str, Any]]:
    """What the project's own recordings say of a frame, by the stamp of its colour."""
    found = {}
    for store, ref in messages:
        message = ros.decode(store.read(ref), ros.STRING, where=f"{ros.FACTS_TOPIC}")
        try:
            found[ref.log_time_ns] = json.loads(message.data)
        except ValueError as error:
            raise SourceError(f"{ros.FACTS_TOPIC}: expected JSON, got something else ({error})") from error
    return found


def _entry(
    path: Path,
    pair: Pair[tuple[MessageStore, MessageRef]],
    index: int,
    camera: Camera,
    distortion: Distortion,
    kinds: dict[str, str],
    facts: dict[str, Any] | None,
) -> FrameEntry:
    instances: tuple[Instance, ...] = ()
    timestamp_s, skew_s = pair.timestamp_s, pair.skew_s
    if facts is not None:
        try:
            instances = ros.instances_of(facts)
            index, timestamp_s, skew_s = int(facts["index"]), float(facts["timestamp_s"]), float(facts["skew_s"])
            camera = replace(camera, T_camera_world=np.array(facts["T_camera_world"]))
        except (KeyError, TypeError, ValueError) as error:
            raise SourceError(f"{path}: {ros.FACTS_TOPIC}: not understood ({error})") from error
    decode = partial(_decode, pair.color, pair.depth, camera, distortion, kinds, str(path))
    return FrameEntry(path, path, 0.0, camera, instances, timestamp_s, index, skew_s, decode)


def _decode(
    color: tuple[MessageStore, MessageRef],
    depth: tuple[MessageStore, MessageRef],
    camera: Camera,
    distortion: Distortion,
    kinds: dict[str, str],
    where: str,
) -> Pixels:
    color_message, depth_message = (
        ros.decode(store.read(ref), kinds[ref.topic], where=f"{where}: {ref.topic}") for store, ref in (color, depth)
    )
    pixels = ros.color_pixels(color_message, where=f"{where}: {color[1].topic}")
    depth_m = ros.depth_pixels(depth_message, where=f"{where}: {depth[1].topic}")
    if pixels.shape[:2] != (camera.height, camera.width) or depth_m.shape != pixels.shape[:2]:
        raise SourceError(
            f"{where}: colour is {pixels.shape[1]}x{pixels.shape[0]}, depth {depth_m.shape[1]}x{depth_m.shape[0]}, "
            f"CameraInfo {camera.width}x{camera.height}; record depth registered to colour (aligned_depth_to_color)"
        )
    return undistorted(pixels, depth_m, camera, distortion)
