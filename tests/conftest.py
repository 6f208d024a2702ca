"""Fixtures that several tests share: the toy's recording with the bundle that knows it, followed boxes, own models."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import followed_boxes
import toy

if TYPE_CHECKING:
    from page_runtime import Network
    from page_runtime.recorded import RecordedFrame
    from page_runtime.sampling import RegionSample
    from page_training.own.model import OwnModel

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def toy_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames of the toy box; the second has no depth. Read only."""
    return toy.write_toy_recording(tmp_path_factory.mktemp("recording") / "toy", frames=3, blind=(1,))


@pytest.fixture(scope="session")
def long_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pieces of work for validation. Read only."""
    return toy.write_long_recording(tmp_path_factory.mktemp("long") / "toy")


@pytest.fixture(scope="session")
def oracle_bundle(tmp_path_factory: pytest.TempPathFactory, toy_recording: Path) -> Path:
    """A bundle that knows the poses in toy_recording. Read only."""
    from page_runtime import open_source

    recorded = open_source(toy_recording).entries[0].read()
    region = recorded.instances[0].region
    assert region is not None
    path = tmp_path_factory.mktemp("bundles") / "box.onnx"
    return toy.write_oracle_bundle(path, recorded.frame, region, toy.part_poses())


@pytest.fixture(scope="session")
def toy_sample(oracle_bundle: Path, toy_recording: Path) -> tuple[Network, RegionSample, RecordedFrame]:
    """The toy's bundle, its first frame and the points of the object's region. Read only."""
    from page_runtime import Network, open_source
    from page_runtime.estimator import sample_for
    from page_runtime.sampling import RegionSample

    network = Network(oracle_bundle, threads=1)
    recorded = open_source(toy_recording).entries[0].read()
    region = recorded.instances[0].region
    assert region is not None
    sample = sample_for(network.metadata, recorded.frame, region)
    assert isinstance(sample, RegionSample)
    return network, sample, recorded


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Private test material; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("PAGE_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("no shared data: set PAGE_SHARED_DATA to its folder")
    return folder


@pytest.fixture(scope="session")
def network() -> Network:
    """The shipped network of boxes."""
    return followed_boxes.box_network()


@pytest.fixture(scope="session")
def frames(network: Network) -> list[RecordedFrame]:
    """Frames of boxes in which the network is right. Read only."""
    return followed_boxes.good_frames(network)


@pytest.fixture(scope="session")
def crane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A URDF of four moving parts and a lamp that is fixed to one. Read only."""
    from own_models import write_crane

    return write_crane(tmp_path_factory.mktemp("crane"))


@pytest.fixture(scope="session")
def cupboard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A joint file with meshes in millimetres. Read only."""
    from own_models import write_cupboard

    return write_cupboard(tmp_path_factory.mktemp("cupboard"))


@pytest.fixture(scope="session")
def crane_model(crane: Path) -> OwnModel:
    """What is read of the crane."""
    from page_training.own.urdf import read_urdf

    return read_urdf(crane)
