"""ROS 2 bags, sqlite3 and MCAP, with or without metadata.yaml, whole or damaged.

Played are one colour topic (Image or CompressedImage), one of depth, and the colour's CameraInfo; depth of a camera
with a frame of its own is registered to colour on the way, by its CameraInfo and the transforms in the bag. A bag is
read once from end to end when it is opened: readings are paired by their header's stamps, and what cannot be read is
counted. Pixels are read when a frame is asked for. sqlite3 is read by rosbags; it has no checksums, nor has MCAP that
rosbags wrote, so there a changed byte inside a picture cannot be noticed.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from page_runtime.capture import ros_messages as ros
from page_runtime.capture.mcap_file import Channel, MessageRef
from page_runtime.capture.mcap_recording import CALIBRATION_FILE
from page_runtime.capture.pairing import Pair, Stream, pair_recorded
from page_runtime.capture.ros_cameras import Registering, cameras_of, registering_of, require_size
from page_runtime.capture.ros_topics import REGISTERED_WORDS, MessageStore, Stored, Topics, first_of
from page_runtime.capture.undistortion import undistorted
from page_runtime.depth_registration import register_depth, undistort_color
from page_runtime.image_files import SourceError
from page_runtime.lens import RawCamera
from page_runtime.recorded import FrameEntry, Instance, Pixels, Source, require_playable

FORMAT = "ROS 2 bag"
SUFFIXES = (".mcap", ".db3")
NO_CAMERA = "frames of a changing camera without its camera_info"
AFTER_DAMAGE = "messages after a damaged page of the database"


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
    by_topic: dict[str, list[Stored]] = defaultdict(list)
    for store in stores:
        for ref in store.messages:
            by_topic[ref.topic].append((store, ref))
    kinds = {channel.topic: channel.kind for store in stores for channel in store.channels}
    color, depth = _topics(path, kinds, by_topic)
    topics = Topics(path, kinds, by_topic)
    cameras = cameras_of(topics, color)
    registering = registering_of(topics, color, depth)
    topic_streams: tuple[tuple[str, Stream], ...] = ((color, "color"), (depth, "depth"))
    in_order: list[tuple[MessageStore, MessageRef, Stream]] = sorted(
        ((store, ref, stream) for topic, stream in topic_streams for store, ref in by_topic[topic]),
        key=lambda item: item[1].log_time_ns,
    )
    readings: list[tuple[float, Stream, Stored]] = []
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
        entries.append(_entry(topics, pair, len(entries), found, registering, facts.get(stamp_ns)))
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


def _calibration(stores: list[MessageStore], messages: list[Stored]) -> str | None:
    """What the camera says of itself: an attachment in MCAP, a message in bags."""
    for store in stores:
        if CALIBRATION_FILE in store.attachments:
            return store.attachments[CALIBRATION_FILE].decode("utf-8", "replace")
    return first_of(messages, ros.STRING).data if messages else None


def _topics(path: Path, kinds: dict[str, str], by_topic: dict[str, Any]) -> tuple[str, str]:
    """The colour and the depth topic."""
    color, depth = [], []
    for topic in sorted(by_topic):
        if kinds[topic] in (ros.IMAGE, ros.COMPRESSED):
            message = first_of(by_topic[topic], kinds[topic])
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
            f"{path}: expected one colour and one depth topic (16UC1 or 32FC1), found "
            f"{len(color)} and {len(depth)}; the bag has {listed}"
        )
    return color[0], depth[0]


def _facts(messages: list[Stored]) -> dict[int, dict[str, Any]]:
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
    topics: Topics,
    pair: Pair[Stored],
    index: int,
    raw: RawCamera,
    registering: Registering | None,
    facts: dict[str, Any] | None,
) -> FrameEntry:
    path, camera = topics.path, raw.camera
    instances: tuple[Instance, ...] = ()
    timestamp_s, skew_s = pair.timestamp_s, pair.skew_s
    if facts is not None:
        try:
            instances = ros.instances_of(facts)
            index, timestamp_s, skew_s = int(facts["index"]), float(facts["timestamp_s"]), float(facts["skew_s"])
            camera = replace(camera, T_camera_world=np.array(facts["T_camera_world"]))
        except (KeyError, TypeError, ValueError) as error:
            raise SourceError(f"{path}: {ros.FACTS_TOPIC}: not understood ({error})") from error
    decode = partial(_decode, topics, pair, raw, registering)
    return FrameEntry(path, path, 0.0, camera, instances, timestamp_s, index, skew_s, decode)


def _decode(topics: Topics, pair: Pair[Stored], raw: RawCamera, registering: Registering | None) -> Pixels:
    where = str(topics.path)
    color_message, depth_message = (topics.decoded(stored) for stored in (pair.color, pair.depth))
    color = ros.color_pixels(color_message, where=f"{where}: {pair.color[1].topic}")
    depth_m = ros.depth_pixels(depth_message, where=f"{where}: {pair.depth[1].topic}")
    camera = raw.camera
    if registering is not None:
        require_size(color, camera, where=f"{where}: {pair.color[1].topic}")
        require_size(depth_m, registering.depth.camera, where=f"{where}: {pair.depth[1].topic}")
        registration = registering.to(raw)
        return undistort_color(registration, color), register_depth(registration, depth_m)
    if color.shape[:2] != (camera.height, camera.width) or depth_m.shape != color.shape[:2]:
        raise SourceError(
            f"{where}: colour is {color.shape[1]}x{color.shape[0]}, depth {depth_m.shape[1]}x{depth_m.shape[0]}, "
            f"CameraInfo {camera.width}x{camera.height}; record depth registered to colour (aligned_depth_to_color)"
        )
    return undistorted(color, depth_m, camera, raw.distortion)
