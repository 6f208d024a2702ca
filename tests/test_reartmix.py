"""The real ReArtMix sample against its own depth: are poses, boxes and canonical frames what the reader says?

Private data: skipped where it is absent.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from page_runtime.capture.playback import open_source
from page_runtime.geometry import Array, apply, invert, rotation_angle
from page_runtime.recorded import PartTruth


@dataclass(frozen=True, eq=False, slots=True)
class Seen:
    """An annotated part: points_part (n,3) of the depth inside its polygon, and the rotation it was annotated with."""

    truth: PartTruth
    points_part: Array
    R_camera_rest: Array


@pytest.fixture(scope="module")
def folder(shared_data: Path) -> Path:
    path = shared_data / "reartmix_box"
    if not path.is_dir():
        pytest.skip("no ReArtMix sample in the shared data")
    return path


@pytest.fixture(scope="module")
def instances(folder: Path) -> list[tuple[Seen, Seen]]:
    source = open_source(folder)
    annotations = sorted((folder / "annotations").rglob("*.json"))
    found = []
    for recorded, file in list(zip(source, annotations, strict=True))[::4]:
        frame = recorded.frame
        for instance, entry in zip(recorded.instances, json.loads(file.read_text())["instances"], strict=True):
            seen = []
            for truth, link in zip(instance.truths or (), entry["links"], strict=True):
                mask = np.zeros(frame.depth_m.shape, np.uint8)
                for polygon in link["segmentation"]:
                    cv2.fillPoly(mask, [np.reshape(polygon, (-1, 2)).astype(np.int32)], (1,))
                rows, columns = np.nonzero((mask > 0) & (frame.depth_m > 0))
                pixels = np.stack([columns, rows], axis=1).astype(float)
                points = frame.camera.backproject(pixels, frame.depth_m[rows, columns])
                matrix = np.array(link["transformation"])[:3, :3]
                R_camera_rest = matrix / np.cbrt(np.linalg.det(matrix))
                seen.append(Seen(truth, apply(invert(truth.T_camera_part), points), R_camera_rest))
            found.append((seen[0], seen[1]))
    return found


def test_depth_inside_each_polygon_lies_in_the_parts_box(instances: list[tuple[Seen, Seen]]) -> None:
    for k in (0, 1):
        inside = [(np.abs(pair[k].points_part) <= pair[k].truth.extents_m / 2 + 0.01).all(axis=1) for pair in instances]
        assert np.concatenate(inside).mean() > 0.995
        assert min(share.mean() for share in inside) > 0.97


def test_the_base_opens_upwards_and_the_camera_looks_down_on_it(instances: list[tuple[Seen, Seen]]) -> None:
    for base, _ in instances:
        T = base.truth.T_camera_part
        assert T[:3, 2] @ T[:3, 3] < 0


def test_the_joint_state_is_what_the_parts_have_turned_from_lying_flat(instances: list[tuple[Seen, Seen]]) -> None:
    for base, lid in instances:
        state = lid.truth.joint_state
        assert state is not None
        assert np.radians(-5) < state < np.radians(205)
        turned = float(rotation_angle(base.R_camera_rest, lid.R_camera_rest))
        assert abs(np.pi - state) == pytest.approx(turned, abs=np.radians(0.6))


def test_both_parts_run_along_the_hinge_and_meet_at_their_hinge_edges(instances: list[tuple[Seen, Seen]]) -> None:
    for base, lid in instances:
        T_base, T_lid = base.truth.T_camera_part, lid.truth.T_camera_part
        assert T_base[:3, 0] @ T_lid[:3, 0] > 0.999
        edges = [
            apply(seen.truth.T_camera_part, np.array([0.0, seen.truth.extents_m[1] / 2, 0.0])) for seen in (base, lid)
        ]
        far = [
            apply(seen.truth.T_camera_part, np.array([0.0, -seen.truth.extents_m[1] / 2, 0.0])) for seen in (base, lid)
        ]
        assert np.linalg.norm(edges[0] - edges[1]) < 0.04
        assert np.linalg.norm(edges[0] - edges[1]) < np.linalg.norm(edges[0] - far[1])
        assert np.linalg.norm(edges[0] - edges[1]) < np.linalg.norm(far[0] - edges[1])


def test_an_open_lid_stands_above_the_base_with_its_outside_away_from_the_inside(
    instances: list[tuple[Seen, Seen]],
) -> None:
    for base, lid in instances:
        T_base_lid = invert(base.truth.T_camera_part) @ lid.truth.T_camera_part
        state = lid.truth.joint_state
        assert state is not None
        # Outwards is up when closed, towards the hinge's side when upright, down when flat.
        np.testing.assert_allclose(T_base_lid[1:3, 2], [np.sin(state), np.cos(state)], atol=0.02)
        front_edge = apply(T_base_lid, np.array([0.0, -lid.truth.extents_m[1] / 2, 0.0]))
        if np.radians(30) < state < np.radians(150):
            assert front_edge[2] > T_base_lid[2, 3] > 0
