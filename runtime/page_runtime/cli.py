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
from page_runtime.commands import argument_types as accept
from page_runtime.commands.bench_options import add_bench_options
from page_runtime.commands.live_options import add_live_options
from page_runtime.commands.sink_options import add_sink_options
from page_runtime.commands.usage import UsageError
from page_runtime.commands.validate_options import add_validate_options
from page_runtime.providers import PROVIDERS, NetworkError, ProviderChoice, ProviderError

EXIT_BAD_INPUT = 2
EXIT_NO_CAMERA = 3
EXIT_SOURCE_LOST = 4
EXIT_FRAMES_FAILING = 5
EXIT_INTERRUPTED = 130
# Commands that share a module with another.
MODULES = {"convert": "record"}


class Parser(argparse.ArgumentParser):
    """Reports errors as a sentence, without the usage text before it."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see {self.prog} --help")


def main(arguments: list[str] | None = None) -> int:
    """Run page-runtime; returns the exit code: 0 done, 1 `doctor` found a problem or `bench --compare` a slower run or
    none that proves anything, 2 bad input (no file was written), 3 no camera, 4 a camera that was lost, 5
    a loop in which every frame fails, 130 interrupted."""
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

    from page_runtime.bundle_fields import BundleError
    from page_runtime.capture.frame_service import DeviceUnavailable
    from page_runtime.capture.supervision import SourceLost
    from page_runtime.image_files import SourceError
    from page_runtime.live.faults import FramesFailing

    try:
        code = getattr(import_module(f"page_runtime.commands.{MODULES.get(command, command)}"), command)(**options)
    except DeviceUnavailable as error:
        return _refuse(error, code=EXIT_NO_CAMERA)
    except SourceLost as error:
        return _refuse(error, code=EXIT_SOURCE_LOST)
    except FramesFailing as error:
        return _refuse(error, code=EXIT_FRAMES_FAILING)
    except (BundleError, NetworkError, ProviderError, SourceError) as error:
        return _refuse(error)
    except BrokenPipeError:
        raise
    except OSError as error:
        return _refuse(error)
    return code or 0


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
            "--window-ms",
            metavar="MS",
            dest="window_s",
            type=accept.seconds_of_milliseconds,
            default=WINDOW_S,
            help=window_help,
        )

    def limited(sub: argparse.ArgumentParser) -> None:
        sub.add_argument(
            "--frames", metavar="N", type=accept.count, default=0, help="stop after N frames (default: all)"
        )

    def common(sub: argparse.ArgumentParser, *, several: bool = False, required: bool = True, looks: int = 3) -> None:
        bundle_help = (
            "the category's .onnx file; again for another category" if several else "the category's .onnx file"
        )
        kind = "append" if several else "store"
        sub.add_argument("--bundle", metavar="B", type=Path, required=required, action=kind, help=bundle_help)
        default = "1 a process, as figures depend on it a little" if several else "all"
        sub.add_argument(
            "--threads", metavar="N", type=accept.threads, default=0, help=f"at most N threads (default: {default})"
        )
        sub.add_argument("--looks", metavar="N", type=accept.count, default=looks, help=looks_help)
        sub.add_argument("--quiet", action="store_true", help="no progress on standard error")
        sub.add_argument("--provider", choices=PROVIDERS, default="auto", help=provider_help)
        provider_option_help = "of the provider, as onnxruntime names it; may be given several times"
        sub.add_argument(
            "--provider-option", metavar="KEY=VALUE", action="append", default=[], help=provider_option_help
        )
        require_help = "end with an error where the provider cannot run all of the network"
        sub.add_argument("--require", action="store_true", help=require_help)
        pairs(sub)

    window_help = "colour and depth at most MS apart are a frame, where readings are stored or live (default: 20)"
    source_help = "a folder or file of RGB-D frames, or a camera: oak, oak:DEVICE"
    provider_help = "what onnxruntime runs the network on (default: auto, the best it has)"
    looks_help = (
        "at most N looks at a frame whose poses are unlikely (default: %(default)s; 1: all frames take the same time)"
    )
    validate_help = "compare estimates with the truth of recordings, of any format and of one category or several"
    overlay_help = "write a picture of every frame into DIR: boxes, axes, keypoints, reasons"
    run = command("run", "write one JSON line for every object in every frame", "source", source_help)
    limited(run)
    region_help = "where the object is, px (--region=-5,3,10,10 for a minus first); default: where the source says"
    run.add_argument("--region", metavar="X,Y,W,H", type=accept.region, help=region_help)
    run.add_argument("--out", metavar="FILE", type=Path, help="write the lines here instead of to standard output")
    run.add_argument("--overlay", metavar="DIR", type=Path, help=overlay_help)
    common(run)
    live = command("live", "find objects, follow them, and give a result for every frame", "source", source_help)
    limited(live)
    add_live_options(live)
    add_sink_options(live)
    common(live, looks=1)
    validate = commands.add_parser("validate", help="compare with the truth of recordings", description=validate_help)
    add_validate_options(validate, overlay_help)
    common(validate, several=True)
    bench = commands.add_parser("bench", help="time every stage", description="time every stage")
    add_bench_options(bench)
    common(bench, required=False)
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
    doctor_help = "look at this computer, its cameras and a recording, and say what to change"
    doctor = commands.add_parser("doctor", help=doctor_help, description=f"{doctor_help}; exit code 1: a problem")
    doctor.add_argument("recording", metavar="RECORDING", nargs="?", help="whose calibration and frames are checked")
    bundle_help = "what is timed (default: a shipped one)"
    doctor.add_argument("--bundle", metavar="B", type=Path, help=bundle_help)
    doctor.add_argument(
        "--seconds", metavar="S", type=accept.positive_seconds, default=3.0, help="time for that (default: 3)"
    )
    doctor.add_argument("--json", dest="as_json", action="store_true", help="as a JSON object")
    return parser


def _provider_choice(options: dict[str, Any]) -> ProviderChoice:
    """Of the three options about the provider, which it takes out."""
    pairs = [text.partition("=") for text in options.pop("provider_option")]
    for key, sign, _ in pairs:
        if not key or not sign:
            raise UsageError(f"--provider-option: expected KEY=VALUE, got {key}")
    values = tuple((key, value) for key, _, value in pairs)
    return ProviderChoice(options.pop("provider"), values, options.pop("require"))


if __name__ == "__main__":
    sys.exit(main())
