"""The page that shows results: what it serves, and what a browser makes of it."""

from __future__ import annotations

import http.client
import json
import re
import shutil
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from live_results import empty_result, results_of
from page_runtime.image_files import decode_color_picture
from page_runtime.live.result import LiveResult
from page_runtime.schema import result_record
from page_runtime.sinks import web
from page_runtime.sinks.picture import picture_of
from page_runtime.sinks.web import WebSink

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="module")
def results(toy_recording: Path, oracle_bundle: Path) -> list[LiveResult]:
    """Three frames; the second has no depth."""
    return list(results_of(toy_recording, oracle_bundle))


@pytest.fixture
def sink() -> Iterator[WebSink]:
    found = WebSink(0)
    yield found
    found.close()


def get(sink: WebSink, path: str, *, host: str | None = None) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(sink.url.removeprefix("http://").rstrip("/"), timeout=10)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    answer = connection.getresponse()
    found = answer.status, answer.read()
    connection.close()
    return found


def history(sink: WebSink) -> list[dict[str, Any]]:
    return json.loads(get(sink, "/history")[1])


def test_every_kept_result_is_its_line_of_json_and_its_picture(sink: WebSink, results: list[LiveResult]) -> None:
    for result in results:
        sink.write(result)
    records = history(sink)
    assert [record["seq"] for record in records] == [0, 1, 2]
    for record, result in zip(records, results, strict=True):
        assert result_record(result).items() <= record.items()
        status, jpeg = get(sink, f"/picture/{record['seq']}.jpg")
        shown = decode_color_picture(np.frombuffer(jpeg, np.uint8), where="picture")
        assert status == 200
        assert np.abs(shown.astype(float) - picture_of(result)).mean() < 4


def test_only_the_last_results_are_kept(sink: WebSink) -> None:
    for i in range(web.HISTORY + 5):
        sink.write(empty_result(i))
    assert [record["seq"] for record in history(sink)] == list(range(5, web.HISTORY + 5))
    assert get(sink, "/picture/4.jpg")[0] == 404
    assert get(sink, "/picture/5.jpg")[0] == 200


@pytest.mark.parametrize(
    "path", ["/etc/passwd", "/picture/../0.jpg", "/picture/x.jpg", "/picture/99.jpg", "/picture/-1.jpg"]
)
def test_nothing_else_is_served(sink: WebSink, path: str) -> None:
    sink.write(empty_result(0))
    assert get(sink, path)[0] == 404


def test_the_page_loads_nothing_from_elsewhere_and_only_this_computer_is_answered(sink: WebSink) -> None:
    status, page = get(sink, "/")
    assert status == 200
    assert not re.findall(rb"(?:src|href)=\"(?!data:)", page)
    assert b"http" not in page.replace(b"http-equiv", b"")
    assert sink.url.startswith("http://127.0.0.1:")
    port = sink.url.rstrip("/").rpartition(":")[2]
    assert get(sink, "/history", host=f"localhost:{port}")[0] == 200
    assert get(sink, "/history", host=f"camera.example:{port}")[0] == 403
    # At port 80 browsers leave it out.
    assert get(sink, "/history", host="localhost")[0] == 200
    assert get(sink, "/history", host="localhost.example")[0] == 403


