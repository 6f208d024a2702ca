"""Every format is recognised by what is in the folder, and read into the same frames."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import toy
from page_runtime.capture.playback import open_source
from page_runtime.capture.reartmix import opening_angle, part_from_rest
from page_runtime.geometry import apply, invert, rotation_about, transform_from
from page_runtime.image_files import SourceError, read_color, read_header, write_color, write_depth
from page_runtime.recorded import Instance, PartTruth


def truths_of(instance: Instance) -> tuple[PartTruth, ...]:
    assert instance.truths is not None
    return instance.truths


def write_plain_folder(path: Path, *, boxes: dict[str, list[list[int]]] | None = None, **intrinsics: Any) -> Path:
    """The toy as colour and depth pictures of the names 000004 and 000008."""
    recorded, _ = toy.toy_frame()
    camera = recorded.frame.camera
    for name in ("color", "depth"):
        (path / name).mkdir(parents=True)
    for stem in ("000004", "000008"):
        write_color(path / "color" / f"{stem}.jpg", recorded.frame.color)
        write_depth(path / "depth" / f"{stem}.png", recorded.frame.depth_m, metres_per_unit=1e-3)
    document = {"width": camera.width, "height": camera.height, "intrinsic_matrix": camera.K.T.ravel().tolist()}
    (path / "camera_intrinsic.json").write_text(json.dumps(document | intrinsics))
    if boxes is not None:
        entries = [{"image_file_name": name, "bbox": box} for name, list_ in boxes.items() for box in list_]
        (path / "det_bboxes.json").write_text(json.dumps(entries))
    return path


def write_reartmix(path: Path, *, scale: float = 1.1, category: str = "box") -> Path:
    """The toy in ReArtMix's terms: rest pose open flat, scale inside the matrices, links counted from 1."""
    recorded, _ = toy.toy_frame()
    frame, (base, lid) = recorded.frame, truths_of(recorded.instances[0])
    for name in ("color", "depth", "annotations"):
        (path / name / "scene1").mkdir(parents=True)
    write_color(path / "color" / "scene1" / "000007.jpg", frame.color)
    write_depth(path / "depth" / "scene1" / "000007.png", frame.depth_m, metres_per_unit=1e-3)
    K = frame.camera.K.T.ravel().tolist()
    size = {"width": frame.camera.width, "height": frame.camera.height}
    (path / "camera_intrinsic.json").write_text(json.dumps(size | {"intrinsic_matrix": K}))
    # Base: our x, y, z are rest y, -x, z. The lid lies beside it, turned by 180 degrees about y.
    R_base, R_lid = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    links, corners = [], [[[[0, 0, 0]], [[1, 1, 1]]]]
    for k, (truth, R_rest_part, center) in enumerate(
        ((base, R_base, np.zeros(3)), (lid, R_lid, np.array([-0.1, 0.0, 0.0])))
    ):
        half = np.abs(R_rest_part @ truth.extents_m) / 2 / scale
        corners.append([[(center - half).tolist()], [(center + half).tolist()]])
        R = truth.T_camera_part[:3, :3] @ R_rest_part.T * scale
        matrix = transform_from(R, truth.T_camera_part[:3, 3] - R @ center)
        links.append({"id": k, "link_category_id": k + 1, "transformation": matrix.tolist(), "segmentation": []})
    x, y, w, h = recorded.instances[0].region or (0, 0, 0, 0)
    instance = {"id": 0, "category_id": 1, "urdf_id": 3, "bbox": [x, y, x + w, y + h], "links": links}
    annotation = {"color_path": "scene1/000007.jpg", "instances": [instance, instance]}
    (path / "annotations" / "scene1" / "000007.json").write_text(json.dumps(annotation))
    models = [{"id": 3, "category_name": category, "corner_pts": corners}]
    (path / "urdf_metas.json").write_text(json.dumps({"urdf_metas": models}))
    return path


