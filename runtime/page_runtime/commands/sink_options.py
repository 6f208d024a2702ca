"""Where a live command's results go: its options, and the sinks they name. Imports nothing large before it must."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from page_runtime.category import Category
    from page_runtime.sinks.queue import Sinks
    from page_runtime.sinks.sink import Sink

STDOUT = Path("-")
MAX_PORT = 65535
Address = tuple[str, int]


@dataclass(frozen=True, slots=True)
class SinkOptions:
    """What `add_sink_options` adds, by the same names. out: STDOUT for standard output. web: the empty host for the
    loopback address."""

    out: Path | None = None
    udp: Address | None = None
    mcap: Path | None = None
    rrd: Path | None = None
    view: bool = False
    web: Address | None = None
    video: Path | None = None
    overlay: Path | None = None

    @property
    def new_files(self) -> dict[str, Path]:
        """The files to be written, by option."""
        named = {"--out": self.out, "--mcap": self.mcap, "--rrd": self.rrd, "--video": self.video}
        return {option: path for option, path in named.items() if path is not None and path != STDOUT}


def add_sink_options(parser: argparse.ArgumentParser) -> None:
    """The options of SinkOptions, each under its field's name."""
    group = parser.add_argument_group("where the results go", "any number of these at once; files must be new")
    add = group.add_argument
    add(
        "--out",
        metavar="FILE",
        type=Path,
        help="a JSON line for every result; - (the default): standard output",
    )
    add("--udp", metavar="HOST:PORT", type=_udp_address, help="every result as a datagram of JSON")
    add("--mcap", metavar="FILE", type=Path, help="frames, poses (TF), markers, joint states: a ROS 2 bag")
    add("--rrd", metavar="FILE", type=Path, help="a Rerun recording")
    add("--view", action="store_true", help="a Rerun viewer, live")
    add("--web", metavar="PORT", type=_web_address, help="a page for browsers on this computer (HOST:PORT for others)")
    add("--video", metavar="FILE", type=Path, help="the overlay as a video, .mkv (or .mp4)")
    add("--overlay", metavar="DIR", type=Path, help="the overlay as pictures, in a new folder")


def take_sink_options(options: dict[str, object]) -> SinkOptions:
    """Remove SinkOptions' fields from a command's parsed options."""
    return SinkOptions(**{name: options.pop(name) for name in SinkOptions.__slots__})  # type: ignore[arg-type]


def _udp_address(text: str) -> Address:
    host, colon, port = text.rpartition(":")
    if not colon or not host:
        raise argparse.ArgumentTypeError(f"expected HOST:PORT, got {text!r}")
    return host.strip("[]"), _port(port, lowest=1)


def _web_address(text: str) -> Address:
    host, _, port = text.rpartition(":")
    return host.strip("[]"), _port(port, lowest=0)


def _port(text: str, *, lowest: int) -> int:
    if not text.isascii() or not text.isdigit() or not lowest <= int(text) <= MAX_PORT:
        raise argparse.ArgumentTypeError(f"expected a port from {lowest} to {MAX_PORT}, got {text!r}")
    return int(text)


@contextmanager
def open_sinks(
    options: SinkOptions,
    *,
    tell: Callable[[str], None],
    category: Category | None = None,
    calibration: str | None = None,
    waits: Callable[[], bool] = lambda: False,
    reader_gone: Callable[[], None] | None = None,
) -> Iterator[Sinks]:
    """The sinks that the options name, running: `with open_sinks(...) as sinks: ... sinks.put(result)`.

    tell: takes a sentence from any thread: faults, addresses, what was passed over. category, calibration: of the
    objects and of the camera, for recordings. waits, reader_gone: as in `Sinks`. Raises UsageError or SourceError when
    a sink cannot be had, and then leaves no file behind.
    """
    from page_runtime.sinks.queue import Sinks

    _check(options)
    with ExitStack() as undo:
        made = [(sink, capacity) for sink, capacity in _made(options, undo, category, calibration)]
        undo.pop_all()
    for sink, _ in made:
        if sink.name.startswith("web "):
            tell(f"the page is at {sink.name.removeprefix('web ')}")
    with Sinks(made, tell=tell, waits=waits, reader_gone=reader_gone) as sinks:
        yield sinks


