"""The commands that calibrate: what they write, and what they say of what they cannot use."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from board_views import LENS, SIZE, TRUE, calibrated, pictures, views
from page_calibration.cli import main
from page_calibration.formats.registry import read_calibration
from page_calibration.views import distinct_views

# --- commands ------------------------------------------------------------------------------------------------------


BOARD_ARGUMENTS = ["--squares", "9x6", "--square-mm", "30", "--marker-mm", "22"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("boards") / "pictures"
    path.mkdir()
    for i, (_, picture) in enumerate(pictures()):
        cv2.imwrite(str(path / f"{i:02d}.png"), picture)
    cv2.imwrite(str(path / "empty.png"), np.full(SIZE[::-1], 90, np.uint8))
    return path


def test_the_camera_command_writes_camera_json_and_a_report_to_look_at(
    tmp_path: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, report = tmp_path / "camera.json", tmp_path / "report.html"
    arguments = ["camera", str(folder), *BOARD_ARGUMENTS, "-o", str(out), "--report", str(report), "--name", "color"]
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert "The focal length is known to" in printed.out
    assert "empty: no board found" in printed.err
    read = read_calibration(out)["color"]
    assert abs(read.camera.K[0, 0] - 620.0) < 0.003 * 620
    assert read.deviations is not None
    page = report.read_text()
    assert page.count("<circle") == sum(len(view.ids) for view in calibrated().views)
    for words in ("Where the corners were", "rms of views held out", "empty", "standard deviation"):
        assert words in page
    assert (
        main(["extrinsics", str(folder), "--camera", str(out), *BOARD_ARGUMENTS, "-o", str(tmp_path / "x.json")]) == 2
    )
    assert "must stand still" in capsys.readouterr().err
    assert not (tmp_path / "x.json").exists()


def test_a_video_gives_the_views_that_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "board.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, SIZE)
    for _, picture in pictures()[:10]:
        for _ in range(2):
            writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    out = tmp_path / "camera.json"
    code = main(["camera", str(path), *BOARD_ARGUMENTS, "-o", str(out), "--views", "9"])
    printed = capsys.readouterr()
    assert printed.err.count(" corners\n") == 9
    assert code == 0, printed.err
    assert abs(read_calibration(out)["camera"].camera.K[0, 0] - 620.0) < 0.01 * 620


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["camera", "{folder}", "--squares", "5x4", "--square-mm", "30", "--marker-mm", "22", "--dictionary", "4X4_50"],
         "is in none of"),
        (["camera", "{folder}", "--squares", "9x6", "--square-mm", "30", "--marker-mm", "33"], "less than a square"),
        (["camera", "{folder}", "--squares", "9x6", "--square-mm", "30", "--marker-mm", "22", "--dictionary", "9X9"],
         "no '9X9' in OpenCV"),
        (["camera", "{folder}", "--squares", "9by6", "--square-mm", "30"], "expected WIDTHxHEIGHT"),
        (["camera", "nowhere", *BOARD_ARGUMENTS], "expected a folder of pictures, a video file"),
    ],
)  # fmt: skip
def test_what_cannot_be_calibrated_is_a_sentence_and_exit_code_2(
    tmp_path: Path, folder: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    few = tmp_path / "few"
    few.mkdir()
    for name in ("00.png", "01.png"):
        (few / name).write_bytes((folder / name).read_bytes())
    given = [argument.replace("{folder}", str(few)) for argument in arguments]
    assert main([*given, "-o", str(tmp_path / "c.json")]) == 2
    assert words in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "c.json").exists()


def test_convert_refuses_loss_unless_allowed_and_says_it_then(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "ros.json"
    D = LENS.coefficients.tolist()
    document = {
        "width": 640,
        "height": 480,
        "distortion_model": "plumb_bob",
        "D": D,
        "K": TRUE.camera.K.ravel().tolist(),
    }
    source.write_text(json.dumps(document))
    out = tmp_path / "open3d.json"
    assert main(["convert", str(source), "--to", "open3d", "-o", str(out)]) == 2
    assert "open3d cannot hold the brown-conrady distortion" in capsys.readouterr().err
    assert not out.exists()
    assert main(["convert", str(source), "--to", "open3d", "-o", str(out), "--allow-loss"]) == 0
    assert "not in open3d.json: the brown-conrady distortion" in capsys.readouterr().err
    assert main(["convert", str(source), "-o", str(out), "--delivered", "320x200"]) == 0
    np.testing.assert_allclose(read_calibration(out).cameras[0].camera.K, TRUE.covering(320, 200).camera.K)
    assert main(["inspect", str(out)]) == 0
    assert "picture  320x200" in capsys.readouterr().out


def test_a_printed_board_is_in_millimetres(tmp_path: Path) -> None:
    assert main(["board", *BOARD_ARGUMENTS, "-o", str(tmp_path / "board.svg")]) == 0
    text = (tmp_path / "board.svg").read_text()
    assert 'width="330mm" height="240mm"' in text
    assert 'width="270" height="180"' in text


def test_repeated_views_count_once() -> None:
    assert distinct_views([*views(), *views()], SIZE[0]) == distinct_views(views(), SIZE[0]) >= 12
