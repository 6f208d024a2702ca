"""The same frames come out of every container, bit for bit, and give the same poses."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import recorded_toy
import toy
from page_runtime import Network, estimate
from page_runtime.capture.picture_folders import exact_unit_mm
from page_runtime.capture.playback import open_source
from page_runtime.image_files import SourceError, depth_in_metres
from page_runtime.recorded import RecordedFrame, Source
from page_runtime.schema import pose_record

Write = Callable[[Path, list[RecordedFrame]], Path]
KEEPS_OBJECTS = {"page-edge recording", "MCAP", "ROS 2 bag of MCAP", "ROS 2 bag of sqlite3"}
KEEPS_SKEW = KEEPS_OBJECTS | {"TUM RGB-D sequence", "depthai recording"}
KEEPS_ANY_DEPTH = {"MCAP", "ROS 2 bag of MCAP", "ROS 2 bag of sqlite3"}
containers = pytest.mark.parametrize("name", list(recorded_toy.LOSSLESS))


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Thirty frames in every container."""
    folder = tmp_path_factory.mktemp("containers")
    frames = recorded_toy.skewed(recorded_toy.frames())
    needs_depthai = {"depthai recording"} if importlib.util.find_spec("depthai") is None else set()
    return {name: write(folder, frames) for name, write in recorded_toy.LOSSLESS.items() if name not in needs_depthai}


def played(written: dict[str, Path], name: str) -> Source:
    if name not in written:
        pytest.skip("depthai is not installed")
    return open_source(written[name])


@containers
def test_every_container_gives_back_every_frame(written: dict[str, Path], name: str) -> None:
    source = played(written, name)
    expected = recorded_toy.skewed(recorded_toy.frames())
    assert len(source) == len(expected) == 30
    assert source.counts.complete
    assert source.counts.paired == 30
    for one, other in zip(expected, source, strict=True):
        np.testing.assert_array_equal(one.frame.color, other.frame.color)
        np.testing.assert_array_equal(one.frame.depth_m, other.frame.depth_m)
        assert other.frame.depth_m.dtype == np.float32
        assert abs(one.frame.timestamp_s - other.frame.timestamp_s) < 1e-6
        np.testing.assert_allclose(one.frame.camera.K, other.frame.camera.K, atol=1e-6)
        assert (one.frame.camera.width, one.frame.camera.height) == (
            other.frame.camera.width,
            other.frame.camera.height,
        )
        assert one.frame.index == other.frame.index
        if name in KEEPS_SKEW:
            assert other.frame.skew_s == pytest.approx(recorded_toy.SKEW_S, abs=2e-6)
    if name in KEEPS_SKEW:
        assert source.counts.max_skew_s == pytest.approx(recorded_toy.SKEW_S, abs=2e-6) or name == "page-edge recording"


@containers
def test_frames_can_be_read_in_any_order_and_again(written: dict[str, Path], name: str) -> None:
    source = played(written, name)
    in_order = [recorded.frame for recorded in source]
    for index in (29, 0, 17, 16, 29, 1):
        frame = source.entries[index].read().frame
        np.testing.assert_array_equal(frame.color, in_order[index].color)
        np.testing.assert_array_equal(frame.depth_m, in_order[index].depth_m)


@pytest.mark.parametrize("name", sorted(KEEPS_OBJECTS))
def test_our_own_containers_keep_objects_and_true_poses(written: dict[str, Path], name: str) -> None:
    source = played(written, name)
    assert (source.category, source.part_names) == ("box", ("base", "lid"))
    for one, other in zip(recorded_toy.frames(), source, strict=True):
        (a,), (b,) = one.instances, other.instances
        assert a.region == b.region
        assert a.truths is not None
        assert b.truths is not None
        for truth, read in zip(a.truths, b.truths, strict=True):
            np.testing.assert_allclose(truth.T_camera_part, read.T_camera_part, atol=1e-12)
            np.testing.assert_allclose(truth.extents_m, read.extents_m)
            assert (truth.name, truth.visible_share, truth.joint_state) == (
                read.name, read.visible_share, read.joint_state,
            )  # fmt: skip


