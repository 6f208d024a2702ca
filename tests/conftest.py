"""Fixtures that several tests share: the toy's recording and the bundle that knows it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import toy

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def toy_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames of the toy box; the second has no depth. Read only."""
    return toy.write_toy_recording(tmp_path_factory.mktemp("recording") / "toy", frames=3, blind=(1,))


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
def shared_data() -> Path:
    """Private test material; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("PAGE_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("no shared data: set PAGE_SHARED_DATA to its folder")
    return folder
