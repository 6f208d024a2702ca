"""page-runtime: the pose of every part of articulated objects, frame by frame.

Nothing heavy is imported here: a command's modules are loaded when it is asked for, after the environment that OpenCV
and numpy's BLAS read when they are loaded was set.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from page_runtime.capture.layouts import LAYOUTS, WINDOW_S
from page_runtime.commands.usage import UsageError
from page_runtime.providers import PROVIDERS, ProviderChoice

EXIT_BAD_INPUT = 2
EXIT_NO_CAMERA = 3
EXIT_INTERRUPTED = 130
# Commands that share a module with another.
MODULES = {"convert": "record"}


class Parser(argparse.ArgumentParser):
    """Reports errors as a sentence, without the usage text before it."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see {self.prog} --help")


def main(arguments: list[str] | None = None) -> int:
    """Run page-runtime; returns the exit code: 0 done, 2 bad input (no file was written), 3 no camera, 130
    interrupted."""
    try:
        options = vars(_parser().parse_args(arguments))
        command = options.pop("command")
        if "provider" in options:
            options["on"] = _provider_choice(options)
        _prepare()
        with _termination_as_interrupt():
            return _call(command, options)
    except UsageError as error:
        return _refuse(error)
    except KeyboardInterrupt:
        sys.stderr.write("page-runtime: interrupted\n")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Whoever read the lines has enough; without this the interpreter would complain when it closes stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _call(command: str, options: dict[str, object]) -> int:
    """The command's function with its options; errors in what it was given become one sentence."""
    from importlib import import_module

    from page_runtime.bundle import BundleError
    from page_runtime.capture.frame_service import DeviceUnavailable
    from page_runtime.image_files import SourceError

    try:
        getattr(import_module(f"page_runtime.commands.{MODULES.get(command, command)}"), command)(**options)
    except DeviceUnavailable as error:
        return _refuse(error, code=EXIT_NO_CAMERA)
    except (BundleError, SourceError) as error:
        return _refuse(error)
    except BrokenPipeError:
        raise
    except OSError as error:
        return _refuse(error)
    return 0


def _refuse(error: Exception, *, code: int = EXIT_BAD_INPUT) -> int:
    sys.stderr.write(f"page-runtime: {' '.join(str(error).split())}\n")
    return code


def _prepare() -> None:
    """Set what OpenCV and numpy's BLAS read once, when they are loaded.

    The scorer's matrices are small: a second BLAS thread costs more in waiting than it computes, and takes a core from
    onnxruntime (91 ms a frame against 54 on two cores).
    """
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"