def test_a_bop_scene_gives_a_region_for_each_visible_entry_and_no_truth(toy_recording: Path, tmp_path: Path) -> None:
    shutil.copytree(toy_recording, tmp_path / "scene")
    (tmp_path / "scene" / "recording.json").unlink()
    source = open_source(tmp_path / "scene")
    assert source.format == "BOP scene folder"
    assert [len(entry.instances) for entry in source.entries] == [2, 2, 2]
    assert not source.has_truth
    own, foreign = open_source(toy_recording).entries[0].read(), source.entries[0].read()
    np.testing.assert_array_equal(own.frame.color, foreign.frame.color)
    np.testing.assert_array_equal(own.frame.depth_m, foreign.frame.depth_m)
    np.testing.assert_array_equal(own.frame.camera.K, foreign.frame.camera.K)


def test_a_plain_folder_has_the_numbers_of_its_files_and_all_boxes_of_a_picture(tmp_path: Path) -> None:
    boxes = {"000004.jpg": [[10, 20, 110, 70], [200, 10, 250, 60]]}
    source = open_source(write_plain_folder(tmp_path / "f", boxes=boxes))
    assert [entry.index for entry in source.entries] == [4, 8]
    assert [i.region for i in source.entries[0].instances] == [(10, 20, 100, 50), (200, 10, 50, 50)]
    assert source.entries[1].instances == ()
    frame = source.entries[0].read().frame
    recorded, _ = toy.toy_frame()
    np.testing.assert_allclose(frame.depth_m, recorded.frame.depth_m, atol=0.5e-3 + 1e-6)
    np.testing.assert_allclose(frame.camera.K, recorded.frame.camera.K)


def test_a_plain_folder_may_say_its_depth_unit(tmp_path: Path) -> None:
    plain = open_source(write_plain_folder(tmp_path / "a")).entries[0].read().frame.depth_m
    scaled = open_source(write_plain_folder(tmp_path / "b", depth_scale=0.25)).entries[0].read().frame.depth_m
    np.testing.assert_allclose(plain, scaled * 4, rtol=1e-6)


def test_reartmix_poses_come_out_rigid_and_in_our_frames(tmp_path: Path) -> None:
    source = open_source(write_reartmix(tmp_path / "r"))
    assert (source.format, source.category, source.part_names) == ("ReArtMix folder", "box", ("base", "lid"))
    recorded, _ = toy.toy_frame()
    (entry,) = source.entries
    assert entry.index == 7
    assert len(entry.instances) == 2
    for got, expected in zip(truths_of(entry.instances[0]), truths_of(recorded.instances[0]), strict=True):
        np.testing.assert_allclose(got.T_camera_part, expected.T_camera_part, atol=1e-9)
        np.testing.assert_allclose(got.extents_m, expected.extents_m, atol=1e-9)
    assert truths_of(entry.instances[0])[1].joint_state == pytest.approx(toy.STATE_RAD)


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.17])
def test_a_rest_box_and_the_part_box_are_the_same_points(scale: float) -> None:
    rng = np.random.default_rng(3)
    matrix = transform_from(rotation_about(rng.normal(size=3), 1.1) * scale, rng.normal(size=3))
    corners = np.array([[-0.04, -0.1, -0.02], [0.05, 0.11, 0.02]])
    T, extents = part_from_rest(matrix, corners, rotation_about(np.array([0, 0, 1.0]), np.pi / 2), where="test")
    inside_rest = rng.uniform(corners[0], corners[1], (100, 3))
    points_part = apply(invert(T), apply(matrix, inside_rest))
    assert (np.abs(points_part) <= extents / 2 + 1e-12).all()
    assert np.prod(extents) == pytest.approx(np.prod(corners[1] - corners[0]) * scale**3)


