"""Estimates that start from an expected pose are those of the search."""

from __future__ import annotations

import numpy as np
import pytest

from followed_boxes import PERIOD_S, ROOT, apart, region_of
from page_runtime import Network, RecordedFrame, estimator, open_source
from page_runtime.estimator import examine
from page_runtime.geometry import apply, invert
from page_runtime.live.advance import observation, trust
from page_runtime.live.locate import covered
from page_runtime.live.near import fit_near, pose_near
from page_runtime.live.prior import expected_region
from page_runtime.live.track import begun, prior_of
from page_runtime.live.vote_window import votes_near
from page_runtime.pose import PartPose
from page_runtime.scoring import score_keypoints
from page_runtime.stopwatch import Stopwatch


def test_the_estimate_from_an_expected_pose_is_that_of_the_search(
    network: Network, frames: list[RecordedFrame]
) -> None:
    frame = frames[0].frame
    seen = examine(network, frame, region_of(frames[0]), max_looks=1)
    assert seen.sample is not None
    assert seen.output is not None
    assert seen.labelled is not None
    category = network.metadata.category
    track = begun(0, category, observation(frame, seen.labelled, seen.pose), frame.camera, 0.0)
    prior = prior_of(track, frame.camera, PERIOD_S)
    near = pose_near(network.metadata, seen.sample, seen.output, prior, Stopwatch())
    rotation_rad, translation_m = apart(near, seen.pose)
    assert rotation_rad < np.radians(1.0)
    assert translation_m < 0.002
    assert abs(trust(near) - trust(seen.pose)) < 0.1
    region = expected_region(prior, category, frame.camera)
    assert region is not None
    assert covered(region_of(frames[0]), region) > 0.7
    colors = frame.color.reshape(-1, 3)[seen.sample.source_index]
    fitted = fit_near(category, seen.sample, colors, prior, Stopwatch())
    assert not isinstance(fitted, str)
    assert apart(fitted.pose, seen.pose)[0] < np.radians(3.0)
    repainted = fit_near(category, seen.sample, 255 - colors, prior, Stopwatch())
    assert isinstance(repainted, str)


def test_votes_around_a_place_are_those_of_the_scorer() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.1, 0.1, (300, 3)) + np.array([0.0, 0.0, 0.8])
    keypoints = np.array([[0.05, 0.02, 0.75], [-0.04, 0.1, 0.85], [0.0, -0.08, 0.8]])
    radii_m = np.linalg.norm(points[:, None] - keypoints, axis=2) + rng.normal(0.0, 0.002, (300, 3))
    radii_m[:20] = np.nan
    points, radii_m = points.astype(np.float32), radii_m.astype(np.float32)
    exact = score_keypoints(points, radii_m, voxel_m=0.005)
    near = votes_near(points, radii_m, keypoints + 0.003, voxel_m=0.005)
    for one, other in zip(near, exact, strict=True):
        assert other.gap == 0
        assert one.max_votes == other.max_votes
        np.testing.assert_allclose(one.peaks[0].voxel_camera, other.peaks[0].voxel_camera, atol=1e-9)
        assert one.gap == len(points) - one.max_votes
    (nothing, *_) = votes_near(points, np.full_like(radii_m, 9.0), keypoints, voxel_m=0.005)
    assert nothing.peaks == ()
    assert nothing.reason


def test_the_points_of_an_examined_region_are_those_of_the_look_whose_answer_was_taken(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Looks in a mirror among them: points as the camera has them, each on the part it is said to be of."""
    monkeypatch.setattr(estimator, "LOOK_AGAIN_BELOW", 2.0)
    category, later = network.metadata.category, 0
    for recorded in open_source(ROOT / "tests" / "data" / "box"):
        frame, first = recorded.frame, examine(network, recorded.frame, region_of(recorded), max_looks=1)
        found = examine(network, frame, region_of(recorded), max_looks=3)
        labelled = found.labelled
        assert labelled is not None
        assert first.labelled is not None
        later += not np.array_equal(labelled.pixels, first.labelled.pixels)
        rows, columns = np.divmod(labelled.pixels, frame.camera.width)
        seen = frame.camera.backproject(np.stack([columns, rows], axis=-1), frame.depth_m[rows, columns])
        np.testing.assert_allclose(labelled.points_camera, seen, atol=1e-5)
        for part, own in zip(found.pose.parts, labelled.members, strict=True):
            if not isinstance(part, PartPose) or part.confidence < 0.7:
                continue
            points_part = apply(invert(part.T_camera_part), labelled.points_camera[own])
            assert np.mean(np.abs(points_part) <= 0.5 * part.extents_m + 0.02) > 0.9
        assert len(labelled.members) == len(category.parts)
    assert later
