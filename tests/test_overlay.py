"""What is drawn is where the pose says, and drawing never fails."""

from __future__ import annotations

import numpy as np
import pytest

import toy
from page_runtime.camera import Camera
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array, transform_from
from page_runtime.overlay import AXIS_COLORS, PART_COLORS, TRUTH_COLOR, draw
from page_runtime.pose import ArticulatedPose, NotSeen, PartPose
from page_runtime.recorded import Instance, PartTruth

EXTENTS_M = np.array([0.2, 0.1, 0.05])


def blank(size: int = 200) -> RgbdFrame:
    K = np.array([[200.0, 0, (size - 1) / 2], [0, 200, (size - 1) / 2], [0, 0, 1]])
    color = np.zeros((size, size, 3), np.uint8)
    return RgbdFrame(color, np.ones((size, size), np.float32), Camera(K, size, size))


def posed(T: Array, name: str = "base", keypoints: Array | None = None) -> ArticulatedPose:
    points = np.zeros((0, 3)) if keypoints is None else keypoints
    return ArticulatedPose(
        (PartPose(name, T, EXTENTS_M, points, np.zeros(3), 0.9, 0.9, 0.0, 0, 1, 0.0, np.eye(6)),), (), {}
    )


def at(x: float, y: float, z: float) -> Array:
    return transform_from(np.eye(3), np.array([x, y, z]))


def where(picture: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """(n,2) pixels x, y of this colour, drawn over black with soft edges."""
    values = picture.astype(float)
    size = np.linalg.norm(values, axis=2)
    along = values @ np.array(color, float) / (np.linalg.norm(color) * np.maximum(size, 1))
    rows, columns = np.nonzero((size > 80) & (along > 0.995))
    return np.stack([columns, rows], axis=1)


def test_axes_point_where_the_pose_turns_them() -> None:
    frame = blank()
    picture = draw(frame, [(Instance(None), posed(at(0, 0, 0.5)))])
    middle = 99.5
    red, green = where(picture, AXIS_COLORS[0]), where(picture, AXIS_COLORS[1])
    assert red[:, 0].max() > middle + 5
    assert abs(red[:, 1].mean() - middle) < 2
    assert green[:, 1].max() > middle + 5
    assert abs(green[:, 0].mean() - middle) < 2


def test_the_box_encloses_the_object_seen() -> None:
    recorded, masks = toy.toy_frame(toy.toy_camera(640, 480))
    (instance,) = recorded.instances
    truths = instance.truths
    assert truths is not None
    dark = RgbdFrame(np.zeros_like(recorded.frame.color), recorded.frame.depth_m, recorded.frame.camera)
    picture = draw(dark, [(Instance(None, truths[:1]), ArticulatedPose((), (), {}))], with_truth=True)
    drawn = where(picture, TRUTH_COLOR)
    rows, columns = np.nonzero(masks[0])
    assert drawn[:, 0].min() <= columns.min() + 1
    assert drawn[:, 0].max() >= columns.max() - 1
    assert drawn[:, 1].max() >= rows.max() - 1


def test_truth_is_drawn_only_when_asked_for() -> None:
    truth = (PartTruth("base", at(0, 0, 1), EXTENTS_M),)
    found = [(Instance(None, truth), ArticulatedPose((), (), {}))]
    assert not len(where(draw(blank(), found), TRUTH_COLOR))
    assert len(where(draw(blank(), found, with_truth=True), TRUTH_COLOR))


def test_a_reason_is_written_and_the_frame_left_as_it_was() -> None:
    frame = blank()
    picture = draw(
        frame, [(Instance((10, 60, 30, 30)), ArticulatedPose((NotSeen("base", "hidden by a hand"),), (), {}))]
    )
    assert len(where(picture, PART_COLORS[0]))
    assert not frame.color.any()


@pytest.mark.parametrize("z", [-1.0, 0.0, 0.01, 0.05, 1e6])
@pytest.mark.parametrize("x", [0.0, 0.3, -1e6])
def test_any_pose_can_be_drawn(x: float, z: float) -> None:
    keypoints = np.array([[0.0, 0, -1], [0, 0, 1e-12], [1e9, 0, 1]])
    picture = draw(blank(), [(Instance((-50, -50, 1000, 1000)), posed(at(x, 0, z), keypoints=keypoints))])
    assert picture.shape == (200, 200, 3)