def test_a_browser_that_reads_nothing_gets_the_newest_later_and_holds_nobody_up(sink: WebSink) -> None:
    host, port = sink.url.removeprefix("http://").rstrip("/").split(":")
    idle = socket.create_connection((host, int(port)))
    idle.sendall(f"GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
    gone = socket.create_connection((host, int(port)))
    gone.sendall(f"GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
    gone.close()
    for i in range(50):
        sink.write(empty_result(i))
    assert len(history(sink)) == 50
    idle.settimeout(5)
    text = ""
    while '"seq": 49' not in text:
        text += idle.recv(1 << 16).decode()
    idle.close()


def test_a_port_that_is_taken_is_an_error_and_a_closed_page_gives_it_back() -> None:
    first = WebSink(0)
    port = int(first.url.rstrip("/").rpartition(":")[2])
    with pytest.raises(OSError, match="in use"):
        WebSink(port)
    first.close()
    WebSink(port).close()
    assert not any(thread.name == "web" for thread in threading.enumerate())


def test_large_pictures_are_sent_smaller(sink: WebSink, results: list[LiveResult]) -> None:
    frame = results[0].frame
    camera = frame.camera.resized(1920, 1440)
    large = replace(
        frame,
        camera=camera,
        color=np.asarray(cv2.resize(frame.color, (1920, 1440)), np.uint8),
        depth_m=np.zeros((1440, 1920), np.float32),
    )
    sink.write(replace(results[0], frame=large, objects=()))
    jpeg = get(sink, "/picture/0.jpg")[1]
    assert decode_color_picture(np.frombuffer(jpeg, np.uint8), where="picture").shape == (720, 960, 3)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra dev)")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this computer: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


def table(page: Any, name: str) -> dict[str, list[str]]:
    """The cells of each row, by its part or joint."""
    return page.evaluate(
        "(name) => Object.fromEntries([...document.getElementById(name).tBodies[0].rows].map("
        "(row) => [row.dataset.part ?? row.dataset.joint, [...row.cells].map((cell) => cell.textContent)]))",
        name,
    )


def move_slider(page: Any, place: int) -> None:
    page.evaluate(
        "(place) => { const slider = document.getElementById('slider'); slider.value = place; "
        "slider.dispatchEvent(new Event('input')); }",
        place,
    )


def test_a_browser_shows_what_comes_and_the_slider_looks_back(
    sink: WebSink, results: list[LiveResult], browser: Any
) -> None:
    faults: list[str] = []
    page = browser.new_page()
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    for i in range(10):
        sink.write(replace(results[i % 3], latency_ms=10.0 + i))
    page.goto(sink.url)
    page.wait_for_selector('#picture[data-seq="9"]')
    sink.write(replace(results[2], latency_ms=77.0))
    page.wait_for_selector('#picture[data-seq="10"]')
    assert page.text_content("#latency") == "77 ms"
    assert page.text_content("#age") == "live"

    page.evaluate(
        "() => { const s = document.getElementById('slider'); s.value = 3; s.dispatchEvent(new Event('input')); }"
    )
    page.wait_for_selector('#picture[data-seq="3"]')
    size = page.evaluate(
        "() => [document.getElementById('picture').naturalWidth, document.getElementById('picture').naturalHeight]"
    )
    assert size == [results[0].frame.camera.width, results[0].frame.camera.height]
    record = history(sink)[3]
    assert page.text_content("#latency") == "13 ms"
    rows, joints = table(page, "parts"), table(page, "joints")
    (found,) = record["objects"]
    assert list(rows) == [f"0/{part['name']}" for part in found["parts"]]
    for part in found["parts"]:
        name, confidence, place, _, extents = rows[f"0/{part['name']}"]
        assert name == part["name"]
        assert float(confidence) == pytest.approx(part["confidence"], abs=0.0051)
        T = np.array(part["T_camera_part"])
        np.testing.assert_allclose([float(v) for v in place.split(",")], 1e3 * T[:3, 3], atol=0.051)
        sizes_mm = [float(v) for v in extents.split("\N{MULTIPLICATION SIGN}")]
        np.testing.assert_allclose(sizes_mm, 1e3 * np.array(part["extents_m"]), atol=0.51)
    (joint,) = found["joints"]
    assert float(joints["0/hinge"][1].split()[0]) == pytest.approx(np.degrees(joint["value"]), abs=0.051)

    # What comes while it is paused changes nothing, and a part without a pose says why.
    sink.write(results[0])
    page.evaluate(
        "() => { const s = document.getElementById('slider'); s.value = 4; s.dispatchEvent(new Event('input')); }"
    )
    page.wait_for_selector('#picture[data-seq="4"]')
    assert "not seen" in table(page, "parts")["0/base"][1]
    assert page.get_attribute("#slider", "max") == "10"
    page.click("#pause")
    page.wait_for_selector('#picture[data-seq="11"]')
    assert page.get_attribute("#slider", "max") == "11"
    assert faults == []
    page.close()


def test_a_page_says_when_nothing_is_found_and_when_the_server_is_gone(browser: Any) -> None:
    sink = WebSink(0)
    page = browser.new_page()
    page.goto(sink.url)
    sink.write(empty_result(0))
    page.wait_for_selector('#picture[data-seq="0"]')
    assert page.text_content("#reason") == "no object found: no depth reading in the frame"
    assert table(page, "parts") == {}
    sink.close()
    page.wait_for_function("() => document.getElementById('state').textContent === 'not connected'")
    page.close()