def _check(options: SinkOptions) -> None:
    """UsageError for what can be refused before anything is made."""
    from page_runtime.commands.outputs import require_file_place, require_folder_place
    from page_runtime.commands.usage import UsageError
    from page_runtime.sinks.video import SUFFIXES

    for option, path in options.new_files.items():
        require_file_place(path, option=option)
        if path.exists():
            raise UsageError(f"{option}: {path} exists already; nothing is ever overwritten, give another name")
    require_folder_place(options.overlay, option="--overlay")
    if options.video is not None and options.video.suffix.lower() not in SUFFIXES:
        raise UsageError(f"--video: expected a name that ends in {' or '.join(SUFFIXES)}, got {options.video}")
    if options.mcap is not None and options.mcap.suffix.lower() != ".mcap":
        raise UsageError(f"--mcap: expected a name that ends in .mcap, got {options.mcap}")


def _made(
    options: SinkOptions, undo: ExitStack, category: Category | None, calibration: str | None
) -> Iterator[tuple[Sink, int]]:
    """Each sink with the length of its queue; `undo` closes those made and removes their files."""
    from page_runtime.sinks.queue import EVERY, NEWEST

    for option, make, capacity in (
        ("--out", lambda: _lines(options.out), EVERY),
        ("--udp", lambda: _udp(options.udp), NEWEST),
        ("--mcap", lambda: _mcap(options.mcap, category, calibration), EVERY),
        ("--rrd", lambda: _rrd(options.rrd), EVERY),
        ("--web", lambda: _web(options.web), NEWEST),
        ("--video", lambda: _video(options.video), EVERY),
        ("--overlay", lambda: _overlay(options.overlay), EVERY),
        # Last: its window stays open whatever comes after it.
        ("--view", lambda: _viewer(options.view), NEWEST),
    ):
        sink = _opened(option, make)
        if sink is not None:
            path = options.new_files.get(option)
            if path is not None:
                undo.callback(path.unlink, missing_ok=True)
            undo.callback(sink.close)
            yield sink, capacity


def _opened(option: str, make: Callable[[], Sink | None]) -> Sink | None:
    from page_runtime.commands.usage import UsageError

    try:
        return make()
    except OSError as error:
        raise UsageError(f"{option}: {error.strerror or error}") from error


def _lines(out: Path | None) -> Sink | None:
    from page_runtime.sinks.json_lines import line_file, line_stdout

    if out is None:
        return None
    return line_stdout() if out == STDOUT else line_file(out)


def _udp(address: Address | None) -> Sink | None:
    from page_runtime.sinks.json_lines import UdpSink

    return None if address is None else UdpSink(*address)


def _mcap(path: Path | None, category: Category | None, calibration: str | None) -> Sink | None:
    from page_runtime.sinks.mcap import McapSink

    return None if path is None else McapSink(path, category=category, calibration=calibration)


def _rrd(path: Path | None) -> Sink | None:
    from page_runtime.sinks.rerun_log import RrdSink

    return None if path is None else RrdSink(path)


def _viewer(wanted: bool) -> Sink | None:
    from page_runtime.sinks.rerun_log import RerunViewer

    return RerunViewer() if wanted else None


def _web(address: Address | None) -> Sink | None:
    from page_runtime.sinks.web import LOOPBACK, WebSink

    return None if address is None else WebSink(address[1], host=address[0] or LOOPBACK)


def _overlay(path: Path | None) -> Sink | None:
    from page_runtime.sinks.overlay_folder import OverlayFolder

    return None if path is None else OverlayFolder(path)


def _video(path: Path | None) -> Sink | None:
    from page_runtime.sinks.video import VideoSink

    return None if path is None else VideoSink(path)
