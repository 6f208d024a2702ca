"""Boxes tell their front from their back."""

from __future__ import annotations

import numpy as np

from page_training.scenes.box_closing import LidFront, fastening, hinge
from page_training.scenes.meshes import joined

GRAY = np.array([0.5, 0.5, 0.5])


def test_a_hinge_stands_out_behind_the_wall_and_turns_about_its_axis() -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        pivot = (0.04 + float(rng.uniform(-0.0015, 0.003)), 0.03)
        base, lid = hinge(rng, 0.2, 0.04, pivot, GRAY)
        vertices = joined(base + lid).vertices
        assert vertices[:, 1].max() > 0.0412
        assert np.abs(vertices[:, 0]).max() <= 0.1
        for barrel in lid:
            # What turns with the lid must stay where it is as it turns.
            around = np.linalg.norm(barrel.vertices[:, 1:] - pivot, axis=1)
            assert around.max() < 0.008


def test_there_is_always_a_fastening_in_front() -> None:
    edge = LidFront(x=0.01, y=-0.041, width=0.19, underside=0.03, thickness=0.004)
    places = set()
    for seed in range(60):
        base, lid = fastening(np.random.default_rng(seed), GRAY, (-0.04, 0.03), edge)
        places.add((bool(base), bool(lid)))
        for meshes, front in ((base, -0.04), (lid, edge.y)):
            if meshes:
                assert joined(meshes).vertices[:, 1].min() < front - 0.0005
    assert places == {(True, False), (False, True), (True, True)}
