"""page-runtime as a user meets it: what it writes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import toy
from page_runtime import open_source
from page_runtime.bench import time_estimates
from page_runtime.cli import _parser, main
from page_runtime.estimator import MAX_LOOKS
from page_runtime.network import Network
from page_runtime.recorded import Instance, RecordedFrame
from page_runtime.recording import RecordingWriter

STAGES = {"sampling", "network", "scoring", "registration", "icp", "articulation"}


def run_lines(recording: Path, bundle: Path, out: Path, *more: str) -> list[dict[str, Any]]:
    assert main(["run", str(recording), "--bundle", str(bundle), "--out", str(out), *more]) == 0
    return [json.loads(line) for line in out.read_text().splitlines()]


def test_run_writes_a_line_a_frame_with_the_pose_of_every_part(
    toy_recording: Path, oracle_bundle: Path, tmp_path: Path
) -> None:
    first, _, last = run_lines(toy_recording, oracle_bundle, tmp_path / "o.jsonl")
    assert list(first) == ["frame", "timestamp_s", "parts", "joints", "looks", "stage_ms"]
    assert (first["frame"], last["frame"]) == (0, 2)
    assert set(first["stage_ms"]) == STAGES
    for part, name, T_true, extents in zip(
        first["parts"], ("base", "lid"), toy.part_poses(), toy.EXTENTS_M, strict=True
    ):
        assert list(part) == ["name", "T_camera_part", "extents_m", "keypoints_camera", "confidence", "reason"]
        assert part["name"] == name
        assert part["reason"] is None
        np.testing.assert_allclose(part["T_camera_part"], T_true, atol=1e-4)
        np.testing.assert_allclose(part["extents_m"], extents, atol=1e-4)
        assert np.shape(part["keypoints_camera"]) == (len(toy.KEYPOINTS_UNIT), 3)
    (hinge,) = first["joints"]
    assert list(hinge) == ["name", "kind", "value", "sigma", "unit", "limits", "reason"]
    assert (hinge["name"], hinge["unit"], hinge["reason"]) == ("hinge", "rad", None)
    assert abs(hinge["value"] - toy.STATE_RAD) < 1e-3


def test_a_frame_without_depth_says_so_for_every_part_and_the_next_one_is_estimated(
    toy_recording: Path, oracle_bundle: Path, tmp_path: Path
) -> None:
    _, blind, last = run_lines(toy_recording, oracle_bundle, tmp_path / "o.jsonl")
    assert blind["joints"][0]["value"] is None
    assert blind["joints"][0]["reason"].startswith("not seen")
    for part in blind["parts"]:
        assert part["reason"].startswith("not seen")
        assert part["T_camera_part"] is part["extents_m"] is part["keypoints_camera"] is None
        assert part["confidence"] == 0
    assert all(part["reason"] is None for part in last["parts"])


def test_several_objects_in_a_frame_are_lines_with_an_instance_and_one_without_a_region_a_reason(
    oracle_bundle: Path, tmp_path: Path
) -> None:
    recorded, _ = toy.toy_frame()
    (known,) = recorded.instances
    with RecordingWriter(tmp_path / "r", category="box", part_names=("base", "lid")) as writer:
        writer.write(RecordedFrame(recorded.frame, (known, Instance(None))))
        writer.write(RecordedFrame(recorded.frame))
    lines = run_lines(tmp_path / "r", oracle_bundle, tmp_path / "o.jsonl", "--overlay", str(tmp_path / "pictures"))
    assert [(line["frame"], line.get("instance")) for line in lines] == [(0, 0), (0, 1), (1, 0)]
    assert [line["parts"][0]["reason"] is None for line in lines] == [True, False, False]
    assert "--region" in lines[1]["parts"][0]["reason"]
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir()) == ["000000.jpg", "000001.jpg"]


def test_a_region_given_takes_the_place_of_the_sources_own(
    toy_recording: Path, oracle_bundle: Path, tmp_path: Path
) -> None:
    (line, *_) = run_lines(toy_recording, oracle_bundle, tmp_path / "o.jsonl", "--region", "0,0,4,4")
    assert all(part["reason"] is not None for part in line["parts"])


def test_a_region_may_begin_with_a_minus_sign(toy_recording: Path, oracle_bundle: Path, tmp_path: Path) -> None:
    lines = run_lines(toy_recording, oracle_bundle, tmp_path / "o.jsonl", "--region=-5,0,330,240")
    assert [line["parts"][0]["reason"] is None for line in lines] == [True, False, True]


def test_pictures_go_into_a_folder_there_is_without_leaving_its_file_system(
    toy_recording: Path, oracle_bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "mount point"
    folder.mkdir()
    (folder / "kept.txt").touch()
    moved = []
    replace = Path.replace

    def replace_on_one_file_system(self: Path, target: Path) -> Path:
        if folder in target.parents:
            assert folder in self.parents, "files cannot be moved from one file system to another"
            moved.append(target.name)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", replace_on_one_file_system)
    run_lines(toy_recording, oracle_bundle, tmp_path / "o.jsonl", "--overlay", str(folder))
    assert moved == ["000000.jpg", "000001.jpg", "000002.jpg"]
    assert sorted(path.name for path in folder.iterdir()) == [*moved, "kept.txt"]


def test_run_writes_to_standard_output_when_no_file_is_named(
    toy_recording: Path, oracle_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(toy_recording), "--bundle", str(oracle_bundle)]) == 0
    out, err = capsys.readouterr()
    assert [json.loads(line)["frame"] for line in out.splitlines()] == [0, 1, 2]
    assert "frame 3 of 3" in err


def test_validate_reports_an_exact_network_as_exact_and_a_blind_frame_as_a_failure(
    toy_recording: Path, oracle_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["validate", str(toy_recording), "--bundle", str(oracle_bundle), "--json", str(tmp_path / "v.json")]
    assert main([*arguments, "--overlay", str(tmp_path / "pictures"), "--quiet"]) == 0
    document = json.loads((tmp_path / "v.json").read_text())
    assert document["frames"] == 3
    assert [part["name"] for part in document["parts"]] == ["base", "lid"]
    (hinge,) = document["joints"]
    assert hinge["unit"] == "deg"
    assert hinge["visible"] - hinge["missing"] > 0
    assert hinge["error"]["mean"] < 0.1
    for part in document["parts"]:
        assert part["rotation_deg"]["mean"] < 0.05
        assert part["translation_m"]["median"] < 1e-4
        assert part["iou"]["median"] > 0.99
        assert part["acc_5deg5cm"] == pytest.approx(2 / 3)
        assert part["failure_rate"] == pytest.approx(1 / 3)
    out, err = capsys.readouterr()
    assert re.search(r"base +3 +1 +0\.0", out)
    assert err == ""
    assert len(list((tmp_path / "pictures").iterdir())) == 3


def test_bench_reports_every_stage_beside_the_papers(
    toy_recording: Path, oracle_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["bench", str(toy_recording), "--bundle", str(oracle_bundle), "--json", str(tmp_path / "b.json")]
    assert main([*arguments, "--threads", "1"]) == 0
    document = json.loads((tmp_path / "b.json").read_text())
    assert set(document["stages"]) == STAGES
    for figures in (*document["stages"].values(), document["total"]):
        assert 0 < figures["p50_ms"] <= figures["p90_ms"] <= figures["p95_ms"] <= figures["p99_ms"]
    assert sum(stage["p50_ms"] for stage in document["stages"].values()) <= document["total"]["p95_ms"]
    assert document["threads"] == 1
    assert document["peak_rss_mb"] > 10
    assert {"python", "numpy", "onnxruntime"} <= set(document["versions"])
    # A third of the frames is blind; they are no measurements.
    assert document["measurements"] >= 100
    assert document["left_out"] * 2 == document["measurements"]
    assert document["cold_start"]["total_ms"] > document["cold_start"]["first_estimate_ms"] > 0
    assert len(document["recording_sha256"]) == len(document["bundle_sha256"]) == 64
    assert len(document["stability"]["windows_p50_ms"]) == 3
    said = capsys.readouterr().out
    assert re.search(r"total +[\d.]+ +[\d.]+ +[\d.]+ +[\d.]+ +160", said)
    assert f"the network runs on cpu ({document['operators']['cpu']} operators)" in said


def test_bench_times_a_region_where_the_recording_says_none(oracle_bundle: Path, tmp_path: Path) -> None:
    recorded, _ = toy.toy_frame()
    with RecordingWriter(tmp_path / "plain", category="box", part_names=("base", "lid")) as writer:
        writer.write(RecordedFrame(recorded.frame))
    (instance,) = recorded.instances
    assert instance.region is not None
    given = ["bench", str(tmp_path / "plain"), "--bundle", str(oracle_bundle), "--looks", "1", "--quiet"]
    region = ",".join(map(str, instance.region))
    assert main([*given, "--region", region, "--json", str(tmp_path / "b.json")]) == 0
    document = json.loads((tmp_path / "b.json").read_text())
    assert document["region"] == list(instance.region)
    assert document["left_out"] == 0
    assert set(document["stages"]) == STAGES
    assert document["cold_start"]["first_estimate_ms"] > 0


def test_bench_warms_up_on_frames_that_reach_the_network_and_counts_no_others(
    oracle_bundle: Path, tmp_path: Path
) -> None:
    source = open_source(toy.write_toy_recording(tmp_path / "r", frames=4, blind=(0, 1, 2)))
    totals: list[int] = []
    network = Network(oracle_bundle, threads=1)
    timings, left_out = time_estimates(network, source, min_measurements=3, on_frame=totals.append)
    assert (len(timings), left_out) == (3, 9)
    assert all(timing.stage_ms["registration"] > 0 for timing in timings)
    assert totals == [4] * 4 + [12] * 8
    blind = open_source(toy.write_toy_recording(tmp_path / "b", frames=2, blind=(0, 1)))
    assert time_estimates(network, blind) == ([], 2)


def test_inspect_says_all_the_metadata_in_words_and_as_json(
    oracle_bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(oracle_bundle)]) == 0
    words = capsys.readouterr().out
    for expected in ("origin: centre of the base's box", "lid against base", "0 to 180 deg", "oracle of a test"):
        assert expected in words
    assert main(["inspect", str(oracle_bundle), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["category"] == "box"
    assert [part["name"] for part in document["parts"]] == ["base", "lid"]


def test_the_program_runs_as_a_process_and_limits_its_threads(toy_recording: Path, oracle_bundle: Path) -> None:
    command = [sys.executable, "-m", "page_runtime", "run", str(toy_recording), "--bundle", str(oracle_bundle)]
    result = subprocess.run([*command, "--threads", "1", "--quiet"], capture_output=True, text=True, check=True)
    assert len(result.stdout.splitlines()) == 3
    assert result.stderr == ""


def test_a_reader_that_has_enough_is_no_error(toy_recording: Path, oracle_bundle: Path) -> None:
    command = f"{sys.executable} -m page_runtime run {toy_recording} --bundle {oracle_bundle} --quiet | head -n 1"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)
    assert len(result.stdout.splitlines()) == 1
    assert result.stderr == ""


def test_the_command_line_takes_as_many_looks_as_the_library() -> None:
    assert _parser().parse_args(["run", "R", "--bundle", "B"]).looks == MAX_LOOKS
