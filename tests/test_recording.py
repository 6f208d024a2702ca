"""A recording gives back what was written, is a BOP scene, and is there whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import toy
from page_runtime.camera import Camera
from page_runtime.capture.own_recording import read_recording
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import apply, invert, rotation_about, transform_from
from page_runtime.image_files import read_mask
from page_runtime.recorded import Instance, PartTruth, RecordedFrame
from page_runtime.recording import RecordingWriter

NAMES = ("base", "lid")


def random_frame(rng: np.random.Generator, *, instances: int, index: int = 0) -> RecordedFrame:
    width, height = 48, 36
    K = np.array([[rng.uniform(40, 60), 0, 23.4], [0, rng.uniform(40, 60), 17.9], [0, 0, 1]])
    T_camera_world = transform_from(rotation_about(rng.normal(size=3), 1.0), rng.normal(size=3))
    depth = rng.uniform(0.2, 3.0, (height, width)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = 0
    color = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    frame = RgbdFrame(color, depth, Camera(K, width, height, T_camera_world), float(rng.uniform(0, 100)), index)

    def truth(name: str) -> PartTruth:
        T = transform_from(rotation_about(rng.normal(size=3), rng.uniform(0, 3)), rng.normal(size=3))
        state = float(rng.uniform(0, 3)) if name == "lid" else None
        return PartTruth(name, T, rng.uniform(0.01, 1, 3), float(rng.uniform(0, 1)), state)

    found = tuple(Instance((3 + i, 4, 20, 15), tuple(truth(name) for name in NAMES)) for i in range(instances))
    return RecordedFrame(frame, found)


@pytest.mark.parametrize(("seed", "instances"), [(0, 0), (1, 1), (2, 3)])
def test_what_is_written_is_read_back(tmp_path: Path, seed: int, instances: int) -> None:
    rng = np.random.default_rng(seed)
    written = [random_frame(rng, instances=instances, index=i) for i in range(3)]
    with RecordingWriter(tmp_path / "r", category="box", part_names=NAMES, depth_unit_mm=0.1) as writer:
        assert [writer.write(recorded) for recorded in written] == [0, 1, 2]
    source = read_recording(tmp_path / "r")
    assert (source.category, source.part_names, len(source)) == ("box", NAMES, 3)
    for one, other in zip(written, source, strict=True):
        np.testing.assert_array_equal(one.frame.color, other.frame.color)
        np.testing.assert_allclose(one.frame.depth_m, other.frame.depth_m, atol=0.05e-3 + 1e-6)
        np.testing.assert_array_equal(one.frame.depth_m == 0, other.frame.depth_m == 0)
        np.testing.assert_array_equal(one.frame.camera.K, other.frame.camera.K)
        np.testing.assert_allclose(one.frame.camera.T_camera_world, other.frame.camera.T_camera_world, atol=1e-12)
        assert (one.frame.timestamp_s, one.frame.index) == (other.frame.timestamp_s, other.frame.index)
        assert len(one.instances) == len(other.instances)
        for wrote, read in zip(one.instances, other.instances, strict=True):
            assert wrote.region == read.region
            assert wrote.truths is not None
            assert read.truths is not None
            for a, b in zip(wrote.truths, read.truths, strict=True):
                np.testing.assert_allclose(a.T_camera_part, b.T_camera_part, atol=1e-12)
                np.testing.assert_array_equal(a.extents_m, b.extents_m)
                assert (a.name, a.visible_share, a.joint_state) == (b.name, b.visible_share, b.joint_state)


def test_what_was_not_known_stays_unknown(tmp_path: Path) -> None:
    frame = random_frame(np.random.default_rng(0), instances=0).frame
    truth = PartTruth("base", np.eye(4), np.ones(3)), PartTruth("lid", np.eye(4), np.ones(3))
    with RecordingWriter(tmp_path / "r", category="box", part_names=NAMES) as writer:
        writer.write(RecordedFrame(frame, (Instance(None, truth), Instance((1, 2, 3, 4)))))
    one, other = read_recording(tmp_path / "r").entries[0].instances
    assert one.region is None
    assert [(t.visible_share, t.joint_state) for t in one.truths or ()] == [(None, None)] * 2
    assert (other.region, other.truths) == ((1, 2, 3, 4), None)


def test_documents_and_masks_are_as_bop_defines_them(toy_recording: Path) -> None:
    recorded, masks = toy.toy_frame()
    truths = recorded.instances[0].truths
    assert truths is not None
    camera = json.loads((toy_recording / "scene_camera.json").read_text())["0"]
    np.testing.assert_array_equal(np.reshape(camera["cam_K"], (3, 3)), recorded.frame.camera.K)
    gt = json.loads((toy_recording / "scene_gt.json").read_text())["0"]
    info = json.loads((toy_recording / "scene_gt_info.json").read_text())["0"]
    for k, truth in enumerate(truths):
        np.testing.assert_allclose(np.reshape(gt[k]["cam_R_m2c"], (3, 3)), truth.T_camera_part[:3, :3])
        np.testing.assert_allclose(gt[k]["cam_t_m2c"], truth.T_camera_part[:3, 3] * 1000)
        assert gt[k]["obj_id"] == k + 1
        mask = read_mask(toy_recording / "mask_visib" / f"000000_{k:06d}.png")
        np.testing.assert_array_equal(mask, masks[k])
        x, y, w, h = info[k]["bbox_visib"]
        assert mask[y : y + h, x : x + w].sum() == mask.sum() == info[k]["px_count_visib"]
        assert 0 < info[k]["visib_fract"] <= 1
    assert camera["depth_scale"] == 0.1
    # Depth in its unit, back-projected inside a mask, lies on the part: poses, K, depth and mask agree.
    frame = read_recording(toy_recording).entries[0].read().frame
    for k, (truth, mask) in enumerate(zip(truths, masks, strict=True)):
        rows, columns = np.nonzero(read_mask(toy_recording / "mask_visib" / f"000000_{k:06d}.png"))
        assert len(rows) == mask.sum() > 100
        pixels = np.stack([columns, rows], axis=-1).astype(float)
        points_camera = frame.camera.backproject(pixels, frame.depth_m[rows, columns])
        beyond = (np.abs(apply(invert(truth.T_camera_part), points_camera)) - truth.extents_m / 2).max(axis=1)
        assert np.abs(beyond).max() < 1e-4  # depth is stored to 0.1 mm


def test_a_recording_never_overwrites(tmp_path: Path) -> None:
    (tmp_path / "r").mkdir()
    with pytest.raises(FileExistsError, match="never overwrites"):
        RecordingWriter(tmp_path / "r", category="box", part_names=NAMES)


def test_a_recording_that_fails_leaves_nothing(tmp_path: Path) -> None:
    recorded = random_frame(np.random.default_rng(0), instances=1)
    writer = RecordingWriter(tmp_path / "r", category="box", part_names=NAMES)

    def record() -> None:
        with writer:
            writer.write(recorded)
            raise RuntimeError("the camera was unplugged")

    with pytest.raises(RuntimeError):
        record()
    assert list(tmp_path.iterdir()) == []


def refused_frames() -> dict[str, tuple[RecordedFrame, str]]:
    rng = np.random.default_rng(0)
    good = random_frame(rng, instances=1)
    frame, camera = good.frame, good.frame.camera
    far = RgbdFrame(frame.color, frame.depth_m + 7, camera)
    crop = RgbdFrame(frame.color, frame.depth_m, camera.cropped(20, 0, camera.width, camera.height))
    truths = good.instances[0].truths
    assert truths is not None
    return {
        "depth beyond the unit's reach": (RecordedFrame(far), "choose a larger unit"),
        "a crop": (RecordedFrame(crop), "K does not match the image size"),
        "a region outside": (RecordedFrame(frame, (Instance((100, 0, 5, 5)),)), "outside the 48x36 image"),
        "truth of one part": (RecordedFrame(frame, (Instance(None, truths[:1]),)), "expected truths of the parts"),
    }


@pytest.mark.parametrize("case", refused_frames())
def test_a_frame_that_could_not_be_read_back_is_refused(tmp_path: Path, case: str) -> None:
    recorded, reason = refused_frames()[case]
    writer = RecordingWriter(tmp_path / "r", category="box", part_names=NAMES, depth_unit_mm=0.1)
    with pytest.raises(ValueError, match=reason), writer:
        writer.write(recorded)
    assert list(tmp_path.iterdir()) == []
