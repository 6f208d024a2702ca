"""Where objects may be: clusters off the planes, detectors, masks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

import toy
from page_runtime.bundle_fields import BundleError
from page_runtime.camera import Camera
from page_runtime.frame import RgbdFrame
from page_runtime.image_files import SourceError
from page_runtime.live.clusters import Clusters, planes_in
from page_runtime.live.detector import Detector, letterboxed
from page_runtime.live.locate import FixedRegion, covered
from page_runtime.live.masks import MaskFolder
from page_runtime.recorded import RecordedFrame
from page_runtime.sampling import Region


def blank(width: int, height: int, index: int = 0) -> RecordedFrame:
    camera = Camera(np.array([[500.0, 0, (width - 1) / 2], [0, 500.0, (height - 1) / 2], [0, 0, 1]]), width, height)
    color, depth_m = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.float32)
    return RecordedFrame(RgbdFrame(color, depth_m, camera, 0.0, index))


def painted(width: int, height: int, boxes: list[Region]) -> RecordedFrame:
    recorded = blank(width, height)
    for x, y, w, h in boxes:
        recorded.frame.color[y : y + h, x : x + w, 0] = 255
    return recorded


def test_an_object_on_a_table_is_a_cluster_of_its_own() -> None:
    recorded, _ = toy.toy_frame()
    regions = Clusters.of(toy.CATEGORY).locate(recorded)
    true = recorded.instances[0].region
    assert true is not None
    assert regions
    assert max(covered(true, region) for region in regions[:1]) > 0.7
    assert regions[0][2] * regions[0][3] < 2.0 * true[2] * true[3]
    assert regions == Clusters.of(toy.CATEGORY).locate(recorded)


def test_an_empty_frame_and_one_that_is_all_plane_hold_no_cluster() -> None:
    clusters = Clusters(0.02, 0.8)
    empty = blank(320, 240)
    assert clusters.locate(empty) == ()
    empty.frame.depth_m[:] = 1.2
    assert clusters.locate(empty) == ()
    empty.frame.depth_m[:] = np.nan
    assert clusters.locate(empty) == ()


def test_planes_are_found_with_their_normals_and_distances_among_other_points() -> None:
    rng = np.random.default_rng(1)
    floor = np.column_stack([rng.uniform(-1, 1, (4000, 2)), np.full(4000, 1.5) + rng.normal(0, 0.002, 4000)])
    wall = np.column_stack([np.full(2000, 0.8), rng.uniform(-1, 1, 2000), rng.uniform(0.5, 1.5, 2000)])
    other = rng.uniform(-0.3, 0.3, (500, 3)) + np.array([0.0, 0.0, 1.0])
    first, second, *more = planes_in(np.concatenate([floor, wall, other]))
    assert more == []
    for (normal, offset), (axis, distance) in zip((first, second), ((2, 1.5), (0, 0.8)), strict=True):
        assert abs(normal[axis]) > 0.9999
        assert abs(abs(offset) - distance) < 0.003


def test_a_fixed_region_outside_the_picture_is_refused() -> None:
    assert FixedRegion((10, 10, 50, 40)).locate(blank(320, 240)) == ((10, 10, 50, 40),)
    with pytest.raises(ValueError, match="lies outside"):
        FixedRegion((400, 10, 50, 40)).locate(blank(320, 240))


def write_red_detector(
    path: Path, *, size: tuple[int, int] = (128, 160), suppressed: bool = False, masks: bool = False
) -> Path:
    """A detector of what is red: the box around it, as Ultralytics exports boxes. Three anchors say the same box with
    other scores, for class 1 ("case") and, less surely, class 0 ("cup")."""
    height, width = size
    nodes, constants = [], []

    def constant(name: str, value: object) -> str:
        constants.append(numpy_helper.from_array(np.asarray(value, np.float32), name))
        return name

    def whole(name: str, value: list[int]) -> str:
        constants.append(numpy_helper.from_array(np.asarray(value, np.int64), name))
        return name

    def node(kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    # Red, and not the grey of the border.
    red = node("Slice", ["images", whole("r0", [0]), whole("r1", [1]), whole("axis1", [1])], "red")
    green = node("Slice", ["images", "r1", whole("r2", [2]), "axis1"], "green")
    is_red = node("Cast", [node("Greater", [node("Sub", [red, green], "d"), constant("half", 0.5)], "g")], "m", to=1)
    columns = constant("columns", np.broadcast_to(np.arange(width) + 1.0, (1, 1, height, width)))
    rows = constant("rows", np.broadcast_to((np.arange(height) + 1.0)[:, None], (1, 1, height, width)))
    flat = whole("flat", [1, 1])
    corners = {}
    for name, grid, count in (("x", columns, width), ("y", rows, height)):
        largest = node("ReduceMax", [node("Mul", [is_red, grid], f"{name}m")], f"{name}M", keepdims=1)
        back = node("Sub", [constant(f"{name}n", count + 1.0), grid], f"{name}b")
        least = node("ReduceMax", [node("Mul", [is_red, back], f"{name}k")], f"{name}L", keepdims=1)
        corners[name] = (
            node("Reshape", [node("Sub", [f"{name}n", least], f"{name}s"), flat], f"{name}0r"),
            node("Reshape", [largest, flat], f"{name}1r"),
        )
    one = constant("one", [[1.0]])
    x0, y0 = (node("Sub", [corners[k][0], one], f"{k}0") for k in ("x", "y"))
    x1, y1 = corners["x"][1], corners["y"][1]
    if suppressed:
        values = [x0, y0, x1, y1, constant("score", [[0.9]]), constant("class", [[1.0]])]
        values += [constant("coefficient", [[1.0]])] if masks else []
        row = node("Concat", values, "row", axis=1)
        node("Unsqueeze", [row, whole("u", [0])], "output0")
        shape = [1, 1, 7 if masks else 6]
    else:
        middle = [
            node("Mul", [node("Add", [a, b], f"{n}sum"), constant(f"{n}half", 0.5)], f"{n}c")
            for n, a, b in (("x", x0, x1), ("y", y0, y1))
        ]
        sizes = [node("Sub", [b, a], f"{n}size") for n, a, b in (("x", x0, x1), ("y", y0, y1))]
        box = node("Concat", [*middle, *sizes], "box", axis=0)
        boxes = node("Concat", [box, box, box], "boxes", axis=1)
        scores = constant("scores", [[0.3, 0.2, 0.1], [0.9, 0.7, 0.05]])
        values = [boxes, scores] + ([constant("coefficients", [[1.0, 1.0, 1.0]])] if masks else [])
        whole_rows = node("Concat", values, "all", axis=0)
        node("Unsqueeze", [whole_rows, whole("u", [0])], "output0")
        shape = [1, 7 if masks else 6, 3]
    outputs = [helper.make_tensor_value_info("output0", TensorProto.FLOAT, shape)]
    if masks:
        # The mask: the upper half of the red.
        quarter = node("AveragePool", [is_red], "pooled", kernel_shape=[4, 4], strides=[4, 4])
        upper = np.full((1, 1, height // 4, width // 4), -1.0)
        upper[:, :, : height // 8] = 1.0
        shifted = node("Sub", [quarter, constant("level", 0.5)], "level_m")
        node("Min", [shifted, constant("upper", upper)], "output1")
        outputs.append(helper.make_tensor_value_info("output1", TensorProto.FLOAT, [1, 1, height // 4, width // 4]))
    graph = helper.make_graph(
        nodes,
        "red",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, height, width])],
        outputs,
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
    helper.set_model_props(model, {"names": "{0: 'cup', 1: 'case'}", "task": "segment" if masks else "detect"})
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString())
    return path


@pytest.mark.parametrize("suppressed", [False, True])
@pytest.mark.parametrize("size", [(320, 240), (240, 320), (640, 200)])
def test_a_detectors_box_is_found_in_a_frame_of_any_shape(
    tmp_path: Path, size: tuple[int, int], suppressed: bool
) -> None:
    detector = Detector(write_red_detector(tmp_path / "d.onnx", suppressed=suppressed), classes=("case",), threads=1)
    true = (60, 80, 100, 60)
    (found,) = detector.locate(painted(*size, [true]))
    scale = max(size[0] / 160, size[1] / 128)
    np.testing.assert_allclose(found, true, atol=2.0 * scale)


def test_boxes_of_one_object_are_one_region_for_each_class_and_classes_are_known_by_name_or_number(
    tmp_path: Path,
) -> None:
    path = write_red_detector(tmp_path / "d.onnx")
    recorded = painted(320, 240, [(60, 80, 100, 60)])
    assert len(Detector(path, threads=1).locate(recorded)) == 1
    assert len(Detector(path, classes=("1",), threads=1).locate(recorded)) == 1
    assert Detector(path, classes=("cup",), threads=1).locate(recorded) == ()
    assert Detector(path, least_score=0.95, threads=1).locate(recorded) == ()
    with pytest.raises(BundleError, match="no class 'tiger'; expected of cup, case"):
        Detector(path, classes=("tiger",), threads=1)


@pytest.mark.parametrize("suppressed", [False, True])
def test_a_segmentations_region_is_the_box_of_its_mask(tmp_path: Path, suppressed: bool) -> None:
    path = write_red_detector(tmp_path / "s.onnx", suppressed=suppressed, masks=True)
    recorded = painted(320, 256, [(60, 80, 100, 96)])
    (found,) = Detector(path, threads=1).locate(recorded)
    np.testing.assert_allclose(found, (60, 80, 100, 48), atol=10.0)


def test_what_is_no_detector_is_refused_with_the_way_out(tmp_path: Path, oracle_bundle: Path) -> None:
    with pytest.raises(BundleError, match="there is no such file"):
        Detector(tmp_path / "missing.onnx")
    (tmp_path / "torn.onnx").write_bytes(b"no graph")
    with pytest.raises(BundleError, match="onnxruntime cannot load it"):
        Detector(tmp_path / "torn.onnx")
    with pytest.raises(BundleError, match="export it with format=onnx"):
        Detector(oracle_bundle)


def test_a_letterbox_keeps_proportions_and_its_numbers_lead_back() -> None:
    color = np.zeros((100, 300, 3), np.uint8)
    color[20:40, 30:90] = 255
    picture, box = letterboxed(color, (160, 160))
    rows, columns = np.nonzero(picture[0, 0] > 0.9)
    assert abs((columns.min() - box.left) / box.scale - 30) < 2.5
    assert abs((rows.max() + 1 - box.top) / box.scale - 40) < 2.5
    assert picture.shape == (1, 3, 160, 160)
    assert picture[0, 0, 0, 0] == pytest.approx(114 / 255)


def test_every_value_of_a_mask_is_an_object_and_a_frame_without_a_mask_has_none(tmp_path: Path) -> None:
    mask = np.zeros((240, 320), np.uint8)
    mask[10:30, 40:100], mask[100:150, 200:230] = 7, 3
    mask[0, 0] = 9
    cv2.imwrite(str(tmp_path / "000012.png"), mask)
    masks = MaskFolder.opened(tmp_path)
    assert masks.locate(blank(320, 240, 12)) == ((200, 100, 30, 50), (40, 10, 60, 20))
    assert masks.locate(blank(320, 240, 13)) == ()
    with pytest.raises(SourceError, match="expected one channel of 640x480"):
        masks.locate(blank(640, 480, 12))


def test_masks_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="expected a folder of masks"):
        MaskFolder.opened(tmp_path / "none")
    with pytest.raises(SourceError, match="no mask found"):
        MaskFolder.opened(tmp_path)
    for name in ("5.png", "005.png"):
        cv2.imwrite(str(tmp_path / name), np.ones((4, 4), np.uint8))
    with pytest.raises(SourceError, match="both the mask of frame 5"):
        MaskFolder.opened(tmp_path)
    (tmp_path / "5.png").unlink()
    (tmp_path / "005.png").write_bytes(b"torn")
    with pytest.raises(SourceError, match="cannot be read"):
        MaskFolder.opened(tmp_path).locate(blank(4, 4, 5))


def test_both_real_pencil_cases_are_among_the_clusters(shared_data: Path) -> None:
    from page_runtime import open_source

    folder = shared_data / "realsense_boxes"
    if not folder.is_dir():
        pytest.skip("the recording is not there")
    source = open_source(folder)
    for entry in source.entries[::10]:
        recorded = entry.read()
        regions = Clusters(0.036, 0.84).locate(recorded)
        for instance in recorded.instances:
            assert instance.region is not None
            assert max(covered(instance.region, region) for region in regions) > 0.7