@contextmanager
def _termination_as_interrupt() -> Iterator[None]:
    """SIGTERM ends a command as Ctrl-C does: cameras are closed, files finished."""

    def interrupt(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="page-runtime", description="The 6D pose of every part of articulated objects in RGB-D.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")

    def command(name: str, description: str, given: str, meaning: str, kind: type = str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=description, description=description)
        sub.add_argument(given, metavar=given.upper(), type=kind, help=meaning)
        return sub

    def pairs(sub: argparse.ArgumentParser) -> None:
        sub.add_argument(
            "--window-ms", metavar="MS", dest="window_s", type=_milliseconds, default=WINDOW_S, help=window_help
        )

    def limited(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--frames", metavar="N", type=_count, default=0, help="stop after N frames (default: all)")

    def common(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--bundle", metavar="B", type=Path, required=True, help="the category's .onnx file")
        sub.add_argument("--threads", metavar="N", type=_count, default=0, help="at most N threads (default: all)")
        sub.add_argument("--looks", metavar="N", type=_count, default=3, help=looks_help)
        sub.add_argument("--quiet", action="store_true", help="no progress on standard error")
        sub.add_argument("--provider", choices=PROVIDERS, default="auto", help=provider_help)
        provider_option_help = "of the provider, as onnxruntime names it; may be given several times"
        sub.add_argument(
            "--provider-option", metavar="KEY=VALUE", action="append", default=[], help=provider_option_help
        )
        require_help = "end with an error where the provider cannot run all of the network"
        sub.add_argument("--require-provider", action="store_true", help=require_help)
        pairs(sub)

    window_help = "colour and depth at most MS apart are a frame, where readings are stored or live (default: 20)"
    source_help = "a folder or file of RGB-D frames, or a camera: oak, oak:DEVICE"
    provider_help = "what onnxruntime runs the network on (default: auto, the best it has)"
    looks_help = "at most N looks at a frame whose poses are unlikely (default: 3; 1: all frames take the same time)"
    overlay_help = "write a picture of every frame into DIR: boxes, axes, keypoints, reasons"
    run = command("run", "write one JSON line for every object in every frame", "source", source_help)
    limited(run)
    region_help = "where the object is, px (--region=-5,3,10,10 for a minus first); default: where the source says"
    run.add_argument("--region", metavar="X,Y,W,H", type=_region, help=region_help)
    run.add_argument("--out", metavar="FILE", type=Path, help="write the lines here instead of to standard output")
    run.add_argument("--overlay", metavar="DIR", type=Path, help=overlay_help)
    common(run)
    validate = command("validate", "compare with the truth of a recording", "recording", "a folder with true poses")
    validate.add_argument("--json", metavar="FILE", type=Path, help="write the figures here")
    validate.add_argument("--overlay", metavar="DIR", type=Path, help=f"{overlay_help}, and the true boxes")
    common(validate)
    bench = command("bench", "time every stage", "recording", "a folder of RGB-D frames with regions")
    bench.add_argument("--json", metavar="FILE", type=Path, help="write the figures here")
    common(bench)
    inspect = command("inspect", "say what a bundle holds", "bundle", "a .onnx file", Path)
    inspect.add_argument("--json", dest="as_json", action="store_true", help="as the JSON document inside it")
    devices = commands.add_parser("devices", help="list the cameras", description="list the cameras that answer")
    devices.add_argument("--json", dest="as_json", action="store_true", help="as a JSON list")
    record = command("record", "write the frames of a camera or recording as they come", "source", source_help)
    record.add_argument("target", metavar="TARGET", type=Path, help="a new .mcap file, or a new folder (recording)")
    convert = command("convert", "write a recording in another layout", "source", "a folder or file of RGB-D frames")
    convert.add_argument("target", metavar="TARGET", type=Path, help="a new .mcap file or folder")
    convert.add_argument("--layout", choices=LAYOUTS, help="of TARGET (default: mcap for .mcap, else recording)")
    fps_help = "so many frames a second, for data sets whose frames have no times"
    convert.add_argument("--fps", metavar="N", type=float, help=fps_help)
    for sub in (record, convert):
        limited(sub)
        pairs(sub)
        sub.add_argument("--quiet", action="store_true", help="no progress on standard error")
    repair_help = "make a whole recording of one that was cut short or damaged"
    repair = command("repair", repair_help, "recording", "an .mcap file, a bag, or .NAME.partial", Path)
    repair.add_argument("--out", metavar="PATH", type=Path, help="its name (default: NAME.repaired beside it)")
    return parser


def _provider_choice(options: dict[str, Any]) -> ProviderChoice:
    """Of the three options about the provider, which it takes out."""
    pairs = [text.partition("=") for text in options.pop("provider_option")]
    for key, sign, _ in pairs:
        if not key or not sign:
            raise UsageError(f"--provider-option: expected KEY=VALUE, got {key}")
    values = {key: value for key, _, value in pairs}
    return ProviderChoice(options.pop("provider"), values, options.pop("require_provider"))


def _milliseconds(text: str) -> float:
    try:
        value = float(text) * 1e-3
    except ValueError:
        value = -1.0
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected milliseconds from 0 on, got {text!r}")
    return value


def _region(text: str) -> tuple[int, int, int, int]:
    try:
        x, y, width, height = (int(value) for value in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected four whole numbers x,y,w,h in pixels, got {text!r}") from None
    return x, y, width, height


def _count(text: str) -> int:
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"expected a whole number from 0 on, got {text!r}")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
