"""What a joint's limits do to poses and states: what they are sure of, and nothing to what they cannot explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from page_runtime.articulation import articulate
from page_runtime.category import JointKind
from page_runtime.joints import joint_state
from page_runtime.similarity import Similarities
from test_articulation import EXTENTS, SIGMAS, SIZE_M, chain, evidence, posed, random_pose


def test_a_state_beyond_its_limits_is_drawn_back() -> None:
    category = chain(("revolute",), limits=(0.0, 1.0))
    truth = posed(category, [1.15], random_pose(np.random.default_rng(5)))
    found = articulate(category, [evidence(T, SIGMAS) for T in truth])
    assert found.joints[0].value == pytest.approx(1.0, abs=0.02)
    within = articulate(category, [evidence(T, SIGMAS) for T in posed(category, [0.95], truth[0])])
    assert within.joints[0].value == pytest.approx(0.95, abs=1e-6)


@pytest.mark.parametrize(("kind", "state"), [("revolute", 2.2), ("revolute", -0.9), ("prismatic", 1.3)])
def test_parts_that_contradict_the_limits_are_left_alone_and_said_so(kind: JointKind, state: float) -> None:
    category = chain((kind,), limits=(0.0, 1.0))
    truth = posed(category, [state], random_pose(np.random.default_rng(5)))
    found = articulate(category, [evidence(T, SIGMAS) for T in truth])
    for part, T in zip(found.parts, truth, strict=True):
        assert part is not None
        np.testing.assert_allclose(part.T_camera_part, T, atol=1e-9)
    (joint,) = found.joints
    assert joint.value is None
    assert (
        joint.reason == "the poses of 0 and 1 contradict each other: no state within the joint's limits explains both"
    )
    assert joint.disagreement is not None
    assert joint.disagreement > 3.5


def test_a_limit_that_pushes_another_joint_out_holds_that_one_too() -> None:
    category = chain(("revolute", "revolute"), limits=(0.0, 1.0))
    for seed in range(10):
        truth = posed(category, [-0.3, 0.02], random_pose(np.random.default_rng(seed)))
        found = articulate(category, [evidence(T, SIGMAS) for T in truth])
        T = np.array([part.T_camera_part for part in found.parts if part is not None], np.float64)
        poses = Similarities(T[:, :3, :3], T[:, :3, 3], np.full(len(T), SIZE_M))
        for joint, state in zip(category.joints, found.joints, strict=True):
            pair = poses.take(np.array([joint.parent, joint.child]))
            assert joint_state(joint, pair, np.array([EXTENTS, EXTENTS]))[0] > -0.02
            assert state.value == pytest.approx(0.0, abs=0.02)


def test_a_limit_of_a_slide_is_as_sure_as_its_zero() -> None:
    sharp = chain(("prismatic",), limits=(0.0, 0.6))
    (joint,) = sharp.joints
    assert joint.geometry is not None
    vague = replace(joint, geometry=replace(joint.geometry, sigma_child=(0.002, 0.1, 0.002)))
    truth = posed(sharp, [-0.03], random_pose(np.random.default_rng(3)))
    given_ = [evidence(T, SIGMAS) for T in truth]
    moved = {}
    for name, one in (("sharp", joint), ("vague", vague)):
        found = articulate(replace(sharp, joints=(one,)), given_)
        assert found.parts[0] is not None
        moved[name] = float(np.linalg.norm(found.parts[0].T_camera_part[:3, 3] - truth[0][:3, 3]))
        state = found.joints[0]
        assert state.value == 0.0
        assert state.sigma is not None
        assert state.zero_sigma == pytest.approx(SIZE_M * np.hypot(0.002, 0.1 if name == "vague" else 0.002))
        assert state.sigma > state.zero_sigma
    assert moved["vague"] < 0.4 * moved["sharp"]