def test_poses_are_the_same_whatever_the_container(written: dict[str, Path], tmp_path: Path) -> None:
    frames = recorded_toy.frames(3)
    region = frames[0].instances[0].region
    assert region is not None
    network = Network(
        toy.write_oracle_bundle(tmp_path / "box.onnx", frames[0].frame, region, toy.part_poses()), threads=1
    )

    def poses(source: list[RecordedFrame]) -> list[object]:
        found = []
        for recorded in source:
            pose = replace(estimate(network, recorded.frame, region), stage_ms={})
            record = pose_record(pose, frame=recorded.frame.index, timestamp_s=0.0)
            found.append(record)
        return found

    expected = poses(frames)
    assert expected
    for path in written.values():
        source = open_source(path)
        assert poses([source.entries[index].read() for index in range(3)]) == expected


@pytest.mark.parametrize("unit_mm", [1.0, 0.25, 0.2, 0.125, 0.1])
def test_depth_is_the_same_to_the_bit_in_whatever_unit_it_is_stored(unit_mm: float) -> None:
    millimetres = np.arange(0, int(65535 * unit_mm), dtype=np.uint16)
    units = np.rint(millimetres / unit_mm).astype(np.uint16)
    np.testing.assert_array_equal(
        depth_in_metres(units, metres_per_unit=unit_mm * 1e-3), depth_in_metres(millimetres, metres_per_unit=1e-3)
    )


@pytest.mark.parametrize(
    "name", ["page-edge recording", "MCAP", "ROS 2 bag of sqlite3", "folder of colour and depth pictures"]
)
def test_finer_depth_than_millimetres_is_kept(name: str, tmp_path: Path) -> None:
    frames = recorded_toy.frames(2, unit_mm=0.1)
    assert exact_unit_mm(frames[0]) == 0.1
    source = open_source(recorded_toy.LOSSLESS[name](tmp_path, frames))
    for one, other in zip(frames, source, strict=True):
        np.testing.assert_array_equal(one.frame.depth_m, other.frame.depth_m)


@pytest.mark.parametrize(
    ("name", "missing", "extra"),
    [
        ("MCAP", "mcap", "ros"),
        ("ROS 2 bag of sqlite3", "rosbags.rosbag2", "ros"),
        ("depthai recording", "mcap_protobuf.decoder", "ros"),
    ],
)
def test_a_missing_library_names_the_extra_to_install(
    written: dict[str, Path], name: str, missing: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name not in written:
        pytest.skip("depthai is not installed")
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(SourceError, match=rf"pip install 'page-edge\[{extra}\]'"):
        open_source(written[name])


@pytest.mark.parametrize(("name", "magic"), [("a.bag", b"#ROSBAG V2.0\n"), ("a.mkv", b"\x1aE\xdf\xa3")])
def test_sensor_recordings_that_open3d_cannot_open_are_refused(name: str, magic: bytes, tmp_path: Path) -> None:
    pytest.importorskip("open3d")
    (tmp_path / name).write_bytes(magic + bytes(100))
    with pytest.raises(SourceError, match="Open3D cannot open it"):
        open_source(tmp_path / name)


@pytest.mark.parametrize("name", ["MCAP", "ROS 2 bag of MCAP", "ROS 2 bag of sqlite3"])
def test_other_readers_of_ros_2_read_our_bags(written: dict[str, Path], name: str) -> None:
    """rosbags for all, and for MCAP the decoder of mcap-ros2-support, which parses the definitions inside the file."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    path = written[name]
    frame = recorded_toy.frames(1)[0].frame
    typestore = get_typestore(Stores.ROS2_JAZZY)
    with Reader(path) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
        assert set(counts.values()) == {30}
        connection = next(c for c in reader.connections if c.topic == "/camera/color/camera_info")
        info: Any = typestore.deserialize_cdr(next(reader.messages([connection]))[2], connection.msgtype)
        np.testing.assert_array_equal(np.reshape(info.k, (3, 3)), frame.camera.K)
    file = path if path.is_file() else next(iter(path.glob("*.mcap")), None)
    if file is not None:
        with file.open("rb") as stream:
            found = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
                topics=["/camera/aligned_depth_to_color/image_raw"]
            )
            _, _, _, message = next(iter(found))
        assert (message.encoding, message.width, message.height) == ("16UC1", 160, 120)
        depth = np.frombuffer(bytes(message.data), "<u2").reshape(120, 160)
        np.testing.assert_array_equal(depth, np.rint(frame.depth_m * 1000))