@pytest.mark.parametrize("state_deg", [0.0, 45.0, 90.0, 179.0, 181.0, 200.0])
def test_the_opening_angle_is_that_turned_about_minus_x(state_deg: float) -> None:
    R_camera_base = rotation_about(np.array([0.3, -1.0, 0.5]), 2.0)
    R_base_lid = rotation_about(np.array([-1.0, 0.0, 0.0]), np.radians(state_deg))
    assert np.degrees(opening_angle(R_camera_base, R_camera_base @ R_base_lid)) == pytest.approx(state_deg)


def test_an_unknown_folder_says_what_is_understood_and_what_was_found(tmp_path: Path) -> None:
    (tmp_path / "holiday.mp4").touch()
    with pytest.raises(SourceError) as raised:
        open_source(tmp_path)
    for words in ("page-edge recording", "BOP scene", "ReArtMix", "color/, depth/", "found holiday.mp4"):
        assert words in str(raised.value)


def test_reartmix_of_a_category_with_unknown_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="expected objects of the category 'box', got 'stapler'"):
        open_source(write_reartmix(tmp_path / "r", category="stapler"))


def test_boxes_of_pictures_that_are_not_there_are_refused(tmp_path: Path) -> None:
    folder = write_plain_folder(tmp_path / "f", boxes={"000099.jpg": [[0, 0, 5, 5]]})
    with pytest.raises(SourceError, match=r"'000099\.jpg' is not a picture in color/"):
        open_source(folder)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_headers_tell_size_and_kind_as_a_decoder_would(tmp_path: Path, suffix: str) -> None:
    color = np.random.default_rng(0).integers(0, 256, (37, 53, 3), dtype=np.uint8)
    write_color(tmp_path / f"a{suffix}", color)
    header = read_header(tmp_path / f"a{suffix}")
    assert (header.width, header.height, header.bits, header.gray) == (53, 37, 8, False)
    assert read_color(tmp_path / f"a{suffix}").shape == color.shape


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.99])
def test_a_cut_off_picture_is_known_by_its_ends(tmp_path: Path, suffix: str, share: float) -> None:
    color = np.random.default_rng(0).integers(0, 256, (37, 53, 3), dtype=np.uint8)
    path = tmp_path / f"a{suffix}"
    write_color(path, color)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(SourceError, match=path.name):
        read_header(path)


def test_colour_is_rgb(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "red.png"), np.full((2, 2, 3), (0, 0, 255), np.uint8))
    np.testing.assert_array_equal(read_color(tmp_path / "red.png")[0, 0], (255, 0, 0))


STRANGE = (None, True, -1, 0, 1e400, 3.5, "", "text", [], {}, [[]], [1, 2], {"0": {}}, "9" * 400)


def places(document: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) in a JSON document."""
    pairs = (
        document.items() if isinstance(document, dict) else enumerate(document) if isinstance(document, list) else ()
    )
    found = []
    for key, value in list(pairs):
        found += [(document, key), *places(value)]
    return found


@pytest.mark.parametrize("kind", ["recording", "bop", "reartmix", "plain"])
def test_whatever_is_strange_in_a_document_is_played_or_refused_but_never_a_crash(
    kind: str, tmp_path: Path, toy_recording: Path
) -> None:
    folder = tmp_path / "source"
    if kind in ("recording", "bop"):
        shutil.copytree(toy_recording, folder)
        if kind == "bop":
            (folder / "recording.json").unlink()
    elif kind == "reartmix":
        write_reartmix(folder)
    else:
        write_plain_folder(folder, boxes={"000004.jpg": [[1, 2, 30, 40]]}, depth_scale=1.0)
    rng = np.random.default_rng(0)
    refusals = 0
    for path in sorted(folder.rglob("*.json")):
        whole = path.read_text()
        for _ in range(120):
            document = json.loads(whole)
            found = places(document)
            container, key = found[rng.integers(len(found))]
            container[key] = STRANGE[rng.integers(len(STRANGE))]
            path.write_text(json.dumps(document))
            try:
                open_source(folder)
            except SourceError:
                refusals += 1
        path.write_text(whole)
    assert refusals > 50
    assert len(open_source(folder)) > 0
