"""The doctor on the project's own recordings: a right one is fine, every known fault is named with its frame."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from category_objects import posed_object, seen_object
from page_runtime.image_files import write_mask
from page_runtime.recording import RecordingWriter
from page_training.categories import CATEGORIES
from page_training.cli import main
from page_training.datasets.depth_checks import sampled
from page_training.datasets.doctor import examine
from page_training.datasets.findings import PLACES_SHOWN, Finding, in_places

DATA = Path(__file__).resolve().parent / "data"
FRAMES = 4


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a box in a few positions."""
    path = tmp_path_factory.mktemp("sound") / "recording"
    with RecordingWriter(path, category="box", part_names=("base", "lid"), depth_unit_mm=0.1) as writer:
        for i in range(FRAMES):
            recorded, masks = seen_object(posed_object(CATEGORIES["box"], share=0.3 + 0.1 * i, yaw_rad=0.2 * i))
            writer.write(recorded, masks=(masks,))
    return path


def errors(findings: list[Finding]) -> list[Finding]:
    return [one for one in findings if one.severity == "error"]


def edited(path: Path, name: str, change: Callable[[Any], object]) -> None:
    document = json.loads((path / name).read_text())
    change(document)
    (path / name).write_text(json.dumps(document))


def blank_depth(path: Path, frame: int) -> None:
    file = path / "depth" / f"{frame:06d}.png"
    depth = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert depth is not None
    cv2.imwrite(str(file), np.zeros_like(depth))


def moved(path: Path, frame: int, offset_mm: tuple[float, float, float]) -> None:
    def change(document: Any) -> None:
        for entry in document[str(frame)]:
            entry["cam_t_m2c"] = [a + b for a, b in zip(entry["cam_t_m2c"], offset_mm, strict=True)]

    edited(path, "scene_gt.json", change)


def empty_mask(path: Path, frame: int, part: int) -> None:
    file = path / "mask_visib" / f"{frame:06d}_{part:06d}.png"
    mask = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    write_mask(file, np.zeros(mask.shape, bool))


def every_camera(path: Path, focal: float = 1.0, center: float = 1.0, depth_scale: float = 1.0) -> None:
    def change(document: Any) -> None:
        for camera in document.values():
            factors = [focal, 1, center, 1, focal, center, 1, 1, 1]
            camera["cam_K"] = [a * b for a, b in zip(camera["cam_K"], factors, strict=True)]
            camera["depth_scale"] *= depth_scale

    edited(path, "scene_camera.json", change)


def every_part(path: Path, change: Callable[[dict[str, Any]], object], *, of: int = 1) -> None:
    """Change recording.json's entry of part `of` in every frame."""

    def of_all(document: Any) -> None:
        for frame in document["frames"].values():
            change(frame["instances"][0]["parts"][of])

    edited(path, "recording.json", of_all)


def swap_parts(path: Path) -> None:
    def change(document: Any) -> None:
        for frame in document["frames"].values():
            base, lid = frame["instances"][0]["parts"]
            base["gt"], lid["gt"] = lid["gt"], base["gt"]

    edited(path, "recording.json", change)


def swap_axes(path: Path) -> None:
    """The lid's x and y axes, its z axis the other way."""

    def change(document: Any) -> None:
        for objects in document.values():
            R = np.reshape(objects[1]["cam_R_m2c"], (3, 3))
            objects[1]["cam_R_m2c"] = np.stack([R[:, 1], R[:, 0], -R[:, 2]], axis=1).ravel().tolist()

    edited(path, "scene_gt.json", change)


def region_elsewhere(path: Path) -> None:
    edited(path, "recording.json", lambda d: d["frames"]["2"]["instances"][0].update(region=[0, 0, 30, 30]))


def test_a_sound_recording_is_fine(sound: Path) -> None:
    findings = examine(sound)
    assert {one.severity for one in findings} == {"fine"}
    assert {one.check for one in findings} >= {"files", "truths", "outlines", "depth"}


@pytest.mark.parametrize("category", ["box", "drawer", "laptop"])
def test_recordings_with_the_noise_of_depth_cameras_are_fine(category: str) -> None:
    assert errors(examine(DATA / category)) == []


