"""What a layout cannot hold is refused and nothing is left behind; what it can is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import recorded_toy
from page_runtime.capture.conversion import copy_frames, frame_writer
from page_runtime.capture.layouts import LAYOUTS
from page_runtime.capture.playback import open_source
from page_runtime.cli import main
from page_runtime.image_files import SourceError
from page_runtime.recorded import RecordedFrame


@pytest.mark.parametrize("layout", ["recording", "tum", "pictures", "video"])
def test_depth_that_would_be_changed_is_refused_and_nothing_is_left(layout: str, tmp_path: Path) -> None:
    (recorded,) = recorded_toy.frames(1)
    odd = replace(recorded, frame=replace(recorded.frame, depth_m=recorded.frame.depth_m * np.float32(1.00001)))
    with (
        pytest.raises(SourceError, match=r"would be changed; write an \.mcap"),
        frame_writer(tmp_path / "out", layout) as writer,
    ):
        writer.write(odd)
    assert list(tmp_path.iterdir()) == []


def test_a_camera_that_changes_is_refused_where_it_could_not_be_said(tmp_path: Path) -> None:
    one, other = recorded_toy.frames(2)
    camera = replace(other.frame.camera, K=other.frame.camera.K * [[1.1, 1, 1], [1, 1, 1], [1, 1, 1]])
    other = replace(other, frame=replace(other.frame, camera=camera))
    with pytest.raises(SourceError, match="the camera changes"), frame_writer(tmp_path / "out", "tum") as writer:
        copy_frames([one, other], writer)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_frames_are_an_error_and_leave_nothing(layout: str, tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="the source gave no frames"), frame_writer(tmp_path / "out", layout):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("layout", LAYOUTS)
def test_nothing_is_ever_overwritten(layout: str, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(FileExistsError, match=r"exists already"), frame_writer(tmp_path / "out", layout):
        pass


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_camera_that_changes_stays_with_its_frame_or_is_refused(layout: str, tmp_path: Path) -> None:
    """Zoomed, moved, or as in the demo's recordings another one in every frame: a K of the first frame would give
    wrong poses for all others, and nothing would fail."""
    frames = recorded_toy.frames()[:4]
    changed = []
    for k, recorded in enumerate(frames):
        K = recorded.frame.camera.K.copy()
        K[:2, :2] *= 1.0 + 0.05 * k
        camera = replace(recorded.frame.camera, K=K)
        changed.append(RecordedFrame(replace(recorded.frame, camera=camera)))
    path = tmp_path / ("frames.mcap" if layout == "mcap" else layout)

    def write() -> None:
        with frame_writer(path, layout) as writer:
            for recorded in changed:
                writer.write(recorded)

    if layout in ("tum", "pictures", "video"):
        with pytest.raises(SourceError, match="camera changes between frames"):
            write()
        return
    write()
    source = open_source(path)
    assert len(source) == len(changed)
    for one, other in zip(changed, source, strict=True):
        np.testing.assert_allclose(other.frame.camera.K, one.frame.camera.K, atol=1e-9)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_frames_of_odd_sizes_keep_every_row_and_column_or_are_refused(layout: str, tmp_path: Path) -> None:
    whole = recorded_toy.frames(1)[0].frame
    camera = whole.camera.cropped(0, 0, 159, 119)
    frame = replace(whole, color=whole.color[:119, :159], depth_m=whole.depth_m[:119, :159], camera=camera)
    path = tmp_path / ("frames.mcap" if layout == "mcap" else layout)

    def write() -> None:
        with frame_writer(path, layout) as writer:
            writer.write(RecordedFrame(frame))

    if layout == "video":
        with pytest.raises(SourceError, match="even width and height for a video, got 159x119"):
            write()
        assert list(tmp_path.iterdir()) == []
        return
    write()
    (played,) = open_source(path)
    np.testing.assert_array_equal(played.frame.color, frame.color)
    np.testing.assert_array_equal(played.frame.depth_m, frame.depth_m)


@pytest.mark.parametrize("layout", ["mcap", "tum", "ros2-mcap", "ros2-sqlite3"])
def test_frames_without_times_of_their_own_are_refused_where_time_is_their_name(layout: str, tmp_path: Path) -> None:
    frames = [RecordedFrame(replace(one.frame, timestamp_s=0.0)) for one in recorded_toy.frames()[:2]]
    path = tmp_path / ("frames.mcap" if layout == "mcap" else layout)

    def write() -> None:
        with frame_writer(path, layout) as writer:
            for recorded in frames:
                writer.write(recorded)

    with pytest.raises(SourceError, match=r"expected a time after 0\.000000 s"):
        write()


def test_a_data_set_without_times_gets_some(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    timeless = tmp_path / "timeless"
    with frame_writer(timeless, "recording") as writer:
        for one in recorded_toy.frames()[:3]:
            writer.write(RecordedFrame(replace(one.frame, timestamp_s=0.0)))
    target = tmp_path / "timed.mcap"
    assert main(["convert", str(timeless), str(target)]) == 2
    assert "--fps" in capsys.readouterr().err
    assert not target.exists()
    assert main(["convert", str(timeless), str(target), "--fps", "0"]) == 2
    assert main(["convert", str(timeless), str(target), "--fps", "10", "--quiet"]) == 0
    played = list(open_source(target))
    assert [one.frame.timestamp_s for one in played] == pytest.approx([0.0, 0.1, 0.2])
    for one, other in zip(recorded_toy.frames(), played, strict=False):
        np.testing.assert_array_equal(one.frame.color, other.frame.color)
