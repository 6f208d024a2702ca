"""A page for any browser: the picture with its overlay, tables and curves, and the last results to look back at.

One HTML file, which loads nothing from elsewhere, by the standard library's HTTP server. New results come as
server-sent events; a browser that is slow, or was away, gets the newest.

    /               the page                    /events             every new result, as JSON
    /history        the results that are kept   /picture/SEQ.jpg    the picture of one of them
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

import cv2
import numpy as np

from page_runtime.image_files import encode_jpeg
from page_runtime.live.result import LiveResult
from page_runtime.overlay import PART_COLORS
from page_runtime.schema import result_record
from page_runtime.sinks.picture import picture_of

LOOPBACK = "127.0.0.1"
# Ten seconds at 24 results a second; 44 to 109 kB each at 640 x 480.
HISTORY = 240
MAX_WIDTH_PX = 960
MAX_STREAMS = 16
# A stream without news sends an empty comment, by which a browser that has gone is noticed.
IDLE_S = 5.0
SEND_TIMEOUT_S = 5.0
SECURITY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src 'self' blob: data:; "
    "connect-src 'self' blob:; base-uri 'none'; form-action 'none'"
)


@dataclass(frozen=True, eq=False, slots=True)
class _Shown:
    """One result as the page takes it."""

    seq: int
    line: str
    jpeg: bytes


class _History:
    """The last results, and a way to wait for the next one."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.closed = False
        self._kept: deque[_Shown] = deque(maxlen=HISTORY)

    def add(self, shown: _Shown) -> None:
        with self.changed:
            self._kept.append(shown)
            self.changed.notify_all()

    def kept(self) -> list[_Shown]:
        with self.changed:
            return list(self._kept)

    def of(self, seq: int) -> _Shown | None:
        """The result of that number, None where it is not kept any more, or not there yet."""
        with self.changed:
            at = seq - self._kept[0].seq if self._kept else -1
            return self._kept[at] if 0 <= at < len(self._kept) else None

    def after(self, seq: int, *, timeout_s: float) -> _Shown | None:
        """The newest result when it is newer than `seq`, waiting for one; None when none came."""
        with self.changed:
            self.changed.wait_for(lambda: self.closed or (self._kept and self._kept[-1].seq > seq), timeout=timeout_s)
            return self._kept[-1] if self._kept and self._kept[-1].seq > seq and not self.closed else None

    def close(self) -> None:
        with self.changed:
            self.closed = True
            self.changed.notify_all()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, address: tuple[str, int], history: _History) -> None:
        super().__init__(address, _Handler)
        self.history = history
        self.page = _page()
        self.streams = threading.Semaphore(MAX_STREAMS)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that goes away in the middle is no fault; anything else is the base class's business."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)


def _page() -> bytes:
    text = files("page_runtime.sinks").joinpath("page.html").read_text(encoding="utf-8")
    colors = ["#" + bytes(color).hex() for color in PART_COLORS]
    return text.replace("__SETTINGS__", json.dumps({"history": HISTORY, "part_colors": colors})).encode()


class _Handler(BaseHTTPRequestHandler):
    server: _Server  # pyright: ignore[reportIncompatibleVariableOverride]
    protocol_version = "HTTP/1.1"
    timeout = SEND_TIMEOUT_S

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: requests are no news."""

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if not self._is_meant():
            self._answer(b"not a name of this server", "text/plain", status=HTTPStatus.FORBIDDEN)
        elif path == "/":
            self._answer(self.server.page, "text/html; charset=utf-8")
        elif path == "/history":
            body = "[" + ",".join(shown.line for shown in self.server.history.kept()) + "]"
            self._answer(body.encode(), "application/json")
        elif path == "/events":
            self._stream()
        else:
            shown = self._numbered(path)
            if shown is None:
                self._answer(b"not here, or not kept any more", "text/plain", status=HTTPStatus.NOT_FOUND)
            else:
                self._answer(shown.jpeg, "image/jpeg", cache="max-age=600, immutable")

    def _is_meant(self) -> bool:
        """On the loopback address only its own names are answered: a page elsewhere may point a name of its own at it
        (DNS rebinding) and would read the camera."""
        if self.server.server_address[0] != LOOPBACK:
            return True
        # At port 80 browsers leave the port out.
        return self.headers.get("Host", "").partition(":")[0] in (LOOPBACK, "localhost")

    def _numbered(self, path: str) -> _Shown | None:
        name = path.removeprefix("/picture/").removesuffix(".jpg")
        is_picture = path == f"/picture/{name}.jpg" and name.isascii() and name.isdigit()
        return self.server.history.of(int(name)) if is_picture else None

    def _answer(self, body: bytes, kind: str, *, status: HTTPStatus = HTTPStatus.OK, cache: str = "no-store") -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", cache)
        self.send_header("Content-Security-Policy", SECURITY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(body)

    def _stream(self) -> None:
        if not self.server.streams.acquire(blocking=False):
            self._answer(b"too many browsers", "text/plain", status=HTTPStatus.SERVICE_UNAVAILABLE)
            return
        try:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.close_connection = True
            history, seq = self.server.history, -1
            while not history.closed:
                shown = history.after(seq, timeout_s=IDLE_S)
                self.wfile.write(b":\n\n" if shown is None else f"data: {shown.line}\n\n".encode())
                self.wfile.flush()
                seq = seq if shown is None else shown.seq
        finally:
            self.server.streams.release()


class WebSink:
    """Serves the page at `url` from now on. port 0: any that is free."""

    def __init__(self, port: int, *, host: str = LOOPBACK) -> None:
        """OSError when the port cannot be had."""
        self._history = _History()
        self._server = _Server((host, port), self._history)
        self._run = f"{time.time():.3f}"
        self._seq = 0
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), name="web", daemon=True)
        self._thread.start()

    @property
    def name(self) -> str:
        return f"web {self.url}"

    @property
    def url(self) -> str:
        """Where the page is."""
        host, port = self._server.server_address[:2]
        return f"http://{host}:{port}/"

    def write(self, result: LiveResult) -> None:
        """Draw one result and keep it; browsers fetch it when they can."""
        picture = picture_of(result)
        height, width = picture.shape[:2]
        if width > MAX_WIDTH_PX:
            size = MAX_WIDTH_PX, round(height * MAX_WIDTH_PX / width)
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
        record = {"seq": self._seq, "run": self._run, "clock_s": time.monotonic(), **result_record(result)}
        self._history.add(_Shown(self._seq, json.dumps(record, allow_nan=False), encode_jpeg(picture)))
        self._seq += 1

    def close(self) -> None:
        """End the streams and give the port back."""
        self._history.close()
        self._server.shutdown()
        self._server.server_close()