FAULTS: list[tuple[Callable[[Path], object], str, str, str]] = [
    (
        lambda p: [blank_depth(p, i) for i in range(FRAMES)],
        "depth",
        "4 of 4 depth pictures are 0 everywhere",
        "frame 0",
    ),
    (lambda p: every_camera(p, focal=1.25), "outlines", "with fx and fy times 0.8", "frame 0"),
    (lambda p: every_camera(p, focal=0.8), "outlines", "with fx and fy times 1.25", "frame 0"),
    (lambda p: every_camera(p, focal=1.25, center=1.25), "outlines", "with K times 0.8", "frame 0"),
    (lambda p: every_camera(p, depth_scale=10), "depth", "with depth_scale 0.1", "frame 0"),
    (lambda p: every_camera(p, depth_scale=1e-3), "depth", "with depth_scale 0.1", "frame 0"),
    (lambda p: [moved(p, i, (60.0, 0.0, 0.0)) for i in range(FRAMES)], "outlines", "8 of 8 parts", "frame 0, base"),
    (lambda p: moved(p, 2, (60.0, 0.0, 0.0)), "outlines", "2 of 8 parts", "frame 2, base; frame 2, lid"),
    (lambda p: [moved(p, i, (0.0, 0.0, 150.0)) for i in range(FRAMES)], "depth", "% of the depth inside", "frame 0"),
    (lambda p: empty_mask(p, 1, 1), "masks", "1 of 8 masks are empty", "frame 1, lid"),
    (region_elsewhere, "masks", "mostly outside the region", "frame 2, base"),
    (
        lambda p: every_part(p, lambda part: part.update(joint_state=9.0)),
        "truths",
        "hinge: its state is out of its limits 0 to 3.49 rad; 4 of 4 objects",
        "frame 0",
    ),
    (
        lambda p: every_part(p, lambda part: part.update(joint_state=part["joint_state"] + 0.2)),
        "truths",
        "hinge: its state is not that of the poses",
        "frame 0",
    ),
    (
        lambda p: every_part(p, lambda part: part.update(extents_m=[1e3 * one for one in part["extents_m"]])),
        "truths",
        "lid: its diagonal is not 0.09 to 0.55 m; is its unit another one?",
        "frame 0",
    ),
    (swap_parts, "outlines", "marked outside the outline", "frame 0"),
    (swap_axes, "truths", "hinge: base and lid differ in the direction of its axis", "frame 0"),
]


@pytest.mark.parametrize(("fault", "check", "what", "where"), FAULTS)
def test_a_fault_is_named_with_its_frame(
    fault: Callable[[Path], object], check: str, what: str, where: str, sound: Path, tmp_path: Path
) -> None:
    path = tmp_path / "faulty"
    shutil.copytree(sound, path)
    fault(path)
    found = errors(examine(path))
    assert any(one.check == check and what in one.what and one.where.startswith(where) for one in found), found


def test_files_that_are_broken_are_named_one_by_one_and_the_others_examined(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "broken"
    shutil.copytree(sound, path)
    depth = path / "depth" / "000000.png"
    depth.write_bytes(depth.read_bytes()[:300])
    edited(path, "scene_gt.json", lambda d: d["1"][0].update(cam_R_m2c=[2.0 * one for one in d["1"][0]["cam_R_m2c"]]))
    mask = path / "mask_visib" / "000002_000001.png"
    mask.write_bytes(b"no picture")
    moved(path, 3, (60.0, 0.0, 0.0))
    found = errors(examine(path))
    for place in (str(depth), "frame 1: PartTruth 'base'", str(mask)):
        assert sum(place in one.what for one in found) == 1, place
    assert any(one.check == "outlines" and one.where == "frame 3, base; frame 3, lid" for one in found)
    assert main(["doctor", str(path)]) == 1
    # The first of the frames that can be read is sound.
    assert not any(one.check == "outlines" for one in errors(examine(path, most_frames=1)))
    assert main(["doctor", str(path), "--frames", "0"]) == 2
    assert str(mask) in capsys.readouterr().out
    edited(path, "scene_camera.json", lambda d: [camera.pop("cam_K") for camera in d.values()])
    found = errors(examine(path))
    assert [one.check for one in found] == ["files"] * FRAMES
    assert sum("expected a field 'cam_K'" in one.what for one in found) == FRAMES - 1


def test_what_is_no_error_is_said_all_the_same(sound: Path, tmp_path: Path) -> None:
    path = tmp_path / "other"
    shutil.copytree(sound, path)
    blank_depth(path, 1)
    edited(path, "recording.json", lambda d: d.update(category="kettle"))
    findings = examine(path)
    assert errors(findings) == []
    said = {one.check: one for one in findings if one.severity == "warning"}
    assert "'kettle' is not known here" in said["truths"].what
    assert any("1 of 4 depth pictures are 0" in one.what and one.where == "frame 1" for one in findings)
    shutil.rmtree(path / "mask_visib")
    assert any(one.check == "masks" and "only great faults" in one.what for one in examine(path))


def test_a_mask_that_is_missing_is_named(sound: Path, tmp_path: Path) -> None:
    path = tmp_path / "lost"
    shutil.copytree(sound, path)
    (path / "mask_visib" / "000001_000001.png").unlink()
    assert any(one.where == "frame 1" and "missing" in one.what for one in errors(examine(path)))


def test_frames_are_sampled_evenly_and_places_are_counted() -> None:
    assert sampled(0, 40) == []
    assert sampled(5, 40) == [0, 1, 2, 3, 4]
    assert (len(sampled(1000, 40)), sampled(1000, 40)[0], sampled(1000, 40)[-1]) == (40, 0, 999)
    assert in_places(["a", "b"]) == "a; b"
    assert in_places(["a"] * (PLACES_SHOWN + 2)).endswith("; and 2 more")
