"""Results as a ROS 2 bag: it plays, other readers find the poses, and a full disk costs what came last."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import toy
from live_results import noisy_result, results_of
from page_runtime.capture.mcap_file import McapFile
from page_runtime.capture.playback import open_source
from page_runtime.capture.repair import repair
from page_runtime.capture.ros_results import part_frame
from page_runtime.geometry import rotation_about
from page_runtime.live.result import LiveResult
from page_runtime.pose import PartPose
from page_runtime.schema import result_record
from page_runtime.similarity import unit_quaternions
from page_runtime.sinks.mcap import McapSink
from page_runtime.sinks.queue import Sinks
from sink_trials import Script, keep, largest_file, read_ros2


@pytest.fixture(scope="module")
def results(toy_recording: Path, oracle_bundle: Path) -> list[LiveResult]:
    """Three frames; the second has no depth."""
    return list(results_of(toy_recording, oracle_bundle))


def test_an_mcap_file_plays_as_a_recording_of_the_same_frames(results: list[LiveResult], tmp_path: Path) -> None:
    keep(McapSink(tmp_path / "a.mcap", category=toy.CATEGORY), results)
    source = open_source(tmp_path / "a.mcap")
    assert (source.category, source.part_names) == ("box", ("base", "lid"))
    for recorded, result in zip(source, results, strict=True):
        np.testing.assert_array_equal(recorded.frame.color, result.frame.color)
        np.testing.assert_array_equal(recorded.frame.depth_m, result.frame.depth_m)
        assert recorded.frame.timestamp_s == result.frame.timestamp_s
        assert [instance.region for instance in recorded.instances] == [found.region for found in result.objects]


def test_another_reader_finds_each_pose_as_a_transform_and_a_marker(results: list[LiveResult], tmp_path: Path) -> None:
    keep(McapSink(tmp_path / "a.mcap"), results)
    by_topic = read_ros2(tmp_path / "a.mcap")
    for k, result in enumerate(results):
        parts = [part for part in result.objects[0].pose.parts if isinstance(part, PartPose)]
        transforms = by_topic["/tf"][k].transforms  # type: ignore[attr-defined]
        assert [t.child_frame_id for t in transforms] == [f"object_0/{part.name}" for part in parts]
        delete, *markers = by_topic["/page_edge/markers"][k].markers  # type: ignore[attr-defined]
        assert delete.action == 3
        for transform, box, part in zip(transforms, markers[::2], parts, strict=True):
            assert transform.header.frame_id == "camera_color_optical_frame"
            T = np.asarray(part.T_camera_part)
            np.testing.assert_allclose(vector(transform.transform.translation), T[:3, 3], atol=1e-12)
            np.testing.assert_allclose(turn(transform.transform.rotation), T[:3, :3], atol=1e-9)
            np.testing.assert_allclose(vector(box.pose.position), T[:3, 3], atol=1e-12)
            np.testing.assert_allclose(vector(box.scale), part.extents_m, atol=1e-12)
        states = by_topic["/page_edge/joint_states"][k]
        values = [joint.value for joint in result.objects[0].pose.joints if joint.value is not None]
        assert list(states.position) == values  # type: ignore[attr-defined]
        assert json.loads(by_topic["/page_edge/result"][k].data) == result_record(result)  # type: ignore[attr-defined]


def vector(message: object) -> list[float]:
    return [message.x, message.y, message.z]  # type: ignore[attr-defined]


def turn(q: object) -> np.ndarray:
    """The rotation of a quaternion, from its axis and angle: not the way the runtime made it."""
    w, axis = q.w, np.array(vector(q))  # type: ignore[attr-defined]
    length = float(np.linalg.norm(axis))
    return np.eye(3) if length == 0 else rotation_about(axis, 2 * np.arctan2(length, w))


@settings(deadline=None)
@given(
    st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda a: np.linalg.norm(a) > 0.1), st.floats(0, np.pi)
)
def test_a_quaternion_is_the_half_turn_about_the_axis(axis: list[float], angle_rad: float) -> None:
    unit = np.array(axis) / np.linalg.norm(axis)
    (found,) = unit_quaternions(np.asarray(rotation_about(unit, angle_rad)[None], np.float64))
    expected = np.array([np.cos(angle_rad / 2), *(np.sin(angle_rad / 2) * unit)])
    # q and -q are the same turn.
    assert min(np.abs(found - expected).max(), np.abs(found + expected).max()) < 1e-7


def test_frames_of_parts_have_no_spaces() -> None:
    assert part_frame(3, "top drawer") == "object_3/top_drawer"


def test_a_full_disk_ends_the_recording_after_its_last_whole_chunk_and_repair_closes_it(tmp_path: Path) -> None:
    path, told = tmp_path / "a.mcap", list[str]()
    other = Script()
    sinks = Sinks([(McapSink(path), 40), (other, 40)], tell=told.append, close_s=60)
    with largest_file(3 << 20), sinks:
        for i in range(40):
            sinks.put(noisy_result(i))
    counts = sinks.counts[f"mcap {path}"]
    assert counts.written >= 3
    assert counts.failed == 40 - counts.written >= 3
    assert len(other.seen) == 40
    assert sum("File too large" in sentence for sentence in told) == 1
    file = McapFile(path)
    assert set(file.missed) == {"end of a file that was never closed"}
    file.close()
    repaired = repair(path, None)
    frames = list(open_source(repaired.path))
    assert len(frames) == repaired.frames <= counts.written
    # What waited for its chunk to be full, 1 MB of some 540 kB a frame, is what the disk has cost.
    assert repaired.frames >= counts.written - 2
    for recorded in frames:
        np.testing.assert_array_equal(recorded.frame.color, noisy_result(recorded.frame.index).frame.color)
